"""What is given out of a case, and its key."""

from typing import Any

import numpy as np
from numpy.random import Generator

from tam_calibration.blind.catalogue import CATALOGUE, CAUSES
from tam_calibration.blind.disturbance import Signal
from tam_calibration.blind.plan import Plan
from tam_calibration.blind.scaling import Scaled
from tam_calibration.blind.scene import Scene
from tam_calibration.units import FloatArray, from_degrees, to_nanotesla


def columns_of(rng: Generator, scene: Scene, plan: Plan, recorded: Signal) -> dict[str, FloatArray]:
    """Return the columns of the recording, the deciding channel left out when it is withheld."""
    vectors, scalar = recorded
    columns = {"time_s": scene.time_s}
    for sensor in range(scene.sensor_count):
        for axis, name in enumerate("xyz"):
            columns[f"b{sensor + 1}{name}_nT"] = to_nanotesla(vectors[:, sensor, axis])
    if scene.with_scalar:
        columns["scalar_nT"] = to_nanotesla(scalar)
    withheld = CATALOGUE[plan.effects[0]].channel if plan.kind == "withheld" else ""
    if "temperature" in scene.channels and withheld != "temperature":
        error_C = rng.normal(size=scene.sample_count) * rng.uniform(0.005, 0.05)
        columns["temperature_C"] = np.round(scene.temperature(scene.time_s) + error_C, 3)
    if "current" in scene.channels and withheld != "current":
        error_A = rng.normal(size=scene.sample_count) * rng.uniform(0.005, 0.03)
        columns["current_A"] = np.round(scene.current(scene.time_s) + error_A, 4)
    if "attitude" in scene.channels and withheld != "attitude":
        error = rng.normal(size=(scene.sample_count, 3)) * from_degrees(rng.uniform(0.01, 0.1))
        columns |= dict(zip(("qx", "qy", "qz", "qw"), _quaternions(scene.to_world, error).T, strict=True))
    return columns


def _quaternions(to_world: FloatArray, error: FloatArray) -> FloatArray:
    """Return the recorded attitudes (N, 4), x, y, z, w, turned by small errors."""
    from scipy.spatial.transform import Rotation

    return np.asarray((Rotation.from_matrix(to_world) * Rotation.from_rotvec(error)).as_quat())


def array_of(scene: Scene, sheet: FloatArray) -> dict[str, Any]:
    """Return what a user knows: the geometry, the data sheet's noise, how it was recorded."""
    arm = float(np.abs(scene.positions_m).max())
    geometry = {"baseline_m": 2 * arm} if scene.sensor_count == 4 else {"positions_m": scene.positions_m.tolist()}
    noise = {"vector_noise_nT": to_nanotesla(scene.vector_noise_T) / sheet[0]}
    if scene.with_scalar:
        noise["scalar_noise_nT"] = to_nanotesla(scene.scalar_noise_T) / sheet[1]
    recording = {"motion": scene.motion.kind, "rate_hz": 1 / scene.step_s}
    return geometry | {name: float(f"{value:.6g}") for name, value in noise.items()} | {"recording": recording}


def key_of(plan: Plan, scene: Scene, causes: list[Scaled], gap: float, sheet: FloatArray) -> dict[str, Any]:
    """Return the key: the causes with all that was drawn for them, and the conditions of the recording."""
    withheld = CATALOGUE[plan.effects[0]].channel if plan.kind == "withheld" else ""
    holes = bool((np.diff(scene.time_s) > 1.5 * scene.step_s).any())
    return {
        "kind": plan.kind,
        "effects": [_cause_key(cause) for cause in causes],
        "visible_gap": gap,
        "withheld_channel": withheld,
        "identifiable": plan.kind not in ("withheld", "short"),
        "samples": scene.sample_count,
        "sensors": scene.sensor_count,
        "motion": scene.motion.kind,
        "with_scalar": scene.with_scalar,
        "holes": holes,
        "noise_over_sheet": {"vector": float(sheet[0]), "scalar": float(sheet[1])},
        "vector_noise_nT": to_nanotesla(scene.vector_noise_T),
        "scalar_noise_nT": to_nanotesla(scene.scalar_noise_T),
    }


def _cause_key(cause: Scaled) -> dict[str, Any]:
    disturbance = cause.disturbance
    entry = CAUSES[disturbance.effect]
    struck = int((np.abs(cause.signal[0]).sum(axis=(1, 2)) + np.abs(cause.signal[1]) > 0).sum())
    return {
        "effect": disturbance.effect,
        "sensors": list(disturbance.sensors),
        "axes": list(disturbance.axes),
        "visible_gap": cause.visible_gap,
        "amplitude": cause.amplitude,
        "amplitude_unit": disturbance.amplitude_unit,
        "samples_changed": struck,
        "parameters": disturbance.parameters,
        "coefficients": {name: value * cause.amplitude for name, value in disturbance.coefficients.items()},
        "named": entry.named,
        "sealed": entry.sealed,
    }
