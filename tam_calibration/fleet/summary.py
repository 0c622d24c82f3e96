"""The summaries of a batch: ``summary.json``, ``summary.csv``, and a page of counts, drifts and troubles."""

import csv
import re
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tam_calibration.files.text_files import to_json, write_set
from tam_calibration.fleet import missions as fleet_rows
from tam_calibration.fleet.task import Result
from tam_calibration.report.blocks import Block, Gallery, Points, Section, Table, Text
from tam_calibration.report.formatting import KINDS, Kind, count, counted, number, sentence
from tam_calibration.report.page import COLORS, QUIET_COLOR, STYLE, WIDTH_INCH, embed, write_page
from tam_calibration.results.results_json import attributes


@matplotlib.rc_context(STYLE | {"date.converter": "concise"})
def plot_missions(missions: fleet_rows.Missions, kind: Kind) -> Figure:
    """Draw three parameters of each sensor less their means, with standard errors, over time.

    Parameters
    ----------
    missions : Missions
        Of one platform, with M missions and K sensors.
    kind : Kind
        Parameters to draw; those without a unit are drawn in ppm.
    """
    factor, unit = (1.0, kind.sign) if kind.sign else (1e6, "ppm")
    values, errors = factor * missions.values[kind], factor * missions.standard_errors[kind]
    count = values.shape[1]
    figure = Figure(figsize=(WIDTH_INCH, 1.5 * count + 0.4), layout="constrained")
    panels = figure.subplots(count, sharex=True, squeeze=False)[:, 0]
    times = [datetime.fromtimestamp(time, UTC) for time in missions.time_s]
    for sensor, axes in enumerate(panels):
        for axis, color in enumerate(COLORS[:3]):
            if (errors[:, sensor, axis] > 0).any():
                value = values[:, sensor, axis]
                style = {"fmt": ".", "markersize": 5, "elinewidth": 0.9, "color": color, "label": kind.axes[axis]}
                axes.errorbar(times, value - np.nanmean(value), errors[:, sensor, axis], **style)
        _finish(axes, f"sensor {sensor + 1}")
    figure.supylabel(f"{kind.name} less its mean, {unit}")
    return figure


def _finish(axes: Axes, title: str) -> None:
    axes.axhline(0.0, color=QUIET_COLOR, linewidth=0.6)
    if not axes.containers:
        axes.set_title(f"{title}: held fixed", loc="left")
        axes.set_yticks([])
    else:
        axes.set_title(title, loc="left")
        axes.legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 0.95), handletextpad=0.1)


_DRIFTS = (
    "A straight line through the estimates of the missions, weighted by their standard errors. Where the scatter about "
    "it, in those standard errors, is above 1, the missions differ by more than their calibrations know of, and the "
    "standard errors given here are wider by it. Parameters that no recording determines are left out."
)


def _write_fleet_page(path: Path, results: Sequence[Result]) -> None:
    """Write the self-contained HTML page.

    Parameters
    ----------
    path : Path
        File to write.
    results : sequence of Result
        Sorted by platform and time.
    """
    header = ("recording", "platform", "start (UTC)", "samples", "status", "verdict", "gap (noise floors)")
    recordings = Table(header, list(map(_recording_cells, results)), numeric=False)
    drifts = map(_drift_section, fleet_rows.all_missions(results))
    sections = [_overview(results), *drifts, Section("Recordings", [recordings])]
    subtitle = f"{counted(len(results), 'recording')} of {counted(len(fleet_rows.by_platform(results)), 'platform')}"
    write_page(path, "Calibrations over many missions", subtitle, sections)


def _overview(results: Sequence[Result]) -> Section:
    points = fleet_rows.open_points(results)
    settled = sum(result.is_settled for result in results)
    words = f"{count(settled)} of {counted(len(results), 'recording')} without a failure and without an open gap."
    verdict = Text(words, "doubt" if points else "good")
    blocks: list[Block] = [verdict, Table(fleet_rows.COUNTS_HEADER, fleet_rows.count_rows(results))]
    if laws := fleet_rows.law_points(results):
        blocks += [Text("Laws of the gaps, whatever causes them:"), Points(laws)]
    if points:
        blocks.append(Points(points))
    return Section("What was found", blocks)


def _drift_section(missions: fleet_rows.Missions) -> Section:
    drawn = [
        embed(plot_missions(missions, kind), f"{kind.name} over the missions", f"{kind.name} ± 1 standard error")
        for kind in KINDS
    ]
    rows = [fleet_rows.drift_row(found)[1:] for found in missions.drifts()]
    words = sentence(missions.no_drift) if missions.no_drift else _DRIFTS
    blocks: list[Block] = [Text(words), Gallery(drawn), Table(fleet_rows.DRIFT_HEADER[1:], rows)]
    return Section(f"Drift of {missions.platform}: {counted(len(missions.time_s), 'mission')}", blocks)


def _recording_cells(result: Result) -> list[str]:
    start = "–"
    if result.time_span_s:
        start = f"{datetime.fromtimestamp(result.time_span_s[0], UTC):%Y-%m-%d %H:%M:%S}"
    gap = "–"
    if result.gap:
        before, after = (float("nan") if result.gap[key] is None else result.gap[key] for key in ("before", "after"))
        gap = f"{number(before)} → {number(after)}"
    verdict = result.verdict.replace("_", " ") or "–"
    return [result.recording, result.platform, start, count(result.samples), result.status, verdict, gap]


_SCHEMA = "tam_calibration/batch/1"
SUMMARIES = ("summary.html", "summary.csv", "summary.json")
"""Names of the summaries: for people, for spreadsheets and for programs."""

_FORMULA = re.compile("(^|[;\t\r\n])(?=[-=+@\t\r\n－＝＋＠])")
"""Where a spreadsheet would take what follows for a formula (OWASP, CSV injection): at the beginning of a text, or
behind what some take for the end of a cell."""


def write_summaries(out: Path, results: Sequence[Result]) -> None:
    """Write the summaries into a folder, all or none.

    Parameters
    ----------
    out : Path
        The folder.
    results : sequence of Result
        Sorted by platform and time.

    Raises
    ------
    InputError
        When a file cannot be written.
    """
    with write_set(out / name for name in SUMMARIES) as (page, table, mapping):
        _write_fleet_page(page, results)
        rows = list(map(_csv_row, results))
        with table.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, [*max(rows, key=len)], "", quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        mapping.write_text(to_json(_summary_to_mapping(results)), encoding="utf-8")


def _summary_to_mapping(results: Sequence[Result]) -> dict[str, Any]:
    """Return the content of ``summary.json``: counts, drifts and the recordings without their parameters."""
    return {
        "schema": _SCHEMA,
        "platforms": [
            {"platform": platform}
            | {name.replace(" ", "_"): number for name, number in fleet_rows.counts_of(some).items()}
            | {"causes": fleet_rows.causes_of(some)}
            for platform, some in fleet_rows.by_platform(results).items()
        ],
        "drifts": [_drift_mapping(drift) for drift in fleet_rows.all_drifts(results)],
        "recordings": [
            {key: value for key, value in asdict(result).items() if key not in ("sensors", "options")}
            for result in results
        ],
    }


def _drift_mapping(found: fleet_rows.ParameterDrift) -> dict[str, Any]:
    unit = f"_{found.kind.unit}" if found.kind.unit else ""
    return {
        "platform": found.platform,
        "sensor": found.sensor,
        "parameter": found.name,
        "missions": found.drift.missions,
        f"mean{unit}": found.drift.mean,
        f"mean_standard_error{unit}": found.drift.mean_standard_error,
        f"drift{unit}_per_day": found.drift.per_day,
        f"drift_standard_error{unit}_per_day": found.drift.per_day_standard_error,
        "scatter_in_standard_errors": found.drift.scatter,
    }


def _csv_row(result: Result) -> dict[str, Any]:
    """Return a row of ``summary.csv`` by its columns; those of sensors that were calibrated come last."""
    gap = result.gap or {}
    start_s, end_s = result.time_span_s or ("", "")
    row = attributes(result, "platform", "recording", "path", "status", "verdict")
    row |= {"start_s": start_s, "end_s": end_s, "samples": result.samples}
    row |= {f"gap_{key}": gap.get(key, "") for key in ("before", "after", "closed")}
    row |= {"causes": " ".join(gap.get("causes", ())), "problems": result.trouble}
    row = {name: _FORMULA.sub(r"\1'", cell) if isinstance(cell, str) else cell for name, cell in row.items()}
    for index, sensor in enumerate(result.sensors, 1):
        for kind in KINDS:
            for part in ("", "standard_error"):
                name, unit = kind.key(part).removesuffix(f"_{kind.unit}"), kind.unit
                columns = [f"sensor_{index}_{name}_{axis}_{unit}".rstrip("_") for axis in kind.columns]
                row |= zip(columns, sensor[kind.key(part)], strict=True)
    return row
