"""Survey lines with known targets: an own law of the dipole, own paths, navigation and attitude with their errors.

Nothing of the package's fields or of its estimator is used. ``made`` kinds were there while rules were made; ``judged``
kinds have other physics: another array and speed, drifts and sways of other shapes, a regional field of far bodies.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from scipy.spatial.transform import Rotation, RotationSpline

from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla

EARTH_T, NOISE_T = np.array([1.2e-6, 20.5e-6, -44.0e-6]), from_nanotesla(0.1)
"""Field of middle latitudes, east, north, up, and noise of each axis."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What a line passes: bodies by their centres, moments and whether each is extended; what was stated; the path."""

    position_m: FloatArray
    moment_Am2: FloatArray
    is_extended: np.ndarray
    signal: FloatArray
    error_m: float
    drift_m: float
    attitude: float
    path_m: FloatArray


def dipoles_T(points: FloatArray, places: FloatArray, moments: FloatArray) -> FloatArray:
    """Return the field (N, K, 3) of dipoles (S, 3) at points (N, K, 3): 1e-7 (3 r (m·r)/r⁵ - m/r³)."""
    total = np.zeros(points.shape)
    for place, moment in zip(places, moments, strict=True):
        offset = points - place
        square = np.sum(offset**2, axis=-1, keepdims=True)
        total += 1e-7 * (3 * offset * (offset @ moment)[..., None] / square**2.5 - moment / square**1.5)
    return total


def wandering(rng: np.random.Generator, time_s: FloatArray, lasting_s: float, width: int = 3) -> FloatArray:
    """Return (N, width) noise of unit variance that lasts: an Ornstein-Uhlenbeck process, white where it does not."""
    drawn = rng.standard_normal((len(time_s), width))
    if lasting_s <= 0:
        return drawn
    keep = np.exp(-np.diff(time_s, prepend=time_s[0]) / lasting_s)
    for number in range(1, len(drawn)):
        drawn[number] = keep[number] * drawn[number - 1] + np.sqrt(1 - keep[number] ** 2) * drawn[number]
    return drawn


def waves(rng: np.random.Generator, time_s: FloatArray, periods: tuple[float, float], width: int = 3) -> FloatArray:
    """Return (N, width) sums of three waves of unit variance."""
    total = np.zeros((len(time_s), width))
    for _ in range(3):
        period, phase = rng.uniform(*periods, width), rng.uniform(0, 2 * np.pi, width)
        total += np.sqrt(2 / 3) * np.sin(2 * np.pi * time_s[:, None] / period + phase)
    return total


def drawn_targets(rng: np.random.Generator, count: int, length: float) -> tuple[FloatArray, FloatArray]:
    """Return places (count, 3) and moments (count, 3) of 20 to 500 A m² at 3 to 12 m from a line along x."""
    places = np.zeros((count, 3))
    for number in range(count):
        for _ in range(200):
            distance, angle = rng.uniform(3, 12), from_degrees(rng.uniform(-160, -20))
            place = np.array([rng.uniform(6, length - 6), distance * np.cos(angle), distance * np.sin(angle)])
            if not number or norm(places[:number] - place, axis=1).min() > 8:
                break
        places[number] = place
    moments = rng.standard_normal((count, 3))
    size = np.exp(rng.uniform(np.log(20), np.log(500), count))
    return places, moments / norm(moments, axis=1, keepdims=True) * size[:, None]


KINDS: dict[str, dict[str, tuple[float, float]]] = {
    "plain": {},
    "sway": {"sway": (0.05, 0.5)},
    "navigation": {"sway": (0.0, 0.3), "white": (0.05, 0.5), "drift": (0.05, 0.5)},
    "attitude": {"attitude": (0.05, 0.3), "lasting": (0.0, 10.0)},
    "regional": {"bend": (0.0, 0.002)},
    "all": {
        "sway": (0.0, 0.5),
        "white": (0.05, 0.5),
        "drift": (0.05, 0.5),
        "attitude": (0.05, 0.3),
        "lasting": (0.0, 10.0),
        "bend": (0.0, 0.002),
    },
    "extended": {"sway": (0.0, 0.3), "white": (0.0, 0.1), "attitude": (0.0, 0.1)},
    "nothing": {"sway": (0.0, 0.3), "attitude": (0.0, 0.3), "lasting": (0.0, 10.0)},
    "gyroscope": {
        "sway": (0.0, 0.3),
        "white": (0.0, 0.1),
        "attitude": (0.5, 1.5),
        "lasting": (2.0, 10.0),
        "rate_noise": (0.004, 0.045),
    },
}
"""Kinds of lines by what is drawn from where; what is not named is zero. Rate noise: °/s/√Hz of a gyroscope."""


def line_of(kind: str, seed: int, judged: bool = False, length: float = 200.0) -> tuple[Recording, Array, Truth]:
    """Return a recorded line, its array and the truth."""
    rng = np.random.default_rng([seed, int(judged), list(KINDS).index(kind)])
    ranges = KINDS[kind]

    def draw(name: str) -> float:
        return float(rng.uniform(*ranges.get(name, (0.0, 0.0))))

    speed, rate = (1.6, 8.0) if judged else (1.0, 10.0)
    array = Array.cross(0.4 if judged else 0.5, vector_noise_T=NOISE_T)
    time_s = np.arange(int(length / speed * rate)) / rate
    path = np.outer(time_s, [speed, 0, 0])
    shape = wandering_smooth(rng, time_s) if judged else waves(rng, time_s, (6, 20))
    path += draw("sway") * shape * [0.1, 1, 1]
    angles = from_degrees(5.0) * waves(rng, time_s, (4, 10)) * [1, 0.6, 0.6]
    true = Rotation.from_euler("zyx", angles)
    count = int(rng.integers(1, 13))
    if kind == "nothing":
        count = 0
    places, moments = drawn_targets(rng, count, length)
    extended = np.zeros(count, dtype=bool)
    parts = [(place[None], moment[None]) for place, moment in zip(places, moments, strict=True)]
    if kind == "extended":
        places, moments, parts = places[:3], moments[:3], parts[:3]
        centre = np.array([length / 2, rng.uniform(-2, 2), -rng.uniform(5, 8)])
        spread = rng.uniform(-3, 3, (8, 3)) * [1, 0.4, 0.15]
        own = rng.standard_normal((8, 3)) * 60 + [0, 20, -60]
        apart = norm(places - centre, axis=1) > 15
        parts = [part for part, far in zip(parts, apart, strict=True) if far] + [(centre + spread, own)]
        places = np.vstack([places[apart], centre])
        moments = np.vstack([moments[apart], own.sum(axis=0)])
        extended = np.append(np.zeros(apart.sum(), dtype=bool), True)
    matrix = true.as_matrix()
    points = path[:, None] + np.einsum("nij,kj->nki", matrix, array.positions_m)
    own_fields = [dipoles_T(points, *part) for part in parts]
    signal = np.array([norm(each.mean(axis=1), axis=1).max() / NOISE_T for each in own_fields])
    field = sum(own_fields, np.broadcast_to(EARTH_T, points.shape))
    if judged:
        far = rng.standard_normal((3, 3)) * [1, 1, 0.2]
        far = far / norm(far, axis=1, keepdims=True) * rng.uniform(150, 400, (3, 1)) + [length / 2, 0, -80]
        field = field + dipoles_T(points, far, rng.standard_normal((3, 3)) * 3e5)
    else:
        tensor = rng.standard_normal((3, 3)) * 0.5e-9
        tensor = tensor + tensor.T
        tensor -= np.eye(3) * np.trace(tensor) / 3
        field = field + points @ tensor
        bend, (x, y, z) = draw("bend") * 1e-9, np.moveaxis(points - [length / 2, 0, 0], -1, 0)
        field = field + bend * np.stack([x**2 - z**2, 0 * y, -2 * x * z], axis=-1)
    readings = np.einsum("nji,nkj->nki", matrix, field) + NOISE_T * rng.standard_normal(field.shape)
    white, drift, attitude = draw("white"), draw("drift"), from_degrees(draw("attitude"))
    slow = waves(rng, time_s, (100, 400)) if judged else wandering(rng, time_s, float(rng.uniform(60, 200)))
    position = path + white * rng.standard_normal(path.shape) + drift * slow
    lasting = draw("lasting")
    error = attitude * (waves(rng, time_s, (4, 40)) if judged and lasting > 2 else wandering(rng, time_s, lasting))
    reported = true * Rotation.from_rotvec(error)
    rates = rates_of(rng, time_s, true, draw("rate_noise"), judged) if "rate_noise" in ranges else None
    recording = Recording(
        time_s, readings, attitude=reported.as_quat(), angular_velocity_rad_s=rates, position_m=position
    )
    return recording, array, Truth(places, moments, extended, signal, white, drift, attitude, path)


def rates_of(
    rng: np.random.Generator, time_s: FloatArray, true: Rotation, noise_deg: float, judged: bool
) -> FloatArray:
    """Return angular velocities (N, 3), rad/s: with noise and a bias, and judged ones with all else that errs."""
    rates = RotationSpline(time_s, true)(time_s, 1)
    bias = from_degrees(rng.uniform(0.1, 3.0)) * rng.standard_normal(3)
    if judged:
        late_s = rng.uniform(0.0, 0.05)
        rates = np.column_stack([np.interp(time_s - late_s, time_s, each) for each in rates.T])
        scale = np.eye(3) + 0.01 * rng.standard_normal((3, 3))
        rates = Rotation.from_rotvec(from_degrees(1.0) * rng.standard_normal(3)).apply(rates @ scale)
        bias = bias + from_degrees(0.003) * waves(rng, time_s, (100, 400))
    rate_hz = 1 / (time_s[1] - time_s[0])
    return np.asarray(rates + bias + from_degrees(noise_deg) * np.sqrt(rate_hz / 2) * rng.standard_normal(rates.shape))


def wandering_smooth(rng: np.random.Generator, time_s: FloatArray) -> FloatArray:
    """Return (N, 3) smooth wandering of unit variance that is no wave: a process filtered twice."""
    drawn = wandering(rng, time_s, 3.0)
    keep = np.exp(-(time_s[1] - time_s[0]) / 1.5)
    for _ in range(2):
        for number in range(1, len(drawn)):
            drawn[number] = keep * drawn[number - 1] + (1 - keep) * drawn[number]
    return np.asarray((drawn - drawn.mean(axis=0)) / drawn.std(axis=0))
