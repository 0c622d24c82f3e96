"""Figures of the score beside what is asked of them: rates, amplitudes, and what an answer says of its certainty."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median

from tam_calibration.blind.outcome import Outcome
from tam_calibration.blind.rates import Rate, constant_log_score, log_score, separation


@dataclass(frozen=True)
class Row:
    """A figure beside what is asked of it.

    Parameters
    ----------
    name : str
    size : str
        Of the gaps that count, in words; empty when all do.
    value : float
    least, most : float, optional
        What is asked.
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
        """Whether the figure is what is asked; not where there is no case."""
        low = self.least is None or self.value >= self.least
        return self.cases > 0 and low and (self.most is None or self.value <= self.most)


def rate_row(
    name: str, size: str, outcomes: Iterable[bool], least: float | None = None, most: float | None = None
) -> Row:
    """Return how often something is so."""
    rate = Rate.of(outcomes)
    return Row(name, size, rate.value, least, most, rate.cases, rate.interval)


def amplitude_rows(size: str, single: Sequence[Outcome], middle: float, worst: float | None) -> list[Row]:
    """Return the amplitude left: the median, and where something is asked of it that of the worst effect."""
    groups = defaultdict(list)
    for one in single:
        groups[one.truth[0]].append(one.amplitude_left)
    whole = median([one.amplitude_left for one in single] or [float("nan")])
    rows = [Row("amplitude left, median", size, whole, None, middle, len(single))]
    if worst is None:
        return rows
    name, value = max(
        ((name, median(left)) for name, left in groups.items()), key=lambda item: item[1], default=("", float("nan"))
    )
    return [*rows, Row("amplitude left, worst effect's median", size, value, None, worst, len(single), remark=name)]


def probability_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """Return how much the probabilities of the first answers tell that the verdict alone does not."""
    pairs = [(one.verdict, one.first_told) for one in outcomes]
    told = [pair for _, pair in pairs if pair is not None]
    groups = defaultdict(list)
    for verdict, pair in pairs:
        if pair is not None:
            groups[verdict].append(pair[1])
    own, constant = log_score(told), constant_log_score(groups.values())
    both = {came for _, came in told} == {True, False}
    return [
        Row(
            "log score over that of a constant per verdict",
            "",
            own / constant if told else float("nan"),
            None,
            0.5,
            len(told),
            remark=f"{own:.3f} and {constant:.3f}",
            is_share=False,
        ),
        Row("right and wrong told apart (AUROC)", "", separation(told), 0.9, None, len(told) if both else 0),
    ]


def set_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """Return how often the 95 % sets of causes hold the true one, and how large they are."""
    told = [one for one in outcomes if one.set_95 is not None]
    middle = median([len(one.set_95 or []) for one in told] or [float("nan")])
    return [
        rate_row("95 % sets hold the true cause", "", (one.set_holds for one in told), 0.93, 0.97),
        Row("95 % sets, median size", "", middle, None, 1.0, len(told), is_share=False),
    ]


def interval_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """Return how often the 95 % intervals of parameters hold the true values, alone and beside an unknown cause."""
    alone, beside = (
        [held for one in outcomes if (one.kind == "mixed") == mixed for held in one.coefficients_held()]
        for mixed in (False, True)
    )
    name = "95 % intervals of parameters hold the true values"
    return [rate_row(name, "", alone, 0.93, 0.97), rate_row(name, "beside an unknown", beside, 0.93, 0.97)]
