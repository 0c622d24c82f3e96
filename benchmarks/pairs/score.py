"""The figures of a set of pairs, each with what is asked of it."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from pairs.outcome import PairOutcome
from pairs.plan import GAPS
from tam_validation.blind.rates import Rate

NEAR_LEVEL = 0.05
"""Relative error of a noise level that is asked for."""

NEAR_CLOSED = 0.10
"""Median error of the told part of the gap that closes that is asked for."""

MOST_TIME_S = 10.0
"""Processor time that is asked for two recordings of 4000 samples."""


@dataclass(frozen=True)
class Row:
    """A figure: what it is, how many it rests on, its value, what is asked, and whether that is met."""

    name: str
    count: int
    value: str
    asked: str = ""
    is_met: bool | None = None


Hit = Callable[[PairOutcome], bool]


@dataclass(frozen=True, eq=False)
class Figure:
    """A share of pairs, what is asked of it, and how a pair is a hit."""

    name: str
    kinds: tuple[str, ...]
    hit: Hit
    at_least: float | None = None
    gaps: tuple[float, ...] = ()

    def pairs(self, outcomes: Sequence[PairOutcome]) -> list[PairOutcome]:
        """Return the pairs that it is of."""
        return [one for one in outcomes if one.kind in self.kinds and (not self.gaps or one.key["gap"] in self.gaps)]


def _is_same(one: PairOutcome) -> bool:
    return one.verdict == "same"


def _finds(side: str) -> Hit:
    return lambda one: one.finds(side, one.key[side][0])


def _finds_all(one: PairOutcome) -> bool:
    return one.finds_all


SINGLE = ("missing", "surplus")

FIGURES = (
    Figure("missing or surplus first, with place, g ≥ 1", SINGLE, _finds_all, 0.95, GAPS[1:]),
    Figure("missing or surplus first, with place, g = 0.3", SINGLE, _finds_all, 0.85, GAPS[:1]),
    *(Figure(f"{kind}, g = {gap:g}", (kind,), _finds_all, gaps=(gap,)) for kind in (*SINGLE, "world") for gap in GAPS),
    Figure("nothing told of the other side", (*SINGLE, "world"), lambda one: one.other_side_is_empty),
    Figure("two at once: both", ("two",), _finds_all),
    Figure("none of the library: unknown", ("outside",), lambda one: one.is_none_of_library),
    Figure("no gap on equal pairs", ("none", "runs"), _is_same, 0.98),
    Figure("two runs of one simulator: the same", ("runs",), _is_same, 1.0),
    Figure("other parameters recognised", ("other",), lambda one: one.has_other_parameters),
    Figure("gross mistakes", ("mistake",), lambda one: one.mistake_is_named, 1.0),
)
"""What is a share of pairs."""

NOISY = ("level", "colour", "none", "runs")
"""Kinds of which the noise of both sides is known, and nothing else is in it."""


def rows(outcomes: Sequence[PairOutcome]) -> list[Row]:
    """Return all figures."""
    shares = [_share(figure, outcomes) for figure in FIGURES]
    return [*shares, _wrong_names(outcomes), *_noise(outcomes), *_closed(outcomes), *_times(outcomes)]


def failures(outcomes: Sequence[PairOutcome]) -> list[PairOutcome]:
    """Return the pairs that are none of the hits of some figure, or are named wrongly."""
    failed = {one.name for figure in FIGURES for one in figure.pairs(outcomes) if not figure.hit(one)}
    failed |= {one.name for one in outcomes if one.first_named and one.first_name_is_wrong}
    failed |= {one.name for one in outcomes if one.kind == "colour" and not all(one.colours_right)}
    failed |= {one.name for one in outcomes if one.kind in NOISY and not one.answer.get("noise")}
    return [one for one in outcomes if one.name in failed]


def _share(figure: Figure, outcomes: Sequence[PairOutcome]) -> Row:
    return _rate_row(figure.name, map(figure.hit, figure.pairs(outcomes)), figure.at_least)


def _rate_row(name: str, hits: Iterable[bool], at_least: float | None = None, at_most: float | None = None) -> Row:
    rate = Rate.of(hits)
    low, high = rate.interval
    value = f"{rate.value:.1%} ({low:.0%} to {high:.0%})"
    if at_least is not None:
        return Row(name, rate.cases, value, f"≥ {at_least:.0%}", rate.value >= at_least)
    if at_most is not None:
        return Row(name, rate.cases, value, f"≤ {at_most:.0%}", rate.value <= at_most)
    return Row(name, rate.cases, value)


def _wrong_names(outcomes: Sequence[PairOutcome]) -> Row:
    named = [one for one in outcomes if one.kind != "mistake" and one.first_named]
    return _rate_row("wrong name, where one is named", (one.first_name_is_wrong for one in named), at_most=0.03)


def _noise(outcomes: Sequence[PairOutcome]) -> list[Row]:
    chosen = [one for one in outcomes if one.kind in NOISY]
    errors = np.abs([error for one in chosen for error in one.level_errors])
    coloured = [right for one in outcomes if one.kind == "colour" for right in one.colours_right]
    median = float(np.median(errors)) if errors.size else float("nan")
    return [
        Row("noise level, median error", errors.size, f"{median:.1%}", f"≤ {NEAR_LEVEL:.0%}", median <= NEAR_LEVEL),
        _rate_row(f"noise level within {NEAR_LEVEL:.0%}", (error <= NEAR_LEVEL for error in errors)),
        _rate_row("colour class of axes", (right for one in chosen for right in one.colours_right), 0.95),
        _rate_row("colour class of axes that are not white", coloured, 0.95),
        _rate_row("other noise told where it is", (right for one in chosen for right in one.noise_differences_right)),
    ]


def _closed(outcomes: Sequence[PairOutcome]) -> list[Row]:
    both = np.array([one.closed for one in outcomes if one.closed is not None]).reshape(-1, 2)
    errors = np.abs(both[:, 0] - both[:, 1])
    median = float(np.median(errors)) if errors.size else float("nan")
    truth = float(np.median(both[:, 1])) if errors.size else float("nan")
    asked = f"≤ {NEAR_CLOSED:.0%}"
    return [
        Row(
            "told part of the gap that closes, median error", errors.size, f"{median:.1%}", asked, median <= NEAR_CLOSED
        ),
        Row("part that its maker's mend closes, median", errors.size, f"{truth:.1%}"),
    ]


def _times(outcomes: Sequence[PairOutcome]) -> list[Row]:
    times = np.array([one.answer["processor_time_s"] for one in outcomes])
    if not times.size:
        return []
    slow = float(np.quantile(times, 0.9))
    return [
        Row("processor time, median", times.size, f"{np.median(times):.1f} s"),
        Row("processor time, 90 % quantile", times.size, f"{slow:.1f} s", f"≤ {MOST_TIME_S:g} s", slow <= MOST_TIME_S),
    ]
