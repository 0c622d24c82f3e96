"""The score of the check on withheld effects, for people in a terminal and for programs."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from statistics import median
from typing import Any

from rich.console import Console
from rich.table import Table

from tam_validation.blind.figures import ScoreRow
from tam_validation.blind.rates import Rate
from tam_validation.blind.score import Score

HEADER = ("figure", "gaps", "asked", "measured", "95 % interval", "cases", "met")


def print_score(console: Console, score: Score, times_s: Mapping[str, float]) -> None:
    """Print all figures beside what is asked, then where it goes wrong."""
    _print_table(console, "Figures asked for", HEADER, [cells(row) for row in score.rows])
    _print_table(console, "Single effects, the worst first", ("effect", "solved", "amplitude left"), effects(score))
    _print_table(
        console, "Short recordings", ("answer", "cases"), [(name, _of(rate)) for name, rate in score.short.items()]
    )
    _print_table(console, "First answers", *confusion(score))
    _print_table(console, "What came true of what was told", ("told", "true", "statements"), reliability(score))
    for line in remarks(score, times_s):
        console.print(line)


def _print_table(console: Console, title: str, header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    table = Table(title=title, title_justify="left")
    for number, heading in enumerate(header):
        table.add_column(heading, justify="right" if number else "left")
    for row in rows:
        table.add_row(*row, style="bold" if row[-1] == "NO" else None)
    console.print(table)


def cells(row: ScoreRow) -> tuple[str, ...]:
    """Return a figure as texts for `HEADER`."""
    interval = f"{row.interval[0]:.1%} – {row.interval[1]:.1%}" if row.interval and row.cases else row.remark
    asked = _asked(row)
    met = "" if not row.cases or not asked else "yes" if row.is_met else "NO"
    measured = _figure(row, row.value, 1) if row.cases else "–"
    return row.name, row.size, asked, measured, interval, str(row.cases), met


def _asked(row: ScoreRow) -> str:
    if row.least is not None and row.most is not None:
        return f"{_figure(row, row.least)} – {_figure(row, row.most)}"
    if row.least is not None:
        return f"≥ {_figure(row, row.least)}"
    return f"≤ {_figure(row, row.most)}" if row.most is not None else ""


def _figure(row: ScoreRow, value: float, digits: int = 0) -> str:
    return f"{value:.{digits}%}" if row.is_share else f"{value:.2g}"


def effects(score: Score) -> list[tuple[str, ...]]:
    """Return how often each effect is solved, and the median of the amplitude left."""
    return [(name, _of(rate), f"{left:.1%}") for name, (rate, left) in score.by_effect.items()]


def confusion(score: Score) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the confusion matrix as a list: the truth, and each answer with its count, the most frequent first."""
    rows: list[tuple[str, ...]] = [
        (truth, ", ".join(f"{answer} {count}" for answer, count in counts.most_common()))
        for truth, counts in score.confusion.items()
    ]
    return ("truth", "answers"), rows


def reliability(score: Score) -> list[tuple[str, ...]]:
    """Return the reliability curve."""
    return [(f"{one.told:.1%}", f"{one.true:.1%}", str(one.count)) for one in score.reliability]


def remarks(score: Score, times_s: Mapping[str, float]) -> list[str]:
    """Return the figures that stand in no table."""
    strict, forgiving = score.false_attribution
    lines = [
        f"a wrong effect named first: {_of(strict)}, with nested partners forgiven {_of(forgiving)}",
        f"what a verdict says is true: {', '.join(f'{name} {_of(rate)}' for name, rate in score.by_verdict.items())}",
        f"stated gap over visible gap, median of single effects: {score.stated_gap:.2f}",
    ]
    if times_s:
        values = list(times_s.values())
        lines.append(f"processor time of an answer: median {median(values):.2f} s, most {max(values):.2f} s")
    return lines


def _of(rate: Rate) -> str:
    return f"{rate.hits} of {rate.cases}"


def score_to_mapping(score: Score, times_s: Mapping[str, float]) -> dict[str, Any]:
    """Return the score for programs."""
    strict, forgiving = score.false_attribution
    return {
        "figures": [{**asdict(row), "met": row.is_met} for row in score.rows],
        "confusion": {truth: dict(counts) for truth, counts in score.confusion.items()},
        "false_attribution": {"strict": asdict(strict), "partners_forgiven": asdict(forgiving)},
        "reliability": [asdict(one) for one in score.reliability],
        "by_effect": {
            name: {"solved": asdict(rate), "amplitude_left": left} for name, (rate, left) in score.by_effect.items()
        },
        "short": {name: asdict(rate) for name, rate in score.short.items()},
        "gap_told_over_visible": score.stated_gap,
        "processor_time_s": dict(times_s),
        "failures": [one.line for one in score.failures],
    }
