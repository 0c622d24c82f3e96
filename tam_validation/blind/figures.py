"""Which answers are right, and the figures of the score with their required values."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median

from tam_validation.blind.outcome import EXPLAINED, NO_GAP, PARTLY_EXPLAINED, UNEXPLAINED, Outcome
from tam_validation.blind.rates import Rate, constant_log_score, log_score, separation


def is_solved(one: Outcome) -> bool:
    """Say whether the first cause is the true one, and the verdict that it explains the gap."""
    return one.first_is_right and one.verdict == EXPLAINED


def is_nearly_solved(one: Outcome) -> bool:
    """Say the same with partners forgiven."""
    return one.first_is_tolerable and one.verdict == EXPLAINED


def is_admitted(one: Outcome) -> bool:
    """Whether a cause outside the library is left unexplained, or named as a later effect of it at the right place."""
    by_name = one.verdict == EXPLAINED and bool(one.causes) and set(one.named) <= one.other_names
    return (one.verdict == UNEXPLAINED or by_name) and one.place_is_right


def is_known_named(one: Outcome) -> bool:
    """Say whether the known cause beside an unknown one is named."""
    return one.truth[0] in one.named


def is_nothing_else_named(one: Outcome) -> bool:
    """Say whether nothing is named but the known cause, and the unknown one where it has a name since."""
    return set(one.named) <= {one.truth[0]} | one.other_names


def is_mixture_found(one: Outcome) -> bool:
    """Say whether the known cause is named, nothing else, and the verdict that it explains a part.

    Where the unknown cause has a name since, both names and the verdict that they explain all is as right.
    """
    both = one.verdict == EXPLAINED and set(one.named) == {one.truth[0]} | one.other_names and len(one.named) == 2
    return both or (one.verdict == PARTLY_EXPLAINED and set(one.named) == {one.truth[0]})


def is_spurious(one: Outcome) -> bool:
    """Say whether a cause is named that is not there."""
    return any(not one.tolerates(cause) for cause in one.causes)


def is_pair_solved(one: Outcome) -> bool:
    """Say whether both causes are named and no other."""
    return set(one.truth) == set(one.named)


def is_right_though_short(one: Outcome) -> bool:
    """Say whether a short recording's cause comes first, or no gap where there is none."""
    return one.first_is_right if one.truth else one.verdict == NO_GAP


def names_wrongly(one: Outcome) -> bool:
    """Say whether a wrong cause comes first."""
    return bool(one.causes) and not one.first_is_right


def names_strangely(one: Outcome) -> bool:
    """Say the same with partners forgiven."""
    return bool(one.causes) and not one.first_is_tolerable


@dataclass(frozen=True)
class ScoreRow:
    """A figure with its required value.

    Parameters
    ----------
    name : str
    size : str
        Of the gaps that count, in words; empty when all do.
    value : float
    least, most : float, optional
        Required values.
    cases : int
    interval : tuple of float, optional
        95 %.
    remark : str
    is_share : bool
        Whether it is a share of one.
    """

    name: str
    size: str
    value: float
    least: float | None
    most: float | None
    cases: int
    interval: tuple[float, float] | None = None
    remark: str = ""
    is_share: bool = True

    @property
    def is_met(self) -> bool:
        """Whether the figure is as required; not where there is no case."""
        low = self.least is None or self.value >= self.least
        return self.cases > 0 and low and (self.most is None or self.value <= self.most)


def rate_row(
    name: str, size: str, outcomes: Iterable[bool], least: float | None = None, most: float | None = None
) -> ScoreRow:
    """Return the row of a rate."""
    rate = Rate.of(outcomes)
    return ScoreRow(name, size, rate.value, least, most, rate.cases, rate.interval)


def amplitude_rows(size: str, single: Sequence[Outcome], middle: float, worst: float | None) -> list[ScoreRow]:
    """Return the amplitude left: the median and, where it has a required value, that of the worst effect."""
    groups = defaultdict(list)
    for one in single:
        groups[one.truth[0]].append(one.amplitude_left)
    whole = median([one.amplitude_left for one in single] or [float("nan")])
    rows = [ScoreRow("amplitude left, median", size, whole, None, middle, len(single))]
    if worst is None:
        return rows
    name, value = max(
        ((name, median(left)) for name, left in groups.items()), key=lambda item: item[1], default=("", float("nan"))
    )
    return [
        *rows,
        ScoreRow("amplitude left, worst effect's median", size, value, None, worst, len(single), remark=name),
    ]


def probability_rows(outcomes: Sequence[Outcome]) -> list[ScoreRow]:
    """Return the skill of the first answers' probabilities beyond that of the verdict alone."""
    pairs = [(one.verdict, one.first_forecast) for one in outcomes]
    forecasts = [pair for _, pair in pairs if pair is not None]
    groups = defaultdict(list)
    for verdict, pair in pairs:
        if pair is not None:
            groups[verdict].append(pair[1])
    own, constant = log_score(forecasts), constant_log_score(groups.values())
    both = {came for _, came in forecasts} == {True, False}
    return [
        ScoreRow(
            "log score over that of a constant per verdict",
            "",
            own / constant if forecasts else float("nan"),
            None,
            0.5,
            len(forecasts),
            remark=f"{own:.3f} and {constant:.3f}",
            is_share=False,
        ),
        ScoreRow("right and wrong separated (AUROC)", "", separation(forecasts), 0.9, None, both * len(forecasts)),
    ]


def set_rows(outcomes: Sequence[Outcome]) -> list[ScoreRow]:
    """Return how often the 95 % sets of causes hold the true one, and how large they are."""
    with_set = [one for one in outcomes if one.set_95 is not None]
    middle = median([len(one.set_95 or []) for one in with_set] or [float("nan")])
    return [
        rate_row("95 % sets contain the true cause", "", (one.set_holds for one in with_set), 0.93, 0.97),
        ScoreRow("95 % sets, median size", "", middle, None, 1.0, len(with_set), is_share=False),
    ]


def interval_rows(outcomes: Sequence[Outcome]) -> list[ScoreRow]:
    """Return how often the 95 % intervals of parameters contain the true values, alone and beside an unknown cause."""
    alone, beside = (
        [held for one in outcomes if (one.kind == "mixed") == mixed for held in one.coefficients_held()]
        for mixed in (False, True)
    )
    name = "95 % intervals of parameters contain the true values"
    return [rate_row(name, "", alone, 0.93, 0.97), rate_row(name, "with an unknown", beside, 0.93, 0.97)]
