"""A figure of the score beside what is asked of it."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median

from tam_calibration.blind.outcome import Outcome
from tam_calibration.blind.rates import Rate


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
