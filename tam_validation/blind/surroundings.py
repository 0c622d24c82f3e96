"""What stands or flows about an array, and what its scalar magnetometer makes of the field."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator
from scipy.interpolate import PchipInterpolator

from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_validation.blind.disturbance import (
    ALL,
    SCALAR,
    Disturbance,
    by_axis,
    draw_direction,
    draw_sensor,
    numbers,
    of_scalar,
    proportional,
    where_strong,
)
from tam_validation.blind.scene import Scene

_PERMEABILITY = 1e-7
"""μ0 / 4π in SI."""


def ambient_gradient(rng: Generator, scene: Scene) -> Disturbance:
    """Iron in the room, dipoles or a line of them, gives each place of the turning array another field."""
    distance_m = float(np.abs(scene.positions_m).max()) * rng.uniform(2.5, 10)
    first = distance_m * draw_direction(rng)
    count = int(rng.choice([1, 2, 3, 8]))
    if count == 8:
        places = first + np.linspace(-0.5, 1.5, count)[:, None] * distance_m * draw_direction(rng)
        moments = np.tile(draw_direction(rng), (count, 1))
    else:
        places = np.array([first] + [distance_m * rng.uniform(1, 2) * draw_direction(rng) for _ in range(count - 1)])
        moments = rng.normal(size=(count, 3))
    places = places * np.maximum(1, distance_m / norm(places, axis=1))[:, None]
    at = np.einsum("nij,kj->nki", scene.to_world, scene.positions_m)
    extra = sum(
        dipole(moment, at - place) - dipole(moment, -place) for place, moment in zip(places, moments, strict=True)
    )
    body = np.einsum("nji,nkj->nki", scene.to_world, extra)
    change = proportional((scene.through(body), np.zeros(scene.sample_count)))
    parameters = {"distance_m": distance_m, "dipoles": count}
    return Disturbance("ambient_gradient", (ALL,), (), change, "A m2", parameters)


def dipole(moment: FloatArray, away: FloatArray) -> FloatArray:
    """Return a dipole's field (…, 3) at distances (…, 3) from it."""
    distance = norm(away, axis=-1, keepdims=True)
    unit = away / distance
    return np.asarray(_PERMEABILITY * (3 * unit * (unit @ moment)[..., None] - moment) / distance**3)


def current_interference(rng: Generator, scene: Scene) -> Disturbance:
    """Lay a cable's two wires near one sensor or across the array, by the law of Biot and Savart."""
    load_A = scene.current(scene.time_s)
    while True:
        extra, center, near = _cable(rng, scene)
        # Not the mean current: an offset is the sensors' own.
        vectors = scene.through((load_A - load_A.mean())[:, None, None] * extra)
        sensors = where_strong(scene, vectors)
        if sensors is not None:
            break
    scalar = (load_A - load_A.mean()) * (scene.field_T @ center) / scene.intensity_T
    parameters = {"distance_m": near}
    # What a cable does to all sensors is told from the field by their differences only.
    field = to_nanotesla(np.einsum("kij,kj->ki", scene.response, extra))
    coefficients = {} if sensors == (ALL,) else by_axis(int(sensors[0]) - 1, "field", field[int(sensors[0]) - 1])
    change = proportional((vectors, scalar))
    return Disturbance(
        "current_interference", sensors, (), change, "A to an ampere recorded", parameters, coefficients=coefficients
    )


def _cable(rng: Generator, scene: Scene) -> tuple[FloatArray, FloatArray, float]:
    """Return the field of one ampere at the sensors (K, 3) and at the center (3,), and how near it passes."""
    size = max(0.1, float(np.abs(scene.positions_m).max()))
    close = rng.random() < 0.6
    anchor = scene.positions_m[draw_sensor(rng, scene)] if close else np.zeros(3)
    near = size * (rng.uniform(0.08, 0.2) if close else rng.uniform(2.0, 4.0))
    middle = anchor + near * draw_direction(rng)
    along, apart = draw_direction(rng), draw_direction(rng) * near * rng.uniform(0.1, 0.3)
    start, end = middle - 3 * near * along, middle + 3 * near * along
    at = np.concatenate([scene.positions_m, np.zeros((1, 3))])
    field_T = _wire(start, end, at) + _wire(end + apart, start + apart, at)
    return field_T[:-1], field_T[-1], near


def _wire(start: FloatArray, end: FloatArray, at: FloatArray) -> FloatArray:
    """Return the field (n, 3) of one ampere in a straight piece of wire."""
    along = (end - start) / norm(end - start)
    from_start, from_end = at - start, at - end
    across = np.cross(along, from_start)
    cosines = from_start @ along / norm(from_start, axis=1) - from_end @ along / norm(from_end, axis=1)
    return np.asarray(_PERMEABILITY * cosines[:, None] * across / (across**2).sum(axis=1, keepdims=True))


def geomagnetic_drift(rng: Generator, scene: Scene) -> Disturbance:
    """Let the scalar stand elsewhere, or drift: a day's curve, bays and wander that the vectors do not share."""
    share = scene.time_s / scene.duration_s
    noon, width = rng.uniform(0.1, 0.9), rng.uniform(0.15, 0.4)
    day = -np.exp(-(((share - noon) / width) ** 2)) * (1 + 0.4 * np.tanh((share - noon) / width))
    onset, decay = rng.uniform(0.0, 0.8), rng.uniform(0.08, 0.3)
    since = np.maximum(share - onset, 0)
    bay = np.exp(-since / decay) - np.exp(-3 * since / decay)
    knots = np.linspace(0, 1, int(rng.integers(5, 10)))
    wander = PchipInterpolator(knots, np.cumsum(rng.normal(size=len(knots))))(share)
    drift = rng.normal() * day + 1.5 * rng.normal() * bay + 0.3 * wander
    # Without a scalar it is the field itself that is wrongly held to be constant.
    signal = of_scalar(scene, 1e-9 * drift)
    if not scene.with_scalar:
        unit = scene.field_T / scene.intensity_T[:, None]
        same = np.repeat((drift[:, None] * unit)[:, None], scene.sensor_count, axis=1)
        signal = (scene.through(1e-9 * same), signal[1])
    sensors = (SCALAR,) if scene.with_scalar else (ALL,)
    return Disturbance("geomagnetic_drift", sensors, (), proportional(signal), "nT", {"noon": noon, "onset": onset})


def scalar_heading_error(rng: Generator, scene: Scene) -> Disturbance:
    """Let a pumped scalar err with the angle between the field and its axis, most near its dead zones."""
    axis = draw_direction(rng)
    cosine = scene.field_T @ axis / scene.intensity_T
    angle = np.arccos(np.clip(cosine, -1, 1))
    weights = rng.normal(size=3) * np.array([1.0, 1.0, 0.25])
    width = rng.uniform(0.35, 0.6)
    lobes = np.exp(-((angle / width) ** 2)) - np.exp(-(((np.pi - angle) / width) ** 2))
    error = weights[0] * np.sin(2 * angle) + weights[1] * cosine**3 + weights[2] * lobes
    parameters = {"axis": numbers(axis), "weights": numbers(weights), "lobe_width_rad": width}
    change = proportional(of_scalar(scene, 1e-9 * error))
    return Disturbance("scalar_heading_error", (SCALAR,), (), change, "nT", parameters)
