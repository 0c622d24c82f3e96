"""A vehicle with an array of magnetometers in MuJoCo.

Thrusters turn the vehicle of ``vehicle.xml`` through all directions of a uniform field. A magnetometer of MuJoCo reads
the field of the world, turned into its site's axes; it has no errors, and its attribute ``noise`` is not applied by
``mj_step``. Errors and noise are therefore added here, as a plugin does it.
"""

from dataclasses import dataclass, field
from math import ceil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.linalg import norm
from scipy.spatial.transform import Rotation

from tam_calibration.model.array import Array
from tam_calibration.model.libraries import require
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.simulation.conditions import Current, Temperature

VEHICLE = Path(__file__).with_name("vehicle.xml")

LONGEST_STEP_S = 0.01
"""Of the physics: the vehicle turns by less than a degree in it."""

SWAY_M_PER_S = 0.05
"""Root mean square of the speed that the thrusters keep up along each axis."""

SLOWEST = 0.2
"""Turning rate that the thrusters fall to now and then, in parts of the peak."""

WAVES = 4
PERIODS_S = (10.0, 60.0)
"""Number and periods of the sinusoids that a thruster's course is the sum of: some turns of the vehicle each."""

WARMING = Temperature(20.0, 25.0)
"""Of electronics in the first minutes, recorded beside the sensors; it acts on none."""

SWITCHED = Current(0.5, 3.0, 40.0)
"""Of thrusters that are on every other 20 s, recorded in the same way."""


@dataclass(frozen=True, eq=False)
class VehicleRun:
    """A run of the vehicle.

    Parameters
    ----------
    seed : int
        Of the path, and of the noise where it has no seed of its own.
    noise_seed : int, optional
        Of the noise: another one gives other noise on the same path.
    positions_m : (K, 3) array
        Of the sensors in the vehicle's frame, x forward, y left, z up, metres.
    errors : SensorErrors, optional
        Of the K sensors; None for perfect ones. They do not follow the seed: it is the same vehicle in every run.
    vector_noise_T : float or (K,) array
        Standard deviation of the white noise of each axis, tesla.
    scalar_noise_T : float, optional
        Of the scalar magnetometer at the centre, tesla; None where there is none.
    field_T : (3,) array
        Uniform field of the world, east, north, up, tesla.
    sample_count : int
        Number of samples N.
    rate_hz : float
        Samples per second.
    peak_turn_rate : float
        Largest turning rate that the thrusters keep up, rad/s.
    temperature, current : optional
        Channels that are recorded beside the sensors.
    """

    seed: int = 0
    noise_seed: int | None = None
    positions_m: FloatArray = field(default_factory=lambda: Array.cross(0.5).positions_m)
    errors: SensorErrors | None = None
    vector_noise_T: float | FloatArray = 1e-9
    scalar_noise_T: float | None = 0.1e-9
    field_T: FloatArray = field(default_factory=lambda: np.array([1.6e-6, 18.9e-6, -45.9e-6]))
    sample_count: int = 4000
    rate_hz: float = 20.0
    peak_turn_rate: float = 1.5
    temperature: Temperature | None = WARMING
    current: Current | None = SWITCHED

    @property
    def array(self) -> Array:
        """Positions and noise of the sensors, as in an array file."""
        noise = np.broadcast_to(self.vector_noise_T, len(self.positions_m))
        return Array(self.positions_m, noise, self.scalar_noise_T)

    @property
    def time_s(self) -> FloatArray:
        """(N,) times of the samples from 0, seconds."""
        return np.arange(self.sample_count) / self.rate_hz

    @property
    def steps_per_sample(self) -> int:
        """Steps of the physics from one sample to the next."""
        return ceil(1 / (self.rate_hz * LONGEST_STEP_S))


def simulate_vehicle(run: VehicleRun) -> tuple[Recording, Array]:
    """Return what the vehicle records, attitude included, and its array.

    Parameters
    ----------
    run : VehicleRun
        The same run gives the same recording.

    Raises
    ------
    InputError
        When a value is none that an array or recording can have, or MuJoCo is not installed.
    """
    array, errors = run.array.with_stated_noise(), run.errors or SensorErrors.none(len(run.positions_m))
    sensed = sense(run)
    fields = np.stack([sensed[f"tam_{number}"] for number in range(1, array.sensor_count + 1)], axis=1)
    seed = run.seed if run.noise_seed is None else run.noise_seed
    vector, scalar, channels = (np.random.default_rng((seed, part)) for part in (1, 2, 3))
    recording = Recording(
        run.time_s,
        errors.distort(fields) + array.vector_noise_T[:, None] * vector.standard_normal(fields.shape),
        None
        if run.scalar_noise_T is None
        else norm(sensed["scalar"], axis=1) + run.scalar_noise_T * scalar.standard_normal(run.sample_count),
        None if run.temperature is None else run.temperature.readings(run.time_s, channels),
        None if run.current is None else run.current.readings(run.time_s, channels),
        np.roll(sensed["attitude"], -1, axis=1),  # MuJoCo's quaternions begin with w
    )
    return recording, run.array


def sense(run: VehicleRun) -> dict[str, FloatArray]:
    """Let the vehicle move, and return the (N, 3) or (N, 4) data of each sensor of its model, by name.

    Raises
    ------
    InputError
        When MuJoCo is not installed.
    """
    require("compare", "the vehicle")
    import mujoco

    model = mujoco.MjModel.from_xml_string(model_xml(run))
    generator = np.random.default_rng((run.seed, 0))
    thrust = model.dof_damping * _wanted_velocity(run, generator)
    data = mujoco.MjData(model)
    data.qpos[3:] = Rotation.random(rng=generator).as_quat()  # uniform, in whichever order its parts stand
    rows = np.empty((run.sample_count, model.nsensordata))
    for row, force in zip(rows, thrust, strict=True):
        data.ctrl[:] = force
        mujoco.mj_step(model, data, run.steps_per_sample)
        row[:] = data.sensordata
    names = [model.sensor(number).name for number in range(model.nsensor)]
    return dict(zip(names, np.split(rows, model.sensor_adr[1:], axis=1), strict=True))


def model_xml(run: VehicleRun) -> str:
    """Return the model of ``vehicle.xml`` with the field and the time step of a run and the sensors of its array."""
    root = ElementTree.parse(VEHICLE).getroot()
    option, body, sensors = (root.find(path) for path in ("option", "worldbody/body", "sensor"))
    assert option is not None and body is not None and sensors is not None
    option.set("timestep", str(1 / (run.rate_hz * run.steps_per_sample)))
    option.set("magnetic", _words(run.field_T))
    for number, position in enumerate(run.positions_m, 1):
        ElementTree.SubElement(body, "site", name=f"tam_{number}", pos=_words(position))
        ElementTree.SubElement(sensors, "magnetometer", name=f"tam_{number}", site=f"tam_{number}")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _words(values: FloatArray) -> str:
    return " ".join(str(float(value)) for value in values)


def _wanted_velocity(run: VehicleRun, generator: np.random.Generator) -> FloatArray:
    """Return the (N, 6) velocity, m/s, and turning rate, rad/s, that the thrusters hold against the water."""
    axis, pace = _wander(run.time_s, 3, generator), _wander(run.time_s, 1, generator)
    rate = run.peak_turn_rate * (SLOWEST + (1 - SLOWEST) * (1 + np.tanh(pace)) / 2)
    return np.hstack(
        [SWAY_M_PER_S * _wander(run.time_s, 3, generator), rate * axis / norm(axis, axis=1, keepdims=True)]
    )


def _wander(time_s: FloatArray, columns: int, generator: np.random.Generator) -> FloatArray:
    """Return (N, columns) smooth courses about 0 of unit variance."""
    period = generator.uniform(*PERIODS_S, (WAVES, columns))
    phase = generator.uniform(0, 2 * np.pi, (WAVES, columns))
    course: FloatArray = np.sin(2 * np.pi * time_s[:, None, None] / period + phase).sum(axis=1) * np.sqrt(2 / WAVES)
    return course
