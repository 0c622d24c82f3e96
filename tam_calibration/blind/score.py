"""The score of a set of cases: the figures that are asked of a diagnosis, and where it goes wrong."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import median

from tam_calibration.blind.catalogue import CATALOGUE
from tam_calibration.blind.outcome import EXPLAINED, NO_GAP, PARTLY_EXPLAINED, UNEXPLAINED, Outcome
from tam_calibration.blind.rates import Bin, Rate, calibration_error, reliability_curve

LEAST_PROBABILITY = 0.01
"""What is given less is no statement; the many that are given nothing would make any curve look good."""

_KNOWN = ("single", "outside", "clean", "pair")
"""Kinds of cases whose key says what is true."""

LARGE, SMALL = "g ≥ 1", "g = 0.3"


@dataclass(frozen=True)
class Row:
    """A figure beside what is asked of it.

    Parameters
    ----------
    name : str
    size : str
        `LARGE` or `SMALL` gaps; empty when both count.
    value : float
    asked : float
    at_least : bool
        Whether the figure shall be at least what is asked, or at most.
    cases : int
    interval : tuple of float, optional
        95 %.
    remark : str
    """

    name: str
    size: str
    value: float
    asked: float
    at_least: bool
    cases: int
    interval: tuple[float, float] | None = None
    remark: str = ""

    @property
    def is_met(self) -> bool:
        """Whether the figure is what is asked; not where there is no case."""
        return self.cases > 0 and (self.value >= self.asked if self.at_least else self.value <= self.asked)


@dataclass(frozen=True, eq=False)
class Score:
    """What a set of answers is worth."""

    outcomes: Sequence[Outcome]
    without: Sequence[Outcome] = ()

    def of_kind(self, kind: str) -> list[Outcome]:
        """Return the outcomes of a kind of cases."""
        return [outcome for outcome in self.outcomes if outcome.kind == kind]

    @cached_property
    def rows(self) -> list[Row]:
        """The figures asked for, first those of large gaps."""
        return [
            *(row for size in (LARGE, SMALL) for row in self._by_size(size)),
            _rate("clean data → no_gap", "", 0.98, (one.verdict == NO_GAP for one in self.of_kind("clean"))),
            *self._pairs(),
            _most("deciding channel withheld: wrong name", 0.03, map(_names_wrongly, self.of_kind("withheld"))),
            _most("the same, partners forgiven", 0.03, map(_names_strangely, self.of_kind("withheld"))),
            self._reliability(),
            *self._left_out(),
        ]

    def _by_size(self, size: str) -> list[Row]:
        large = size == LARGE
        single, outside = (
            [one for one in self.of_kind(kind) if (one.visible_gap > 0.65) == large] for kind in ("single", "outside")
        )
        axis = [one for one in single if one.true_axis]
        asked = (0.97, 0.99, 0.98, 0.95, 0.95) if large else (0.85, 0.93, 0.93, 0.85, 0.75)
        return [
            _rate("first cause right, verdict right", size, asked[0], map(_is_solved, single)),
            _rate("the same, nested partners forgiven", size, asked[0], map(_is_nearly_solved, single)),
            _rate("among the first three", size, asked[1], (one.truth[0] in one.ranked[:3] for one in single)),
            _rate("sensor, scalar or all right", size, asked[2], (one.place_is_right for one in single)),
            _rate("the same of the first cause", size, asked[2], (one.place_of_cause_is_right for one in single)),
            _rate("axis right (single-axis effects)", size, asked[3], (one.axis_is_right for one in axis)),
            _rate("outside the library → unexplained, sensor right", size, asked[4], map(_is_admitted, outside)),
            *_amplitudes(size, single, *((0.03, 0.20) if large else (0.20, 0.20))),
        ]

    def _pairs(self) -> list[Row]:
        pairs = self.of_kind("pair")
        return [
            _rate("both of two effects found, none spurious", "", 0.85, map(_is_pair_solved, pairs)),
            _most("a spurious cause beside two effects", 0.05, map(_is_spurious, pairs)),
        ]

    def _reliability(self) -> Row:
        count = sum(one.count for one in self.reliability)
        value = calibration_error(self.reliability)
        return Row("probabilities calibrated (reliability error)", "", value, 0.05, False, count)

    def _left_out(self) -> list[Row]:
        if not self.without:
            return []
        name = "true effect left out of the library → unexplained or a partner"
        return [_rate(name, "", 0.95, (one.verdict == UNEXPLAINED or one.first_is_tolerable for one in self.without))]

    @cached_property
    def reliability(self) -> list[Bin]:
        """What came true over the probabilities told, where the key knows the truth."""
        known = [one for one in self.outcomes if one.kind in _KNOWN]
        told = [pair for one in known for pair in one.told_and_true() if pair[0] >= LEAST_PROBABILITY]
        return reliability_curve(told) if told else []

    @cached_property
    def by_verdict(self) -> dict[str, Rate]:
        """How often what a verdict says is true: that there is no gap, the first cause, or that it is none of these."""
        right: dict[str, Callable[[Outcome], bool]] = {
            NO_GAP: lambda one: one.kind == "clean",
            EXPLAINED: lambda one: one.first_is_right,
            PARTLY_EXPLAINED: lambda one: one.first_is_right,
            UNEXPLAINED: lambda one: one.kind == "outside",
        }
        known = [one for one in self.outcomes if one.kind in _KNOWN]
        return {name: Rate.of(judge(one) for one in known if one.verdict == name) for name, judge in right.items()}

    @cached_property
    def confusion(self) -> dict[str, Counter[str]]:
        """Of each true cause, or kind without one in the library, how often each answer came first."""
        matrix: dict[str, Counter[str]] = {name: Counter() for name in (*CATALOGUE, "outside", "clean")}
        for one in self.outcomes:
            if one.kind in ("single", "outside", "clean"):
                matrix[one.truth[0] if one.kind == "single" else one.kind][one.first] += 1
        return {name: counts for name, counts in matrix.items() if counts}

    @cached_property
    def false_attribution(self) -> tuple[Rate, Rate]:
        """How often a wrong effect is named first: strictly, and with nested partners forgiven."""
        known = [one for one in self.outcomes if one.kind in ("single", "outside", "clean")]
        return Rate.of(map(_names_wrongly, known)), Rate.of(map(_names_strangely, known))

    @cached_property
    def by_effect(self) -> dict[str, tuple[Rate, float]]:
        """Of each single effect, how often it is solved and the median amplitude left; the worst first."""
        groups = defaultdict(list)
        for one in self.of_kind("single"):
            groups[one.truth[0]].append(one)
        table = {
            name: (Rate.of(map(_is_solved, own)), median(one.amplitude_left for one in own))
            for name, own in groups.items()
        }
        return dict(sorted(table.items(), key=lambda item: (item[1][0].value, -item[1][1])))

    @cached_property
    def by_condition(self) -> dict[str, Rate]:
        """How often single effects are solved under each condition of the recording."""
        conditions: dict[str, Callable[[Outcome], bool]] = {
            "with scalar": lambda one: one.key["with_scalar"],
            "without scalar": lambda one: not one.key["with_scalar"],
            "holes": lambda one: one.key["holes"],
            "cross of four": lambda one: one.key["sensors"] == 4,
            "other arrays": lambda one: one.key["sensors"] != 4,
            "turntable": lambda one: one.key["motion"] == "turntable",
            "in motion": lambda one: one.key["motion"] != "turntable",
            "noise above the data sheet": lambda one: one.key["noise_over_sheet"]["vector"] > 1,
            "noise below the data sheet": lambda one: one.key["noise_over_sheet"]["vector"] < 1,
        }
        single = self.of_kind("single")
        return {name: Rate.of(_is_solved(one) for one in single if holds(one)) for name, holds in conditions.items()}

    @cached_property
    def short(self) -> dict[str, Rate]:
        """Of short recordings, how often the cause is named rightly, left open, or named wrongly."""
        short = self.of_kind("short")
        return {
            "short recordings: right name, or rightly no gap": Rate.of(map(_is_right_though_short, short)),
            "short recordings: left open": Rate.of(bool(one.truth) and not one.causes for one in short),
            "short recordings: wrong name": Rate.of(map(_names_wrongly, short)),
        }

    @property
    def gap_told(self) -> float:
        """Median of the gap told over the gap visible, of single effects."""
        return median([one.gap_told / one.visible_gap for one in self.of_kind("single")] or [float("nan")])

    @property
    def failures(self) -> list[Outcome]:
        """The cases whose answer is not what it should be, kind by kind."""
        right: dict[str, Callable[[Outcome], bool]] = {
            "single": lambda one: _is_solved(one) and one.place_is_right,
            "outside": _is_admitted,
            "clean": lambda one: one.verdict == NO_GAP,
            "pair": _is_pair_solved,
            "withheld": lambda one: not _names_wrongly(one),
            "short": lambda one: not _names_wrongly(one),
        }
        return [one for kind, judge in right.items() for one in self.of_kind(kind) if not judge(one)]


def _is_solved(one: Outcome) -> bool:
    return one.first_is_right and one.verdict == EXPLAINED


def _is_nearly_solved(one: Outcome) -> bool:
    return one.first_is_tolerable and one.verdict == EXPLAINED


def _is_admitted(one: Outcome) -> bool:
    return one.verdict == UNEXPLAINED and one.place_is_right


def _is_spurious(one: Outcome) -> bool:
    return any(not one.tolerates(cause) for cause in one.causes)


def _is_pair_solved(one: Outcome) -> bool:
    return set(one.truth) == set(one.named)


def _is_right_though_short(one: Outcome) -> bool:
    return one.first_is_right if one.truth else one.verdict == NO_GAP


def _names_wrongly(one: Outcome) -> bool:
    return bool(one.causes) and not one.first_is_right


def _names_strangely(one: Outcome) -> bool:
    return bool(one.causes) and not one.first_is_tolerable


def _rate(name: str, size: str, asked: float, outcomes: Iterable[bool]) -> Row:
    rate = Rate.of(outcomes)
    return Row(name, size, rate.value, asked, True, rate.cases, rate.interval)


def _most(name: str, asked: float, outcomes: Iterable[bool]) -> Row:
    rate = Rate.of(outcomes)
    return Row(name, "", rate.value, asked, False, rate.cases, rate.interval)


def _amplitudes(size: str, single: Sequence[Outcome], middle: float, most: float) -> list[Row]:
    """Return the amplitude left: the median, and that of the worst effect."""
    groups = defaultdict(list)
    for one in single:
        groups[one.truth[0]].append(one.amplitude_left)
    whole = median([one.amplitude_left for one in single] or [float("nan")])
    worst, value = max(
        ((name, median(left)) for name, left in groups.items()), key=lambda item: item[1], default=("", float("nan"))
    )
    return [
        Row("amplitude left, median", size, whole, middle, False, len(single)),
        Row("amplitude left, worst effect's median", size, value, most, False, len(single), remark=worst),
    ]
