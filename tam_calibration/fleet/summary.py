"""The summaries of a batch: counts, drifts and troubles of the missions, as rows, a page, a table and JSON."""

import csv
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tam_calibration.files.text_files import to_json, write_set
from tam_calibration.fleet.task import ANSWERS, Result
from tam_calibration.model.data_sheet import DAY_S
from tam_calibration.model.units import ERROR_KINDS, ErrorKind, FloatArray, has_date
from tam_calibration.report import blocks
from tam_calibration.report.page import COLORS, QUIET_COLOR, WIDTH_INCH, embed, in_style, new_figure, write_page
from tam_calibration.results.results_json import attributes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class LinearDrift:
    """The line through one parameter over the missions; NaN is what they do not tell.

    Parameters
    ----------
    missions : int
        Estimates that have a standard error.
    mean, mean_standard_error : float
        Weighted mean.
    per_day, per_day_standard_error : float
        Slope of the line, in the parameter's unit.
    scatter : float
        Of the estimates about the line, in their standard errors: √(χ²/(missions - 2)). Where it is above 1, the
        missions differ by more than the calibrations know of, and all standard errors here are wider by it.
    """

    missions: int
    mean: float
    mean_standard_error: float
    per_day: float
    per_day_standard_error: float
    scatter: float

    @property
    def significance(self) -> float:
        """Slope over its standard error."""
        return self.per_day / self.per_day_standard_error


def fit_drift(
    time_s: FloatArray, values: FloatArray, standard_errors: FloatArray, least_apart_s: float = 0.0
) -> LinearDrift | None:
    """Fit a line through estimates by weighted least squares.

    Parameters
    ----------
    time_s, values, standard_errors : (M,) array
        Of each mission; a standard error of zero marks what was held fixed, NaN what is not known.
    least_apart_s : float
        The slope is NaN where no two missions are further apart than this, seconds.

    Returns
    -------
    LinearDrift or None
        None if no mission determines the parameter.
    """
    known = np.isfinite(values) & (standard_errors > 0)
    estimates = int(known.sum())
    if not estimates:
        return None
    days, value, weight = (time_s[known] - time_s[0]) / DAY_S, values[known], 1 / standard_errors[known]
    since = days - np.average(days, weights=weight**2)
    has_line = np.ptp(time_s[known]) > least_apart_s
    line, covariance = np.polyfit(since, value, int(has_line), w=weight, cov="unscaled")
    scatter, wider = math.nan, 1.0
    if has_line and estimates > 2:
        scatter = math.sqrt(np.sum((weight * (value - np.polyval(line, since))) ** 2) / (estimates - 2))
        wider = max(1.0, scatter)
    errors = (wider * np.sqrt(np.diagonal(covariance))).tolist()
    slope, slope_error = (float(line[0]), errors[0]) if has_line else (math.nan, math.nan)
    return LinearDrift(estimates, float(line[-1]), errors[-1], slope, slope_error, scatter)


@dataclass(frozen=True)
class ParameterDrift:
    """The drift of one parameter of a sensor of a platform."""

    platform: str
    sensor: int
    kind: ErrorKind
    axis: int
    drift: LinearDrift

    @property
    def name(self) -> str:
        """Name of the parameter, without the sensor."""
        return f"{self.kind.name} {self.kind.axes[self.axis]}"


@dataclass(frozen=True, eq=False)
class Missions:
    """The missions of a platform that were calibrated.

    Parameters
    ----------
    platform : str
        Its name.
    time_s : (M,) array
        The middle of each mission, seconds.
    longest_s : float
        Duration of the longest mission, seconds.
    values, standard_errors : dict
        For each kind (M, K, 3), in its unit.
    """

    platform: str
    time_s: FloatArray
    longest_s: float
    values: dict[ErrorKind, FloatArray]
    standard_errors: dict[ErrorKind, FloatArray]

    @property
    def no_drift(self) -> str:
        """Why several missions give no drift; empty where they give one, or there is one mission."""
        if len(self.time_s) == 1:
            return ""
        if np.ptp(self.time_s) <= self.longest_s:
            return "no drift: the missions have one time"
        return "" if has_date(self.time_s.min()) else "no drift: the times of the missions do not count from 1970"

    def drifts(self) -> Iterator[ParameterDrift]:
        """Yield the drift of each parameter that some mission determines."""
        apart_s = math.inf if self.no_drift else self.longest_s
        for kind, values in self.values.items():
            errors = self.standard_errors[kind]
            for sensor, axis in np.ndindex(*values.shape[1:]):
                drift = fit_drift(self.time_s, values[:, sensor, axis], errors[:, sensor, axis], apart_s)
                if drift is not None:
                    yield ParameterDrift(self.platform, sensor + 1, kind, axis, drift)


def by_platform(results: Sequence[Result]) -> dict[str, list[Result]]:
    """Return the results of each platform, which stand together already."""
    return {platform: list(some) for platform, some in groupby(results, lambda result: result.platform)}


def _table(results: Sequence[Result], key: str) -> FloatArray:
    return np.array([[sensor[key] for sensor in each.sensors] for each in results], float)


def all_missions(results: Sequence[Result]) -> list[Missions]:
    """Return the calibrated missions, platform by platform."""
    missions = []
    for platform, some in by_platform([result for result in results if result.sensors and result.time_span_s]).items():
        spans_s = np.array([result.time_span_s for result in some])
        values = {kind: _table(some, kind.key()) for kind in ERROR_KINDS}
        errors = {kind: _table(some, kind.key("standard_error")) for kind in ERROR_KINDS}
        missions.append(Missions(platform, spans_s.mean(axis=1), float(np.ptp(spans_s, axis=1).max()), values, errors))
    return missions


def all_drifts(results: Sequence[Result]) -> list[ParameterDrift]:
    """Return the drifts of all parameters, platform by platform."""
    return [drift for missions in all_missions(results) for drift in missions.drifts()]


def counts_of(results: Sequence[Result]) -> dict[str, int]:
    """Return the number of recordings by status and by verdict, by the names of the columns."""
    status = Counter(result.status for result in results)
    verdicts = Counter(result.verdict for result in results if result.verdict)
    return {
        "recordings": len(results),
        **{name: status[name] for name in ("done", "refused", "failed")},
        "no gap": verdicts["no_gap"],
        "explained": verdicts["explained"],
        "open": sum(times for verdict, times in verdicts.items() if verdict not in ANSWERS),
    }


def causes_of(results: Sequence[Result]) -> dict[str, int]:
    """Return in how many recordings each cause was found, the most frequent first."""
    causes = sorted(cause for result in results if result.gap for cause in result.gap["causes"])
    return dict(Counter(causes).most_common())


def law_points(results: Sequence[Result]) -> list[str]:
    """Return each law of a gap of each platform, in how many recordings it is and since when, the most frequent first.

    Parameters
    ----------
    results : sequence of Result
        Sorted by platform and time.
    """
    groups: dict[tuple[str, str], list[Result]] = {}
    for result in results:
        for law in () if result.gap is None else result.gap.get("laws", ()):
            groups.setdefault((result.platform, law), []).append(result)
    ranked = sorted(groups.items(), key=lambda item: -len(item[1]))
    return [f"{platform}, {law}: {_occurrences(some)}" for (platform, law), some in ranked]


def _occurrences(results: Sequence[Result]) -> str:
    begins = [result.time_span_s[0] for result in results if result.time_span_s and has_date(result.time_span_s[0])]
    since = f", since {datetime.fromtimestamp(min(begins), UTC):%Y-%m-%d}" if begins else ""
    return f"{len(results)} recording{'s' * (len(results) > 1)}{since}"


COUNTS_HEADER = ("platform", *counts_of([]), "causes")
DRIFT_HEADER = ("platform", "sensor", "parameter", "missions", "drift per day", "over its error", "scatter", "mean")


def count_rows(results: Sequence[Result]) -> list[list[str]]:
    """Return a row for each platform, under ``COUNTS_HEADER``."""
    rows = []
    for platform, some in by_platform(results).items():
        causes = ", ".join(f"{cause} {times}" for cause, times in causes_of(some).items())
        rows.append([platform, *map(str, counts_of(some).values()), causes or "–"])
    return rows


def drift_row(found: ParameterDrift) -> list[str]:
    """Return the row of a drift, under ``DRIFT_HEADER``."""
    drift, unit = found.drift, f" ({found.kind.sign})" if found.kind.sign else ""
    return [
        found.platform,
        str(found.sensor),
        found.name + unit,
        str(drift.missions),
        blocks.with_error(drift.per_day, drift.per_day_standard_error, 6),
        blocks.number(drift.significance),
        blocks.number(drift.scatter),
        blocks.with_error(drift.mean, drift.mean_standard_error, 6),
    ]


def largest(drifts: Sequence[ParameterDrift]) -> list[ParameterDrift]:
    """Return the drift of each platform and kind of parameter that stands out most over its standard error."""
    some = [found for found in drifts if abs(found.drift.significance) > 0]
    groups = groupby(some, lambda found: (found.platform, found.kind.name))
    return [max(group, key=lambda found: abs(found.drift.significance)) for _, group in groups]


def open_points(results: Sequence[Result]) -> list[str]:
    """Return for each recording that is not settled what is the matter with it."""
    points = []
    for result in results:
        statement = "" if result.gap is None or result.is_settled else f"{result.gap['statement']}"
        if words := "; ".join(part for part in (result.trouble, statement) if part):
            points.append(f"{result.platform}/{result.recording}: {result.status}; {words}")
    return points


@in_style
def plot_missions(missions: Missions, kind: ErrorKind) -> "Figure":
    """Draw three parameters of each sensor less their means, with standard errors, over time.

    Parameters
    ----------
    missions : Missions
        Of one platform, with M missions and K sensors.
    kind : ErrorKind
        Parameters to draw; those without a unit are drawn in ppm.
    """
    shown = kind.of_changes
    factor = shown.factor / kind.factor
    values, errors = factor * missions.values[kind], factor * missions.standard_errors[kind]
    sensor_count = values.shape[1]
    figure = new_figure(WIDTH_INCH, 1.5 * sensor_count + 0.4)
    panels = figure.subplots(sensor_count, sharex=True, squeeze=False)[:, 0]
    times = [datetime.fromtimestamp(time, UTC) for time in missions.time_s]
    for sensor, axes in enumerate(panels):
        for axis, color in enumerate(COLORS[:3]):
            if (errors[:, sensor, axis] > 0).any():
                value = values[:, sensor, axis]
                style = {"fmt": ".", "markersize": 5, "elinewidth": 0.9, "color": color, "label": kind.axes[axis]}
                axes.errorbar(times, value - np.nanmean(value), errors[:, sensor, axis], **style)
        _finish(axes, f"sensor {sensor + 1}")
    figure.supylabel(f"{kind.name} less its mean, {shown.sign}")
    return figure


def _finish(axes: "Axes", title: str) -> None:
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
    recordings = blocks.Table(header, list(map(_recording_cells, results)), numeric=False)
    drifts = map(_drift_section, all_missions(results))
    sections = [_overview(results), *drifts, blocks.Section("Recordings", [recordings])]
    subtitle = f"{blocks.counted(len(results), 'recording')} of {blocks.counted(len(by_platform(results)), 'platform')}"
    write_page(path, "Calibrations over many missions", subtitle, sections)


def _overview(results: Sequence[Result]) -> blocks.Section:
    points = open_points(results)
    settled = sum(result.is_settled for result in results)
    total = blocks.counted(len(results), "recording")
    words = f"{blocks.count(settled)} of {total} without a failure and without an open gap."
    verdict = blocks.Text(words, "doubt" if points else "good")
    parts: list[blocks.Block] = [verdict, blocks.Table(COUNTS_HEADER, count_rows(results))]
    if laws := law_points(results):
        parts += [blocks.Text("Laws of the gaps, whatever causes them:"), blocks.Points(laws)]
    if points:
        parts.append(blocks.Points(points))
    return blocks.Section("What was found", parts)


def _drift_section(missions: Missions) -> blocks.Section:
    drawn = [
        embed(plot_missions(missions, kind), f"{kind.name} over the missions", f"{kind.name} ± 1 standard error")
        for kind in ERROR_KINDS
    ]
    rows = [drift_row(found)[1:] for found in missions.drifts()]
    words = blocks.sentence(missions.no_drift) if missions.no_drift else _DRIFTS
    parts: list[blocks.Block] = [blocks.Text(words), blocks.Gallery(drawn), blocks.Table(DRIFT_HEADER[1:], rows)]
    return blocks.Section(f"Drift of {missions.platform}: {blocks.counted(len(missions.time_s), 'mission')}", parts)


def _recording_cells(result: Result) -> list[str]:
    start = "–"
    if result.time_span_s:
        start = f"{datetime.fromtimestamp(result.time_span_s[0], UTC):%Y-%m-%d %H:%M:%S}"
    gap = "–"
    if result.gap:
        before, after = (float("nan") if result.gap[key] is None else result.gap[key] for key in ("before", "after"))
        gap = f"{blocks.number(before)} → {blocks.number(after)}"
    verdict = result.verdict.replace("_", " ") or "–"
    return [result.recording, result.platform, start, blocks.count(result.samples), result.status, verdict, gap]


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
            | {name.replace(" ", "_"): times for name, times in counts_of(some).items()}
            | {"causes": causes_of(some)}
            for platform, some in by_platform(results).items()
        ],
        "drifts": [_drift_mapping(drift) for drift in all_drifts(results)],
        "recordings": [
            {key: value for key, value in asdict(result).items() if key not in ("sensors", "options")}
            for result in results
        ],
    }


def _drift_mapping(found: ParameterDrift) -> dict[str, Any]:
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
        for kind in ERROR_KINDS:
            for part in ("", "standard_error_"):
                columns = [f"sensor_{index}_{kind.key(part + axis)}" for axis in kind.columns]
                row |= zip(columns, sensor[kind.key(part.rstrip("_"))], strict=True)
    return row
