"""One run of either physics: what is sensed before anything goes wrong, and its noise."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator
from scipy.spatial.transform import Rotation, RotationSpline
from vehicle import VehicleRun, simulate_vehicle

from tam_calibration.model.exceptions import Refused
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla
from tam_validation.blind import case
from tam_validation.blind.continuous_motion import ContinuousMotion
from tam_validation.blind.disturbance import Signal
from tam_validation.blind.processes import draw_load, draw_weather
from tam_validation.blind.scene import Scene, Wish, draw_scene
from tam_validation.blind.visible import NominalModel

CHANNELS = ("temperature", "current", "attitude")

SLOWEST_HZ = 5.0
"""Of samples: robots record no fewer, and MuJoCo takes a hundred steps to a second whatever the rate."""

_TRIES = 50
"""Draws of a run before it is given up that one determines a calibration."""

_TURN_PER_SAMPLE = 0.2
"""Radians that the vehicle turns at most from one sample to the next, as the other physics has it."""

_FASTEST_TURN = 3.0
"""rad/s."""

_BIAS_T = 300e-9
"""Standard deviation of the biases of the simulator's sensors, where it has any."""


@dataclass(frozen=True, eq=False)
class Run:
    """A run.

    Parameters
    ----------
    scene : Scene
        What is sensed without noise.
    noise : ((N, K, 3) array, (N,) array)
        Of the readings and of the scalar, tesla.
    """

    scene: Scene
    noise: Signal

    @property
    def seen(self) -> Signal:
        """Readings (N, K, 3) and scalar (N,) with their noise, tesla."""
        return self.scene.readings_T + self.noise[0], self.scene.intensity_T + self.noise[1]

    @property
    def is_informative(self) -> bool:
        """Whether it determines a calibration."""
        return NominalModel(self.scene).conditioning > case.WELL_CONDITIONED


def draw_recording(rng: Generator, motions: tuple[str, ...], coarse: bool = False) -> Run:
    """Draw a run of the check's own physics: a cross of four sensors with a scalar and all channels."""

    def draw() -> Run:
        wish = Wish(int(rng.integers(1500, 3001)), 4, motions, True, False, CHANNELS, coarse)
        scenes = (draw_scene(rng, wish) for _ in count())
        scene = next(one for one in scenes if one.step_s * SLOWEST_HZ <= 1)
        return Run(scene, case.draw_noise(rng, scene))

    return _informative(draw)


def draw_vehicle(rng: Generator, like: Scene) -> VehicleRun:
    """Draw a vehicle with the array, the rate and the noise of a scene, on another path at another site."""
    rate_hz = 1 / like.step_s
    errors = SensorErrors.none(like.sensor_count)
    if rng.random() < 0.5:
        errors = replace(errors, bias_T=rng.normal(size=errors.bias_T.shape) * _BIAS_T)
    return VehicleRun(
        seed=int(rng.integers(2**31)),
        positions_m=like.positions_m,
        errors=errors,
        vector_noise_T=like.vector_noise_T,
        scalar_noise_T=like.scalar_noise_T,
        field_T=draw_field(rng),
        sample_count=like.sample_count,
        rate_hz=rate_hz,
        peak_turn_rate=float(rng.uniform(0.5, 1)) * min(_TURN_PER_SAMPLE * rate_hz, _FASTEST_TURN),
        temperature=None,
        current=None,
    )


def draw_field(rng: Generator, least_dip: float = 20.0) -> FloatArray:
    """Draw a field (3,) of the northern hemisphere, east, north, up, tesla."""
    dip, declination = from_degrees(rng.uniform(least_dip, 75)), from_degrees(rng.uniform(-8, 8))
    level = np.cos(dip) * np.array([np.sin(declination), np.cos(declination)])
    return np.asarray(from_nanotesla(rng.uniform(30_000, 60_000)) * np.append(level, -np.sin(dip)))


def draw_simulation(rng: Generator, like: Scene, is_alike: bool = False) -> Run:
    """Draw a run of the vehicle in MuJoCo with the array, the rate and the noise of a scene.

    Parameters
    ----------
    rng : numpy.random.Generator
    like : Scene
    is_alike : bool
        Whether intensity, temperature and current are those of that scene too.
    """
    courses = like if is_alike else None

    def draw() -> Run:
        vehicle = draw_vehicle(rng, like)
        if is_alike:
            size = like.intensity_T.mean() / norm(vehicle.field_T)
            vehicle = replace(vehicle, field_T=size * vehicle.field_T)
        return run_of(rng, vehicle, courses)

    return _informative(draw)


def _informative(draw: Callable[[], Run]) -> Run:
    for _ in range(_TRIES):
        run = draw()
        if run.is_informative:
            return run
    raise Refused(f"none of {_TRIES} runs determines a calibration")


def run_of(rng: Generator, vehicle: VehicleRun, courses: Scene | None = None) -> Run:
    """Let a vehicle run, beside a temperature and a current of its own or those of a scene."""
    recording = simulate_vehicle(vehicle)[0]
    assert vehicle.errors is not None and recording.attitude is not None and recording.scalar_T is not None
    end_s = float(recording.time_s[-1])
    attitudes = RotationSpline(recording.time_s, Rotation.from_quat(recording.attitude))
    scene = Scene(
        time_s=recording.time_s,
        duration_s=end_s,
        step_s=1 / vehicle.rate_hz,
        # Yaw, pitch and roll are the angles about z, y' and x''.
        motion=ContinuousMotion("tumbling", lambda at_s: attitudes(np.clip(at_s, 0, end_s)).as_euler("ZYX")),
        world_field=lambda at_s: np.tile(vehicle.field_T, (len(at_s), 1)),
        positions_m=vehicle.positions_m,
        response=vehicle.errors.matrix,
        bias_T=vehicle.errors.bias_T,
        vector_noise_T=float(np.mean(vehicle.vector_noise_T)),
        scalar_noise_T=float(vehicle.scalar_noise_T or 0.0),
        with_scalar=True,
        channels=CHANNELS,
        temperature=courses.temperature if courses else draw_weather(rng, end_s),
        current=courses.current if courses else draw_load(rng, end_s),
    )
    return Run(scene, (recording.readings_T - scene.readings_T, recording.scalar_T - scene.intensity_T))
