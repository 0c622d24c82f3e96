"""The page over all recordings of a batch: what was found, and how the parameters drift over the missions."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

from tam_calibration.fleet.parameters import GROUPS, Missions, by_platform, missions_of
from tam_calibration.fleet.plots import plot_missions
from tam_calibration.fleet.result import Result
from tam_calibration.fleet.rows import COUNTS_HEADER, DRIFT_HEADER, count_rows, drift_row, open_points
from tam_calibration.report.formatting import count, number
from tam_calibration.report.page import Block, Gallery, Points, Section, Table, Text, embed, render

_DRIFTS = (
    "A straight line through the estimates of the missions, weighted by their standard errors. Where the scatter about "
    "it, in those standard errors, is above 1, the missions differ by more than their calibrations know of, and the "
    "standard errors given here are wider by it. Parameters that no recording determines are left out."
)
_RECORDINGS_HEADER = ("recording", "platform", "start (UTC)", "samples", "status", "verdict", "gap (noise floors)")


def write_page(path: Path, results: Sequence[Result]) -> None:
    """Write the self-contained HTML page.

    Parameters
    ----------
    path : Path
        File to write.
    results : sequence of Result
        Sorted by platform and time.
    """
    sections = [_overview(results), *_drifts(results), _recordings(results)]
    platforms = len(by_platform(results))
    subtitle = f"{_number(len(results), 'recording')} of {_number(platforms, 'platform')}"
    path.write_text(render("Calibrations over many missions", subtitle, sections), encoding="utf-8")


def _overview(results: Sequence[Result]) -> Section:
    points = open_points(results)
    settled = sum(result.is_settled for result in results)
    words = f"{count(settled)} of {_number(len(results), 'recording')} without a failure and without an open gap."
    verdict = Text(words, "doubt" if points else "good")
    blocks: list[Block] = [verdict, Table(COUNTS_HEADER, count_rows(results))]
    if points:
        blocks.append(Points(points))
    return Section("What was found", blocks)


def _drifts(results: Sequence[Result]) -> Iterator[Section]:
    for platform, some in by_platform(results).items():
        missions = missions_of(platform, some)
        if missions is not None:
            yield _drift(missions)


def _drift(missions: Missions) -> Section:
    drawn = [
        embed(plot_missions(missions, group), f"{group.title} over the missions", f"{group.title} ± 1 standard error")
        for group in GROUPS
    ]
    rows = [drift_row(found)[1:] for found in missions.drifts()]
    blocks: list[Block] = [Text(_DRIFTS), Gallery(drawn), Table(DRIFT_HEADER[1:], rows)]
    return Section(f"Drift of {missions.platform}: {_number(len(missions.time_s), 'mission')}", blocks)


def _recordings(results: Sequence[Result]) -> Section:
    return Section("Recordings", [Table(_RECORDINGS_HEADER, [_row(result) for result in results], numeric=False)])


def _row(result: Result) -> list[str]:
    start = "–"
    if result.time_span_s:
        start = f"{datetime.fromtimestamp(result.time_span_s[0], UTC):%Y-%m-%d %H:%M:%S}"
    gap = "–"
    if result.gap:
        before, after = (float("nan") if result.gap[key] is None else result.gap[key] for key in ("before", "after"))
        gap = f"{number(before)} → {number(after)}"
    verdict = result.verdict.replace("_", " ") or "–"
    return [result.recording, result.platform, start, count(result.samples), result.status, verdict, gap]


def _number(value: int, noun: str) -> str:
    return f"{count(value)} {noun}" + ("" if value == 1 else "s")
