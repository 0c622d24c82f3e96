"""Offsets that step: a connector, a magnetised screw, a magnet put at a sensor and taken away."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.blind.disturbance import (
    Disturbance,
    Signal,
    by_axis,
    draw_axes,
    draw_direction,
    draw_sensor,
    named,
    numbers,
    of_sensors,
    proportional,
)
from tam_calibration.blind.scene import Scene
from tam_calibration.units import FloatArray


def bias_jump(rng: Generator, scene: Scene) -> Disturbance:
    """Let an offset step, once, or there and back, or again."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.3)
    times_s = _times(rng, scene.duration_s)
    on = np.searchsorted(times_s, scene.time_s) % 2.0
    parameters, steps = {"times_s": numbers(times_s), "magnet": False}, dict[str, float]()
    if mask.all() and scene.sensor_count > 1 and rng.random() < 0.5:
        parameters["magnet"] = True
        signal = _magnet(rng, scene, sensor, on)
    else:
        step = mask * rng.normal(size=3)
        signal = of_sensors(scene, {sensor: 1e-9 * np.outer(on, step)})
        # A third step may have another size to who does not know that it is there and back.
        steps = by_axis(sensor, "offset", step) if len(times_s) <= 2 else {}
    change = proportional(signal)
    return Disturbance(
        "bias_jump", (sensor + 1,), named(mask), change, "nT of the step", parameters, coefficients=steps
    )


def _times(rng: Generator, duration_s: float) -> FloatArray:
    """Draw when it steps: well inside the recording and well apart."""
    count = int(rng.choice([1, 1, 2, 2, 3]))
    while True:
        share = np.sort(rng.uniform(0.12, 0.88, count))
        if count == 1 or np.diff(share).min() > 0.12:
            return share * duration_s


def _magnet(rng: Generator, scene: Scene, sensor: int, on: FloatArray) -> Signal:
    """Put a small magnet at one sensor; the others and the scalar at the centre see little of it."""
    others = np.delete(scene.positions_m, sensor, axis=0) - scene.positions_m[sensor]
    place = scene.positions_m[sensor] + rng.uniform(0.08, 0.15) * norm(others, axis=1).min() * draw_direction(rng)
    moment = draw_direction(rng)
    extra = np.array([_dipole(moment, position - place) for position in [*scene.positions_m, np.zeros(3)]])
    extra *= 1e-9 / norm(extra[sensor])
    vectors = scene.through(on[:, None, None] * extra[:-1])
    return vectors, on * (scene.field_T @ extra[-1]) / scene.intensity_T


def _dipole(moment: FloatArray, away: FloatArray) -> FloatArray:
    distance = norm(away)
    unit = away / distance
    return np.asarray((3 * unit * (unit @ moment) - moment) / distance**3)
