"""The score of a set of cases: the figures required of a diagnosis, and its errors."""

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import median

from tam_validation.blind.catalogue import CATALOGUE
from tam_validation.blind.figures import (
    ScoreRow,
    amplitude_rows,
    interval_rows,
    is_admitted,
    is_known_named,
    is_mixture_found,
    is_nearly_solved,
    is_nothing_else_named,
    is_pair_solved,
    is_right_though_short,
    is_solved,
    is_spurious,
    names_strangely,
    names_wrongly,
    probability_rows,
    rate_row,
    set_rows,
)
from tam_validation.blind.outcome import EXPLAINED, NO_GAP, PARTLY_EXPLAINED, UNEXPLAINED, Outcome
from tam_validation.blind.rates import Bin, Rate, calibration_error, reliability_curve

_LEAST_PROBABILITY = 0.01
"""Least probability that counts: the many that are near zero would make any reliability curve look good."""

_KNOWN = ("single", "outside", "clean", "pair", "mixed", "large")
"""Kinds of cases whose key says what is true."""

LARGE, SMALL = "g ≥ 1", "g = 0.3"


@dataclass(frozen=True, eq=False)
class Score:
    """The score of a set of answers."""

    outcomes: Sequence[Outcome]
    without: Sequence[Outcome] = ()

    def of_kind(self, kind: str) -> list[Outcome]:
        """Return the outcomes of a kind of cases."""
        return [outcome for outcome in self.outcomes if outcome.kind == kind]

    @cached_property
    def rows(self) -> list[ScoreRow]:
        """The required figures, first those of large gaps."""
        withheld = self.of_kind("withheld")
        known = [one for one in self.outcomes if one.kind in _KNOWN]
        one_truth = [one for one in known if one.kind not in ("pair", "mixed")]
        return [
            *(row for size in (LARGE, SMALL) for row in self._by_size(size)),
            rate_row("clean data → no_gap", "", (one.verdict == NO_GAP for one in self.of_kind("clean")), 0.98),
            *self._pairs(),
            *self._mixtures(),
            *(row for size in (30, 1000) for row in self._very_large(size)),
            rate_row("deciding channel withheld: wrong name", "", map(names_wrongly, withheld), most=0.03),
            rate_row("the same, partners forgiven", "", map(names_strangely, withheld), most=0.03),
            self._reliability(),
            *probability_rows(known),
            *set_rows(one_truth),
            *interval_rows(self.outcomes),
            *self._laws(),
            *self._left_out(),
        ]

    def _by_size(self, size: str) -> list[ScoreRow]:
        large = size == LARGE
        single, outside = (
            [one for one in self.of_kind(kind) if (one.visible_gap > 0.65) == large] for kind in ("single", "outside")
        )
        axis = [one for one in single if one.true_axis]
        right, place, one_axis, admitted = (0.98, 0.98, 0.97, 0.95) if large else (0.92, 0.93, 0.90, 0.85)
        return [
            rate_row("first cause right, verdict right", size, map(is_solved, single), right),
            rate_row("the same, nested partners forgiven", size, map(is_nearly_solved, single), right),
            rate_row("among the first three", size, (one.truth[0] in one.ranked[:3] for one in single), right),
            rate_row("sensor, scalar or all right", size, (one.place_is_right for one in single), place),
            rate_row("the same of the first cause", size, (one.place_of_cause_is_right for one in single), place),
            rate_row("axis right (single-axis effects)", size, (one.axis_is_right for one in axis), one_axis),
            rate_row("outside the library → unexplained, sensor right", size, map(is_admitted, outside), admitted),
            *amplitude_rows(size, single, *((0.03, 0.20) if large else (0.20, None))),
        ]

    def _pairs(self) -> list[ScoreRow]:
        pairs = self.of_kind("pair")
        return [
            rate_row("both of two effects found, none spurious", "", map(is_pair_solved, pairs), 0.90),
            rate_row("a spurious cause with two effects", "", map(is_spurious, pairs), most=0.03),
        ]

    def _mixtures(self) -> list[ScoreRow]:
        mixed = self.of_kind("mixed")
        name = "known with unknown: "
        return [
            rate_row(f"{name}partly_explained, the known named, nothing else", "", map(is_mixture_found, mixed), 0.90),
            rate_row(f"{name}the known named", "", map(is_known_named, mixed)),
            rate_row(f"{name}nothing else named", "", map(is_nothing_else_named, mixed)),
            rate_row(f"{name}verdict partly_explained", "", (one.verdict == PARTLY_EXPLAINED for one in mixed)),
        ]

    def _very_large(self, floors: int) -> list[ScoreRow]:
        near = [one for one in self.of_kind("large") if 0.5 < one.visible_gap / floors < 2]
        size, asked = f"g = {floors}", 0.97 if floors < 100 else 0.90
        return [
            rate_row("first cause right", size, (one.first_is_right for one in near), asked),
            rate_row("sensor, scalar or all right", size, (one.place_is_right for one in near), asked),
        ]

    def _reliability(self) -> ScoreRow:
        count = sum(one.count for one in self.reliability)
        value = calibration_error(self.reliability)
        return ScoreRow("probabilities calibrated (reliability error)", "", value, None, 0.05, count)

    def _laws(self) -> list[ScoreRow]:
        """Return how often the law, its place and its axis are right, of all kinds, and how often its course is."""
        stated = [one for one in self.outcomes if "signature" in one.answer]
        alone = [one for one in stated if one.kind in ("single", "outside", "large")]
        both = [one for one in stated if one.kind in ("pair", "mixed")]
        sizes = (("g ≥ 1", 0.65, 10.0, 0.95), ("g = 0.3", 0.0, 0.65, 0.85), ("g = 30, 1000", 10.0, 1e9, 0.98))
        rows = [
            rate_row(
                f"law, sensor and axes right{of}",
                size,
                (one.law_is_right() for one in group if low < one.visible_gap <= high),
                least,
            )
            for size, low, high, least in sizes
            for of, group in (
                ("", alone),
                (", outside the library", [one for one in alone if one.kind == "outside"]),
            )
        ]
        return [
            *rows,
            rate_row("course right", "", (one.course_is_right for one in alone), 0.90),
            rate_row("both of two laws", "", (one.law_is_right(0) and one.law_is_right(1) for one in both), 0.85),
            rate_row("clean: no law", "", (not one.laws for one in stated if one.kind == "clean"), 0.98),
        ]

    def _left_out(self) -> list[ScoreRow]:
        if not self.without:
            return []
        name = "true effect left out of the library → unexplained or a partner"
        return [
            rate_row(name, "", (one.verdict == UNEXPLAINED or one.first_is_tolerable for one in self.without), 0.95)
        ]

    @cached_property
    def reliability(self) -> list[Bin]:
        """Frequency of truth over stated probability, where the key knows the truth."""
        known = [one for one in self.outcomes if one.kind in _KNOWN]
        forecasts = [pair for one in known for pair in one.forecasts() if pair[0] >= _LEAST_PROBABILITY]
        return reliability_curve(forecasts) if forecasts else []

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
        return Rate.of(map(names_wrongly, known)), Rate.of(map(names_strangely, known))

    @cached_property
    def by_effect(self) -> dict[str, tuple[Rate, float]]:
        """Of each single effect, how often it is solved and the median amplitude left; the worst first."""
        groups = defaultdict(list)
        for one in self.of_kind("single"):
            groups[one.truth[0]].append(one)
        table = {
            name: (Rate.of(map(is_solved, own)), median(one.amplitude_left for one in own))
            for name, own in groups.items()
        }
        return dict(sorted(table.items(), key=lambda item: (item[1][0].value, -item[1][1])))

    @cached_property
    def short(self) -> dict[str, Rate]:
        """Of short recordings, how often the cause is named rightly, left open, or named wrongly."""
        short = self.of_kind("short")
        return {
            "right name, or rightly no gap": Rate.of(map(is_right_though_short, short)),
            "left open": Rate.of(bool(one.truth) and not one.causes for one in short),
            "wrong name": Rate.of(map(names_wrongly, short)),
        }

    @property
    def stated_gap(self) -> float:
        """Median ratio of the stated to the visible gap, of single effects."""
        return median([one.stated_gap / one.visible_gap for one in self.of_kind("single")] or [float("nan")])

    @property
    def failures(self) -> list[Outcome]:
        """The cases whose answer is not what it should be, kind by kind."""
        right: dict[str, Callable[[Outcome], bool]] = {
            "single": lambda one: is_solved(one) and one.place_is_right,
            "outside": is_admitted,
            "clean": lambda one: one.verdict == NO_GAP,
            "pair": is_pair_solved,
            "mixed": is_mixture_found,
            "large": lambda one: one.first_is_right and one.place_is_right,
            "withheld": lambda one: not names_wrongly(one),
            "short": lambda one: not names_wrongly(one),
        }
        return [one for kind, judge in right.items() for one in self.of_kind(kind) if not judge(one)]
