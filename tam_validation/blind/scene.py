"""What is recorded: the world's field, the array in motion, its sensors and what is written down beside them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla
from tam_validation.blind.continuous_motion import ContinuousMotion, about, draw_motion
from tam_validation.blind.processes import draw_load, draw_wander, draw_weather

_TimeFunction = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Wish:
    """What a recording shall be like.

    Parameters
    ----------
    samples : int
        Before holes are cut.
    sensor_count : int
    motions : tuple of str
        Those allowed.
    with_scalar, with_holes : bool
    channels : tuple of str
        Of temperature, current and attitude, those recorded.
    coarse : bool
        Whether the sensors are as noisy as a phone's.
    """

    samples: int
    sensor_count: int
    motions: tuple[str, ...]
    with_scalar: bool
    with_holes: bool
    channels: tuple[str, ...]
    coarse: bool = False


@dataclass(frozen=True, eq=False)
class Scene:
    """A recording before noise and disturbances.

    Parameters
    ----------
    time_s : (N,) array
    duration_s, step_s : float
        Of the recording, and between two samples.
    motion : Motion
    world_field : callable
        From times (n,) to the field (n, 3) in the world [T].
    positions_m : (K, 3) array
    response : (K, 3, 3) array
        Reading of a sensor for a field in the array's frame.
    bias_T : (K, 3) array
    vector_noise_T, scalar_noise_T : float
        True standard deviations of white noise.
    with_scalar : bool
    channels : tuple of str
        Recorded beside the fields.
    temperature, current : callable
        From times (n,) to the surroundings' temperature [°C] and the load's current [A], recorded or not.
    """

    time_s: FloatArray
    duration_s: float
    step_s: float
    motion: ContinuousMotion
    world_field: _TimeFunction
    positions_m: FloatArray
    response: FloatArray
    bias_T: FloatArray
    vector_noise_T: float
    scalar_noise_T: float
    with_scalar: bool
    channels: tuple[str, ...]
    temperature: _TimeFunction = field(repr=False)
    current: _TimeFunction = field(repr=False)

    @property
    def sensor_count(self) -> int:
        """K."""
        return len(self.positions_m)

    @property
    def sample_count(self) -> int:
        """N, after the holes are cut."""
        return len(self.time_s)

    def field_at(self, time_s: FloatArray) -> FloatArray:
        """Return the field (n, 3) in the array's frame at any time."""
        return np.asarray(np.einsum("nji,nj->ni", self.motion.to_world(time_s), self.world_field(time_s)))

    def readings_at(self, time_s: FloatArray) -> FloatArray:
        """Return what the undisturbed sensors read (n, K, 3) at any time."""
        return np.asarray(np.einsum("kij,nj->nki", self.response, self.field_at(time_s)) + self.bias_T)

    def core(self, sensor: int) -> FloatArray:
        """Return an undisturbed sensor's reading (N, 3) without its bias, as a share of the intensity."""
        return np.asarray((self.readings_T[:, sensor] - self.bias_T[sensor]) / self.intensity_T.mean())

    @cached_property
    def to_world(self) -> FloatArray:
        """Rotations (N, 3, 3) of the samples."""
        return self.motion.to_world(self.time_s)

    @cached_property
    def field_T(self) -> FloatArray:
        """Field (N, 3) in the array's frame."""
        return self.field_at(self.time_s)

    @cached_property
    def readings_T(self) -> FloatArray:
        """Undisturbed readings (N, K, 3)."""
        return self.readings_at(self.time_s)

    @cached_property
    def intensity_T(self) -> FloatArray:
        """Magnitude of the field (N,)."""
        return np.asarray(norm(self.field_T, axis=1))

    def through(self, extra_T: FloatArray) -> FloatArray:
        """Return the change of the readings (N, K, 3) when the sensors meet an extra field (N, K, 3)."""
        return np.asarray(np.einsum("kij,nkj->nki", self.response, extra_T))


def draw_scene(rng: Generator, wish: Wish) -> Scene:
    """Draw a recording: a place on Earth, an array, a motion, a rate, noise and the surroundings."""
    rates = [rate for rate in (1, 2, 5, 10, 20, 50, 100) if wish.samples / rate >= 30]
    rate_hz = float(rng.choice(rates)) if rates else wish.samples / 40
    step_s = 1 / rate_hz
    duration_s = (wish.samples - 1) * step_s
    low_nT, high_nT = (20, 600) if wish.coarse else (0.1, 5)
    vector_noise = 10 ** rng.uniform(np.log10(low_nT), np.log10(high_nT))
    scalar_noise = min(10 ** rng.uniform(-2, 0), vector_noise)
    return Scene(
        time_s=_cut_holes(rng, np.arange(wish.samples) * step_s, wish.with_holes),
        duration_s=duration_s,
        step_s=step_s,
        motion=draw_motion(rng, str(rng.choice(wish.motions)), duration_s, wish.samples),
        world_field=_draw_field(rng, duration_s, wish.with_scalar),
        positions_m=_draw_positions(rng, wish.sensor_count),
        response=np.array([_draw_response(rng, aligned=k == 0) for k in range(wish.sensor_count)]),
        bias_T=from_nanotesla(rng.uniform(-3000, 3000, (wish.sensor_count, 3))),
        vector_noise_T=float(from_nanotesla(vector_noise)),
        scalar_noise_T=float(from_nanotesla(scalar_noise)),
        with_scalar=wish.with_scalar,
        channels=wish.channels,
        temperature=draw_weather(rng, duration_s),
        current=draw_load(rng, duration_s),
    )


def _cut_holes(rng: Generator, time_s: FloatArray, wanted: bool) -> FloatArray:
    keep = np.ones(len(time_s), dtype=bool)
    for _ in range(int(rng.integers(1, 5)) if wanted else 0):
        length = int(len(time_s) * rng.uniform(0.01, 0.08))
        start = int(rng.integers(1, len(time_s) - length - 1))
        keep[start : start + length] = False
    return time_s[keep]


def _draw_field(rng: Generator, duration_s: float, drifts: bool) -> _TimeFunction:
    """Draw a field of the Earth that drifts a little, which a scalar magnetometer sees as the vectors do."""
    dip = from_degrees(rng.uniform(-75, 75))
    heading = rng.uniform(0, 2 * np.pi)
    direction = np.array([np.cos(dip) * np.cos(heading), np.cos(dip) * np.sin(heading), -np.sin(dip)])
    mean_T = from_nanotesla(rng.uniform(28000, 62000)) * direction
    size = from_nanotesla(rng.uniform(0, 15, 3)) if drifts and rng.random() < 0.5 else np.zeros(3)
    wander = [draw_wander(rng, duration_s, 6) for _ in range(3)]
    return lambda time_s: mean_T + size * np.stack([one(time_s) for one in wander], axis=1)


def _draw_positions(rng: Generator, sensor_count: int) -> FloatArray:
    """Return the cross of four, a rod of two, a triangle or a star; one sensor stands at the centre."""
    arm = float(rng.choice([0.105, 0.15, 0.25, 0.4, 0.5]))
    star = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]) * arm
    if sensor_count == 3:
        turn = 2 * np.pi / 3 * np.arange(3)
        return arm * np.stack([np.cos(turn), np.sin(turn), np.zeros(3)], axis=1)
    chosen: dict[int, FloatArray] = {1: np.zeros((1, 3)), 2: star[[0, 2]], 4: star[:4], 6: star}
    return chosen[sensor_count]


def _draw_response(rng: Generator, aligned: bool) -> FloatArray:
    """Axes of unlike scale that are not orthogonal; the first sensor's frame is the array's."""
    scale = 1 + rng.uniform(-0.05, 0.05, 3)
    first, second, third = from_degrees(rng.uniform(-3, 3, 3))
    axes = np.array(
        [
            [np.cos(first) * np.cos(second), np.cos(first) * np.sin(second), np.sin(first)],
            [0, np.cos(third), np.sin(third)],
            [0, 0, 1],
        ]
    )
    tilt = np.zeros(3) if aligned else from_degrees(rng.uniform(-4, 4, 3))
    mounted = (about("z", tilt[2:]) @ about("y", tilt[1:2]) @ about("x", tilt[:1]))[0]
    return np.asarray(scale[:, None] * (axes @ mounted.T))
