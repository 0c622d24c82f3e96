"""The summaries of a batch: ``summary.json``, ``summary.csv`` with a row for each recording, and a page."""

import csv
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tam_calibration.files.json_text import to_json
from tam_calibration.files.whole import write_whole
from tam_calibration.fleet.counts import causes_of, counts_of
from tam_calibration.fleet.page import write_page
from tam_calibration.fleet.parameters import GROUPS, ParameterDrift, all_drifts, by_platform
from tam_calibration.fleet.result import Result

SCHEMA = "tam_calibration/batch/1"


def write_summaries(out: Path, results: Sequence[Result]) -> None:
    """Write the summaries into a folder.

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
    with write_whole(out / "summary.json") as beside:
        beside.write_text(to_json(summary_to_mapping(results)), encoding="utf-8")
    with write_whole(out / "summary.csv") as beside, beside.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(summary_rows(results))
    with write_whole(out / "summary.html") as beside:
        write_page(beside, results)


def summary_to_mapping(results: Sequence[Result]) -> dict[str, Any]:
    """Return the content of ``summary.json``: counts, drifts and the recordings without their parameters."""
    return {
        "schema": SCHEMA,
        "platforms": [
            {"platform": platform}
            | {name.replace(" ", "_"): number for name, number in counts_of(some).items()}
            | {"causes": causes_of(some)}
            for platform, some in by_platform(results).items()
        ],
        "drifts": [_drift(drift) for drift in all_drifts(results)],
        "recordings": [
            {key: value for key, value in asdict(result).items() if key not in ("sensors", "options")}
            for result in results
        ],
    }


def _drift(found: ParameterDrift) -> dict[str, Any]:
    unit = f"_{found.group.suffix}" if found.group.suffix else ""
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


def summary_rows(results: Sequence[Result]) -> list[list[Any]]:
    """Return the header and the rows of ``summary.csv``; a cell is empty where there is nothing."""
    sensors = max((len(result.sensors) for result in results), default=0)
    header = ["platform", "recording", "path", "status", "verdict", "start_s", "end_s", "samples"]
    header += ["gap_before", "gap_after", "gap_closed", "causes", "problems"]
    header += [name for sensor in range(1, sensors + 1) for name in _columns(sensor)]
    return [header, *(_row(result, len(header)) for result in results)]


def _columns(sensor: int) -> list[str]:
    names = []
    for group in GROUPS:
        for key in (group.key, group.standard_error_key):
            stem = key.removesuffix(f"_{group.suffix}") if group.suffix else key
            names += [f"sensor_{sensor}_{stem}_{axis}_{group.suffix}".rstrip("_") for axis in group.columns]
    return names


def _row(result: Result, width: int) -> list[Any]:
    gap = result.gap or {"before": "", "after": "", "closed": "", "causes": []}
    row: list[Any] = [result.platform, result.recording, result.path, result.status, result.verdict]
    row += [*(result.time_span_s or ("", "")), result.samples]
    row += [gap["before"], gap["after"], gap["closed"], " ".join(gap["causes"]), result.trouble]
    for sensor in result.sensors:
        for group in GROUPS:
            row += [*sensor[group.key], *sensor[group.standard_error_key]]
    return row + [""] * (width - len(row))
