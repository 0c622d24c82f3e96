"""Reproduced papers as CSV, with the command that made it in the first line."""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import StringIO

from tam_calibration.reproduce.row import Row
from tam_calibration.reproduce.sweep import Sweep
from tam_calibration.reproduce.wu2025_coil_sweeps import CoilSweep
from tam_calibration.reproduce.wu2025_sweeps import GROUPS, HELD_OUT, IN_SAMPLE, RELATIVE_ERROR
from tam_calibration.units import FloatArray, to_nanotesla

_ROW_HEADER = ("number", "unit", "paper", "ours", "ratio", "status", "recorded", "reason")
_DATA = (IN_SAMPLE, HELD_OUT)
_SWEEP_HEADER = (
    "sweep", "setting", "unit", "value", "source",
    *(f"mean relative error, {group}" for group in GROUPS),
    *(f"e_B{sensor}_nT {data}" for data in _DATA for sensor in range(1, 5)),
    *(f"e_T_nT_per_m {data}" for data in _DATA),
)  # fmt: skip
_COIL_HEADER = ("error", "unit", "size", "least_r_m", "median_r_m", "largest_r_m", "needed_size")


def rows_to_csv(rows: Sequence[Row], command: str) -> str:
    """Return every number of a paper."""
    lines = [
        (row.name, row.unit, f"{row.paper:.9g}", *_numbers(row.ours, row.ratio), row.status, row.recorded, row.reason)
        for row in rows
    ]
    return _to_csv(command, _ROW_HEADER, lines)


def sweeps_to_csv(sweeps: Mapping[str, Sweep], command: str) -> str:
    """Return the curves of the figures: means over the runs, and over the parameters of a kind."""
    return _to_csv(command, _SWEEP_HEADER, [line for sweep in sweeps.values() for line in _lines(sweep)])


def coil_sweeps_to_csv(sweeps: Sequence[CoilSweep], command: str) -> str:
    """Return the errors of the distance of Wu's coil over the size of each error that his model leaves out."""
    lines = [
        (sweep.name, sweep.unit, f"{size:g}", *_numbers(*figures, sweep.needed))
        for sweep in sweeps
        for size, figures in zip(sweep.size, sweep.distance_rmse_m, strict=True)
    ]
    return _to_csv(command, _COIL_HEADER, lines)


def _lines(sweep: Sweep) -> Iterator[Sequence[str]]:
    plan = sweep.plan
    for source in dict.fromkeys(source for source, _ in sweep.values):
        means = {quantity: sweep.mean(source, quantity) for other, quantity in sweep.values if other == source}
        for index, value in enumerate(plan.points):
            point = {quantity: mean[index] for quantity, mean in means.items()}
            yield plan.name, plan.symbol, plan.unit, f"{value:g}", source, *_relative(point), *_residuals(point)


def _relative(point: Mapping[str, FloatArray]) -> list[str]:
    error = point.get(RELATIVE_ERROR)
    return [""] * len(GROUPS) if error is None else _numbers(*(error[columns].mean() for columns in GROUPS.values()))


def _residuals(point: Mapping[str, FloatArray]) -> list[str]:
    keys = [f"{quantity} {data}" for quantity in ("e_B", "e_T") for data in _DATA]
    if keys[0] not in point:
        return [""] * 10
    return _numbers(*(to_nanotesla(value) for key in keys for value in point[key]))


def _numbers(*values: float) -> list[str]:
    return [f"{value:.7g}" for value in values]


def _to_csv(command: str, header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    text = StringIO()
    text.write(f"# {command}\n")
    csv.writer(text, lineterminator="\n").writerows([header, *lines])
    return text.getvalue()
