"""Recordings and calibrations that are well-formed and mean nothing."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.random import Generator
from numpy.typing import NDArray

from battery.recipes import Recipe
from battery.trial import May, Trial, pick

Readings = NDArray[np.float64]
"""(N, 1 + 3 · 4 + …): time [s], readings [nT] by sensor and axis, scalar [nT] and what else the table holds."""


def another_unit(rows: Readings, rng: Generator) -> str:
    """Read one axis, or one sensor, in another unit."""
    columns = _axis(rng) if rng.random() < 0.7 else _sensor(rng)
    factor = pick(rng, (1e-9, 1e-3, 1e3, 1e-5, 10.0, 0.1))
    rows[:, columns] *= factor
    return f"columns {columns} times {factor:g}"


def saturated(rows: Readings, rng: Generator) -> str:
    """End the range of an axis well within what it reads."""
    column = _axis(rng)
    limit = rng.uniform(0.3, 0.8) * np.abs(rows[:, column]).max()
    rows[:, column] = np.clip(rows[:, column], -limit, limit)
    return f"column {column} saturated at {limit:.0f} nT"


def coarse(rows: Readings, rng: Generator) -> str:
    """Read in steps that are hundreds of times the noise."""
    step = float(rng.uniform(500, 5000))
    rows[:, 1:13] = np.round(rows[:, 1:13] / step) * step
    return f"steps of {step:.0f} nT"


def copied(rows: Readings, rng: Generator) -> str:
    """Read one sensor twice, the second perhaps later."""
    one, other = rng.choice(4, size=2, replace=False)
    shift = int(rng.integers(0, 4))
    rows[:, _columns(other)] = np.roll(rows[:, _columns(one)], shift, axis=0)
    return f"sensor {other + 1} is sensor {one + 1} {shift} samples later"


def frozen(rows: Readings, rng: Generator) -> str:
    """Let a sensor stand still for a while."""
    columns = _sensor(rng)
    begin, count = _while(rng)
    rows[begin : begin + count, columns] = rows[begin, columns]
    return f"columns {columns} stand still for {count} samples from {begin}"


def zero(rows: Readings, rng: Generator) -> str:
    """Let a sensor read zero for a while: these readings are missing, which is told."""
    columns = _sensor(rng)
    begin, count = _while(rng)
    rows[begin : begin + count, columns] = 0.0
    return f"columns {columns} are zero for {count} samples from {begin}"


def stuck_bits(rows: Readings, rng: Generator) -> str:
    """Have bits of a converter always set: in steps of 1 nT."""
    column, bit = _axis(rng), int(rng.integers(10, 14))
    rows[:, column] = np.round(rows[:, column]).astype(int) | (1 << bit)
    return f"bit {bit} of column {column} is stuck"


def mirrored(rows: Readings, rng: Generator) -> str:
    """Have one axis of one sensor with the wrong sign: that of all sensors nobody can see without an attitude."""
    column = _axis(rng)
    rows[:, column] *= -1
    return f"column {column} mirrored"


def exchanged(rows: Readings, rng: Generator) -> str:
    """Have two axes of a sensor in each other's place."""
    columns = _sensor(rng)
    one, other = rng.choice(columns, size=2, replace=False)
    rows[:, [one, other]] = rows[:, [other, one]]
    return f"columns {one} and {other} exchanged"


def of_nothing(rows: Readings, rng: Generator) -> str:
    """Hold noise in the place of a sensor."""
    columns = _sensor(rng)
    rows[:, columns] = 3e4 * rng.normal(size=(len(rows), 3))
    return f"noise in columns {columns}"


def odd_times(rows: Readings, rng: Generator) -> str:
    """Be at no time, or at one of which nobody would be."""
    way = pick(rng, ("huge", "negative", "tiny steps", "far apart"))
    if way == "huge":
        rows[:, 0] = rows[:, 0] * 1e14 + 1e18
    elif way == "negative":
        rows[:, 0] -= 1e12
    elif way == "tiny steps":
        rows[:, 0] = np.arange(len(rows)) * 5e-324
    else:
        rows[len(rows) // 2 :, 0] += 10 ** rng.uniform(7, 16)
    return f"times {way}"


def _while(rng: Generator) -> tuple[int, int]:
    """Return the first sample and the number of samples of a third of the run."""
    return int(rng.integers(0, 250)), int(rng.integers(100, 150))


def _columns(sensor: int) -> list[int]:
    return [1 + 3 * int(sensor) + axis for axis in range(3)]


def _sensor(rng: Generator) -> list[int]:
    return _columns(int(rng.integers(4)))


def _axis(rng: Generator) -> int:
    return int(rng.integers(1, 13))


_FAULTS: tuple[tuple[Callable[[Readings, Generator], str], May], ...] = (
    (another_unit, May.REFUSE),
    (saturated, May.WARN),
    (coarse, May.WARN),
    (copied, May.REFUSE),
    (frozen, May.REFUSE),
    (zero, May.WARN),
    (stuck_bits, May.REFUSE),
    (mirrored, May.WARN),
    (exchanged, May.WARN),
    (of_nothing, May.REFUSE),
    (odd_times, May.DO_ANYTHING),
)


def spoil_recording(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Put a fault of a channel into the table that a recipe reads."""
    path = folder / "run.csv"
    header, *_ = path.read_text().splitlines()
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    if rng.random() < 0.1:
        rows = rows[: int(rng.integers(8, 12))]
        told, may = f"{len(rows)} rows", May.WARN
    else:
        fault, may = pick(rng, _FAULTS)
        told = fault(rows, rng)
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.17g")
    return Trial.of(recipe, told, may)


def spoil_calibration(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Put numbers that no sensor has into the calibration that a recipe reads."""
    path = folder / "calibration.yaml"
    content: dict[str, Any] = yaml.safe_load(path.read_text())
    sensor, axis = content["sensors"][int(rng.integers(4))], int(rng.integers(3))
    key, values = pick(
        rng,
        (
            ("scale_factor", (1e-12, 1e12, 0.0, -1.0, 1e-300, 0.01, 100.0)),
            ("bias_nT", (1e300, -1e18, 1e9, 3e6)),
            ("non_orthogonality_deg", (90.0, 89.999, 1e6, -90.0)),
        ),
    )
    sensor[key][axis] = pick(rng, values)
    sensor.pop("matrix", None)
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return Trial.of(recipe, f"{key} {sensor[key][axis]:g} of sensor {sensor['sensor']}", May.REFUSE)


def spoil_array(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Put sensors where no array can have them, or noise that none has."""
    path = folder / "array.yaml"
    content: dict[str, Any] = yaml.safe_load(path.read_text())
    line = np.outer(rng.uniform(-1, 1, 4), rng.normal(size=3)).tolist()
    changes: dict[str, dict[str, Any]] = {
        "sensors at one place": {"positions_m": [[0.1, 0.2, 0.3]] * 4},
        "two sensors at one place": {"positions_m": [[0.1, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]},
        "sensors far away": {"positions_m": (1e200 * rng.normal(size=(4, 3))).tolist()},
        "sensors too near": {"positions_m": (1e-200 * rng.normal(size=(4, 3))).tolist()},
        "noise of nothing": {"vector_noise_nT": float(10 ** rng.uniform(-320, -200))},
        "noise of everything": {"vector_noise_nT": float(10 ** rng.uniform(20, 307))},
        "negative noise": {"vector_noise_nT": -1.0},
        "negative scalar noise": {"scalar_noise_nT": -0.1},
        "no baseline": {"baseline_m": pick(rng, (0.0, -0.5, 1e-300, 1e300))},
        "sensors on a line": {"positions_m": line},
    }
    told = pick(rng, sorted(changes))
    content |= changes[told]
    if "positions_m" in changes[told]:
        content.pop("baseline_m", None)
    elif "baseline_m" in changes[told]:
        content.pop("positions_m", None)
    path.write_text(yaml.safe_dump(content))
    return Trial.of(recipe, told, May.WARN if told == "sensors on a line" else May.REFUSE)


def spoil_meaning(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Put nonsense into one of the files that a recipe reads."""
    ways = {"run.csv": spoil_recording, "calibration.yaml": spoil_calibration, "array.yaml": spoil_array}
    trial = ways[pick(rng, [name for name in recipe.reads if name in ways])](recipe, folder, rng)
    if "run.csv" in recipe.reads and (recipe.command != "calibrate" or "--effects" in recipe.line):
        return replace(trial, may=May.DO_ANYTHING)  # a diagnosis is there to tell it, a plan and a twin need not
    if trial.may is May.WARN and recipe.command == "plan":
        return replace(trial, may=May.DO_ANYTHING)  # what sensors on a line err by can be planned for
    return trial
