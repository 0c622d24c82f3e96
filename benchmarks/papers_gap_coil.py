"""The coil of Wu 2025, section 4.2, located at 12 headings by constrained Euler, with faults of array or survey."""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from tam_calibration.array import Array
from tam_calibration.errors import SensorErrors
from tam_calibration.localization.euler import locate
from tam_calibration.localization.loop import Loop
from tam_calibration.simulation import Simulation
from tam_calibration.units import FloatArray, from_degrees

COIL_M, COIL_RADIUS_M, COIL_MOMENT_AM2 = np.array([2.40, -1.00, 0.46]), 0.445, 440.0
HEADINGS = Rotation.from_euler("z", 2 * np.pi * np.arange(12)[:, None] / 12)

Fault = Callable[[np.random.Generator], tuple[FloatArray, FloatArray, FloatArray]]


def distance_error(
    true: SensorErrors, found: SensorErrors, array: Array, axis: FloatArray, points_m: FloatArray, coil_m: FloatArray
) -> tuple[float, float]:
    """Return RMSE of the coil's distance and of its position over the headings, metres.

    ``points_m`` (4, 3, 3) is where each axis of each sensor really is, ``coil_m`` where the coil really is.
    """
    places = np.einsum("nij,kaj->nkai", HEADINGS.as_matrix(), points_m)
    loop = Loop(coil_m, COIL_MOMENT_AM2 * axis, COIL_RADIUS_M)
    field = np.einsum("nji,nkaj->nkai", HEADINGS.as_matrix(), loop.field_T(places))
    readings = np.einsum("kai,nkai->nka", true.matrix, field)
    corrected = np.einsum("kij,nkj->nki", np.linalg.inv(found.matrix), readings)
    solutions = locate(corrected.reshape(len(corrected), -1) @ array.operator.T)
    position = HEADINGS.apply(solutions.position_m)
    known = np.isfinite(position).all(axis=1)
    distance = np.linalg.norm(position[known], axis=1) - np.linalg.norm(COIL_M)
    offset = np.linalg.norm(position[known] - COIL_M, axis=1)
    return float(np.sqrt(np.mean(distance**2))), float(np.sqrt(np.mean(offset**2)))


def in_place(array: Array) -> FloatArray:
    """Return the places (4, 3, 3) of all axes, each in the middle of its sensor."""
    return np.repeat(array.positions_m[:, None], 3, axis=1)


def faults(array: Array) -> dict[str, Fault]:
    """Return what can be wrong: a factor (4, 3, 3) of the matrices, the places of the axes, that of the coil."""
    exact, places = np.tile(np.eye(3), (4, 1, 1)), in_place(array)

    def gains(size: float) -> Fault:
        return lambda random: (exact * (1 + size * random.normal(size=(4, 1, 3))), places, COIL_M)

    def turns(size_deg: float) -> Fault:
        def turned(random: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
            return Rotation.from_rotvec(from_degrees(size_deg) * random.normal(size=(4, 3))).as_matrix(), places, COIL_M

        return turned

    return {
        "none": lambda random: (exact, places, COIL_M),
        "gain at 10 Hz, 1 % from axis to axis": gains(0.01),
        "gain at 10 Hz, 5 % from axis to axis": gains(0.05),
        "flexure, 0.1° about each axis": turns(0.1),
        "flexure, 1° about each axis": turns(1.0),
        "all sensors turned together by 5°": lambda random: (
            np.tile(Rotation.from_rotvec([0, 0, from_degrees(5.0)]).as_matrix(), (4, 1, 1)), places, COIL_M
        ),
        "baseline 2 % short": lambda random: (exact, 0.98 * places, COIL_M),
        "baseline 10 % short": lambda random: (exact, 0.9 * places, COIL_M),
        "baseline 10 % long": lambda random: (exact, 1.1 * places, COIL_M),
        "axes 5 mm from the middle of their sensor": lambda random: (
            exact, places + 0.005 * random.normal(size=(4, 3, 3)) / np.sqrt(3), COIL_M
        ),
        "axes 20 mm from the middle of their sensor": lambda random: (
            exact, places + 0.02 * random.normal(size=(4, 3, 3)) / np.sqrt(3), COIL_M
        ),
        "coil surveyed 0.1 m wrong": lambda random: (exact, places, COIL_M + 0.1 * random.normal(size=3) / np.sqrt(3)),
    }  # fmt: skip


def coil_table(run: Simulation, draws: int) -> list[list[str]]:
    """Return a row for each fault: median RMSE of the coil's distance and position, and those without calibration."""
    array, rows = run.scenario.array, []
    none = SensorErrors.none(4)
    for name, fault in faults(array).items():
        for found, suffix in ((run.errors, ""), (none, ", not calibrated")):
            if suffix and name != "none":
                continue
            results = []
            for draw in range(draws):
                generator = np.random.default_rng([draw, 1])
                axis = generator.normal(size=3)
                factor, places, coil_m = fault(generator)
                true = SensorErrors.from_matrix(run.errors.matrix @ factor, run.errors.bias_T)
                results.append(distance_error(true, found, array, axis / np.linalg.norm(axis), places, coil_m))
            distance, position = np.median(results, axis=0)
            rows.append([name + suffix, f"{distance:.3f}", f"{position:.3f}"])
    return rows
