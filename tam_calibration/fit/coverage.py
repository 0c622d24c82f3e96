"""How well the directions of the field cover the sphere, what is missing, and what to do next.

The nine parameters of the ellipsoid of one sensor against the intensity need most coverage; their information is a
sum over directions u of the outer product of (u ⊗ u, u), so that a count and a mean direction per cell suffice.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, IntArray

BANDS, SECTORS = 10, 20
CELLS = BANDS * SECTORS

ENOUGH_RELATIVE_ERROR = 50.0
"""Above this ratio to the full sphere's standard errors small flaws of the model would be blown up."""

ENOUGH_STANDARD_ERROR = 2.0
"""Largest standard error of bias, and of scale factor and angle times the field, in units of the sensor noise."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """The field directions that a recording visited, in the array frame.

    Parameters
    ----------
    directions : (200, 3) array
        Unit vectors to the centres of cells of equal area.
    counts : (200,) array
        Samples in each cell.
    fraction : float
        Part of the cells that hold a sample.
    relative_error : float
        Worst standard error over that of as many samples over the full sphere; infinite when undetermined.
    enough : bool
        Whether every parameter's standard error will be small against the sensor noise.
    missing : str
        Where the largest empty part of the sphere lies, in words; empty when there is none.
    advice : str
        What to do next, one line.
    """

    directions: FloatArray
    counts: IntArray
    fraction: float
    relative_error: float
    enough: bool
    missing: str
    advice: str


def cell_directions() -> FloatArray:
    """Return the (200, 3) unit vectors to the cells' centres: bands from the south to the north, sectors by azimuth."""
    z = (np.arange(BANDS) + 0.5) / BANDS * 2 - 1
    azimuth = (np.arange(SECTORS) + 0.5) / SECTORS * 2 * np.pi - np.pi
    radius = np.sqrt(1 - z**2)
    columns = np.outer(radius, np.cos(azimuth)), np.outer(radius, np.sin(azimuth)), np.outer(z, np.ones(SECTORS))
    return np.stack(columns, axis=-1).reshape(-1, 3)


def cell_of(direction: FloatArray) -> IntArray:
    """Return the cell numbers (N,) of unit vectors (N, 3)."""
    band = np.clip(((direction[:, 2] + 1) / 2 * BANDS).astype(int), 0, BANDS - 1)
    turn = (np.arctan2(direction[:, 1], direction[:, 0]) + np.pi) / (2 * np.pi)
    return np.asarray(band * SECTORS + np.clip((turn * SECTORS).astype(int), 0, SECTORS - 1))


def measure_coverage(field_T: FloatArray) -> Coverage:
    """Return the coverage of fields (N, 3) in the array frame."""
    length = norm(field_T, axis=1, keepdims=True)
    direction = np.divide(field_T, length, out=np.zeros_like(field_T), where=length > 0)
    cell = cell_of(direction)
    counts: IntArray = np.bincount(cell, minlength=CELLS)
    sums: FloatArray = np.stack([np.bincount(cell, component, CELLS) for component in direction.T], axis=1)
    return judge_coverage(counts, sums)


def field_of(recording: Recording, errors: SensorErrors) -> FloatArray:
    """Return the field of a recording: the mean of its restored sensors.

    Parameters
    ----------
    recording : Recording
        Raw readings of K sensors.
    errors : SensorErrors
        By which the readings are corrected.

    Returns
    -------
    (N, 3) array
        Field in the array frame, tesla.
    """
    mean = np.concatenate(list(errors.inverse / errors.sensor_count), axis=1)
    offset_T = mean @ errors.bias_T.ravel()
    blocks = (block.readings_T.reshape(len(block.readings_T), -1) for block in recording.blocks())
    return np.concatenate([readings_T @ mean.T - offset_T for readings_T in blocks])


def describe(direction: FloatArray) -> str:
    """Return a direction of the array frame (x forward, y left, z up) in words."""
    names = (("forward", "backward"), ("left", "right"), ("up", "down"))
    order = np.argsort(-np.abs(direction))
    return " and ".join(names[axis][int(direction[axis] < 0)] for axis in order if abs(direction[axis]) > 0.38)


def judge_coverage(counts: IntArray, sums: FloatArray) -> Coverage:
    """Return the coverage of so many directions (200,) in each cell, and their sums (200, 3)."""
    directions = cell_directions()
    visited = counts > 0
    mean = sums[visited] / np.maximum(norm(sums[visited], axis=1, keepdims=True), np.finfo(float).tiny)
    rows = ellipsoid_rows(mean) * np.sqrt(counts[visited, None])
    information = rows.T @ rows
    full = ellipsoid_rows(directions)
    values, vectors = np.linalg.eigh(information)
    total = int(counts.sum())
    best = np.sqrt(np.diag(np.linalg.inv(full.T @ full / CELLS)))
    if total == 0 or values[0] < 1e-12 * max(values[-1], 1):
        standard_error, relative = np.inf, np.inf
    else:
        errors = np.sqrt(np.diag((vectors / values) @ vectors.T))
        standard_error, relative = float(errors.max()), float((errors / best).max() * np.sqrt(total))
    enough = relative <= ENOUGH_RELATIVE_ERROR and standard_error <= ENOUGH_STANDARD_ERROR
    target = directions[int(np.argmax(np.abs(full @ vectors[:, 0]) * ~visited))]
    fraction = float(visited.mean())
    missing = "" if visited.all() else describe(target)
    if enough:
        advice = f"enough: {fraction:.0%} of the sphere seen, the calibration can be run"
    else:
        where = describe(target)
        advice = f"turn the array so that the field points {where} of it ({fraction:.0%} of the sphere seen)"
    return Coverage(directions, counts, fraction, relative, enough, missing, advice)


def ellipsoid_rows(direction: FloatArray) -> FloatArray:
    """Return the (N, 9) derivatives of the intensity by symmetric matrix and bias of one sensor."""
    x, y, z = direction.T
    return np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, x, y, z], axis=1)
