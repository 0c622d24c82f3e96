"""Gross mistakes of a simulator: in what it simulates, in what it adds, in what it writes."""

from dataclasses import replace

import numpy as np
from numpy.random import Generator
from vehicle import VehicleRun

from pairs.run import Run
from tam_calibration.model.units import FloatArray

NED_FOR_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""What NED makes of a vector in ENU; they are exchanged alike."""

FIELDS = {
    "ned_for_enu": NED_FOR_ENU,
    "wrong_hemisphere": np.diag([1.0, 1.0, -1.0]),
    "no_world_field": np.zeros((3, 3)),
}
"""What each mistake makes of the world's field."""

UNITS_T = (1.0, 1e-4, 1e-6)
"""Tesla, gauss, microtesla: the unit in which a deviation was squared."""


def mistaken_vehicle(rng: Generator, vehicle: VehicleRun, mistake: str) -> VehicleRun:
    """Return what is simulated in place of a run, with some mistakes."""
    if mistake in FIELDS:
        return replace(vehicle, field_T=FIELDS[mistake] @ vehicle.field_T)
    if mistake == "variance_for_deviation":
        unit_T = float(rng.choice(UNITS_T))
        return replace(vehicle, vector_noise_T=float(np.mean(vehicle.vector_noise_T) / unit_T) ** 2 * unit_T)
    return vehicle


def mistaken_run(rng: Generator, run: Run, mistake: str) -> Run:
    """Return a run with the mistakes that lie in the noise."""
    vectors, scalar = run.noise
    if mistake == "same_noise_in_channels":
        vectors = np.repeat(vectors[:, :1], vectors.shape[1], axis=1)
    if mistake == "same_noise_again":
        vectors = np.resize(vectors[: int(rng.integers(200, 700))], vectors.shape)
    return Run(run.scene, (vectors, scalar))


def mistaken_columns(rng: Generator, columns: dict[str, FloatArray], mistake: str) -> dict[str, FloatArray]:
    """Return the columns of a simulation with the mistakes that lie in what it writes."""
    fields = [name for name in columns if name.endswith("_nT")]
    axes = [name for name in fields if name != "scalar_nT"]
    factors = dict.fromkeys(columns, 1.0)
    if mistake in ("gauss_for_tesla", "microtesla_for_tesla"):
        factors |= dict.fromkeys(fields, 1e4 if mistake == "gauss_for_tesla" else 1e6)
    if mistake == "frd_for_flu":
        factors |= {name: -1.0 for name in axes if name[2] in "yz"}
    if mistake == "mirrored_axis":
        factors[str(rng.choice(axes))] = -1.0
    written = {name: factors[name] * values for name, values in columns.items()}
    if mistake == "attitude_wxyz":
        ordered = [columns[name] for name in ("qw", "qx", "qy", "qz")]
        written |= dict(zip(("qx", "qy", "qz", "qw"), ordered, strict=True))
    return written
