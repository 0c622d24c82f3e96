"""From a scenario to the recording that its array would have made, effects included, and the truth behind it.

The twin of a calibrated array is what it would have read on the run of a recording if the calibration were all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tam_calibration.correction.calibration import Calibration
from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import Effect, LinearEffect
from tam_calibration.effects.library import effect_named
from tam_calibration.effects.noise_excess import LARGEST_NOISE
from tam_calibration.effects.removal import agreed_field, filled, removable
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import Gyroscope
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.mounting import matrices_of
from tam_calibration.model.recording import Recording, is_further, require_further
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.simulation.conditions import AttitudeChannel, Current, Drift, Motion, ScalarReference, Temperature
from tam_calibration.sources.dipole import Dipole

MOST_READINGS = 8_000_000
"""Of a simulated run, all sensors together: they take some 1.5 GiB."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """A run to simulate.

    Parameters
    ----------
    array : Array
        Geometry and noise; a noise that is None is not simulated.
    errors : SensorErrors
        Of the array's sensors.
    site_field_T : (3,) array
        Uniform field east, north, up, tesla.
    motion : Motion
        What turns the array.
    sample_count : int
        Number of samples N.
    rate_hz : float
        Samples per second.
    seed : int
        Of all random numbers.
    drift : Drift, optional
        Of the uniform field.
    dipole : Dipole, optional
        A magnetic object near the array.
    scalar : ScalarReference, optional
        The scalar magnetometer, where the array has it; None when there is none.
    temperature, current, attitude : optional
        Channels that are recorded with the sensors.
    site_gradient_T_per_m : (3, 3) array, optional
        Gradient of the site's field, symmetric and trace-free, east, north, up, T/m.
    effects : tuple of FittedEffect
        Physical effects beyond the sensors' errors.
    further : mapping of str to Current
        Further currents and actuators by name, see ``require_further``.
    gyroscope : Gyroscope, optional
        What records the angular velocity of a motion that is steady.

    Raises
    ------
    InputError
        When counts differ or a value is out of range.

    Examples
    --------
    Another seed draws other noise for the same run:

    >>> from dataclasses import replace
    >>> from tam_calibration import read_scenario, simulate
    >>> scenario = replace(read_scenario("wu_table_1"), seed=7)
    >>> simulate(scenario).recording.sample_count
    360
    """

    array: Array
    errors: SensorErrors
    site_field_T: FloatArray
    motion: Motion
    sample_count: int
    rate_hz: float
    seed: int = 0
    drift: Drift | None = None
    dipole: Dipole | None = None
    scalar: ScalarReference | None = None
    temperature: Temperature | None = None
    current: Current | None = None
    attitude: AttitudeChannel | None = None
    site_gradient_T_per_m: FloatArray | None = None
    effects: tuple[FittedEffect, ...] = ()
    further: Mapping[str, Current] = field(default_factory=dict)
    gyroscope: Gyroscope | None = None

    def __post_init__(self) -> None:
        """Check counts, names and values."""
        require_further(self.further)
        sensors, errors = self.array.sensor_count, self.errors.sensor_count
        if sensors != errors:
            raise InputError(f"the scenario has errors of {errors} sensors and an array of {sensors}: make them match")
        if self.sample_count < 1:
            raise InputError(f"a scenario needs at least one sample, not {self.sample_count}")
        if self.sample_count * sensors > MOST_READINGS:
            raise InputError(
                f"a scenario has at most {MOST_READINGS // sensors} samples of {sensors} sensors, not "
                f"{self.sample_count}: simulate parts, each with a seed of its own"
            )
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise InputError(f"the rate must be a positive number of samples per second, not {self.rate_hz}")
        gradient = self.site_gradient_T_per_m
        if gradient is not None:
            tolerance = 1e-9 * float(np.abs(gradient).max())
            if np.abs(gradient - gradient.T).max() > tolerance or abs(np.trace(gradient)) > tolerance:
                raise InputError("the gradient of the site's field must be symmetric, and its diagonal add up to zero")

    @property
    def time_s(self) -> FloatArray:
        """(N,) times of the samples from 0, seconds."""
        return np.arange(self.sample_count) / self.rate_hz


_CHANNELS = {"temperature_C": "temperature", "current_A": "current"}


def add_effects(
    rows_T: FloatArray,
    covariates: Covariates,
    effects: Sequence[FittedEffect],
    generators: Sequence[np.random.Generator],
    stage: Literal["field", "reading"],
) -> FloatArray:
    """Return the rows (N, 3K + 1) with the effects of a stage in them, tesla.

    Parameters
    ----------
    rows_T : (N, 3K + 1) array
        Without noise for the stage "field", with it for "reading".
    covariates : Covariates
        The truth.
    effects : sequence of FittedEffect
        All effects of the scenario.
    generators : sequence of numpy.random.Generator
        One for each of them.
    stage : str
        "field" or "reading".

    Raises
    ------
    InputError
        When an effect is not known, needs a channel that the scenario has not, or has no such sensor, term or value.
    """
    pairs = zip(effects, generators, strict=True)
    for fitted, generator in sorted(pairs, key=lambda pair: effect_named(pair[0].effect).output_stage):
        effect = effect_named(fitted.effect)
        if isinstance(effect, LinearEffect) != (stage == "field"):
            continue
        try:
            _check(effect, fitted, covariates)
            rows_T = effect.add(rows_T, covariates, fitted, generator)
        except KeyError as missing:
            raise InputError(f"the effect {fitted.effect} needs the value {missing}") from None
    return rows_T


def _check(effect: Effect, fitted: FittedEffect, covariates: Covariates) -> None:
    for channel, key in _CHANNELS.items():
        if channel in effect.channels and getattr(covariates, channel) is None:
            raise InputError(f"the effect {effect.name} follows the {key}: add {key} to the scenario")
    for name in filter(is_further, effect.needs(fitted)):
        if name not in covariates.further:
            raise InputError(f"the effect {effect.name} follows {name}: add it to further_channels")
    for part in fitted.contributions:
        if part.sensor >= covariates.sensor_count:
            raise InputError(
                f"the effect {effect.name} acts on sensor {part.sensor + 1}, and there are {covariates.sensor_count}"
            )


_RANDOM_PARTS = ("motion", "vector", "scalar", "temperature", "current", "attitude", "effect", "further", "gyroscope")
"""What draws random numbers; each has a generator of its own, so that one more channel changes no other's noise."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated recording and its truth.

    Parameters
    ----------
    scenario : Scenario
        What was simulated.
    recording : Recording
        What the instruments read.
    attitude : (N, 4) array
        True quaternions x, y, z, w from the array frame to the world.
    center_field_T : (N, 3) array
        True field at the array's centre in the array frame, tesla.
    gradient_T_per_m : (N, 3, 3) array
        True gradient tensor there in the array frame, T/m.

    Examples
    --------
    >>> from tam_calibration import read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> made.center_field_T.shape, made.attitude.shape, made.gradient_T_per_m.shape
    ((360, 3), (360, 4), (360, 3, 3))
    >>> (made.errors.bias_T[0] * 1e9).round(6)  # nT, sensor 1
    array([ 36.,  22., -24.])
    """

    scenario: Scenario
    recording: Recording
    attitude: FloatArray
    center_field_T: FloatArray
    gradient_T_per_m: FloatArray

    @property
    def errors(self) -> SensorErrors:
        """The true errors of the sensors."""
        return self.scenario.errors


def simulate(scenario: Scenario) -> Simulation:
    """Return the recording of a scenario, with the truth.

    Parameters
    ----------
    scenario : Scenario
        Array, errors, site, motion and seed: the same scenario gives the same recording.

    Returns
    -------
    Simulation
        What the K sensors read, (N, K, 3), tesla, with the field and gradient of the array frame that they read.

    Raises
    ------
    InputError
        When the scenario's drift does not span the run, or an effect cannot act in it.

    Examples
    --------
    >>> from tam_calibration import read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> made.recording.readings_T.shape
    (360, 4, 3)
    >>> round(float(1e6 * (made.center_field_T[0] ** 2).sum() ** 0.5), 3)  # µT
    54.956
    """
    time_s = scenario.time_s
    attitude = scenario.motion.attitudes(time_s, _generator(scenario, "motion"))
    at_scalar = np.zeros(3) if scenario.array.scalar_position_m is None else scenario.array.scalar_position_m
    fields = _field(scenario, attitude, np.vstack([np.zeros(3), at_scalar, scenario.array.positions_m]))
    center, at_sensors = fields[:, 0], fields[:, 2:]
    readings, scalar = _readings(scenario, _covariates(scenario, center, attitude), at_sensors, fields[:, 1])
    further = {
        name: channel.readings(time_s, _generator(scenario, "further", number))
        for number, (name, channel) in enumerate(sorted(scenario.further.items()))
    }
    recording = Recording(
        time_s,
        readings,
        scalar,
        _channel(scenario, "temperature", time_s),
        _channel(scenario, "current", time_s),
        _channel(scenario, "attitude", attitude),
        further,
        angular_velocity_rad_s=_angular_velocity(scenario),
    )
    gradient = np.zeros((3, 3)) if scenario.site_gradient_T_per_m is None else scenario.site_gradient_T_per_m
    if scenario.dipole is not None:
        gradient = gradient + scenario.dipole.gradient_T_per_m(np.zeros(3))
    to_world = matrices_of(attitude)
    return Simulation(scenario, recording, attitude, center, np.swapaxes(to_world, 1, 2) @ gradient @ to_world)


def _channel(scenario: Scenario, name: str, truth: FloatArray) -> FloatArray | None:
    """Return the readings of a channel by the times or the true values; None where it is not recorded."""
    channel = getattr(scenario, name)
    return None if channel is None else channel.readings(truth, _generator(scenario, name))


_MOMENT_S = 1e-4
"""Time before and after a sample between which its angular velocity is taken."""


def _angular_velocity(scenario: Scenario) -> FloatArray | None:
    """Return what the gyroscope reads, (N, 3), rad/s; zero if a motion rests between its samples."""
    if scenario.gyroscope is None:
        return None
    from scipy.spatial.transform import Rotation

    before, after = (
        Rotation.from_quat(scenario.motion.attitudes(scenario.time_s + moment_s, _generator(scenario, "motion")))
        for moment_s in (-_MOMENT_S, _MOMENT_S)
    )
    rates = (before.inv() * after).as_rotvec() / (2 * _MOMENT_S)
    return scenario.gyroscope.readings(scenario.time_s, rates, _generator(scenario, "gyroscope"))


def _generator(scenario: Scenario, part: str, number: int = 0) -> np.random.Generator:
    key = (_RANDOM_PARTS.index(part), number)
    return np.random.default_rng(np.random.SeedSequence(scenario.seed, spawn_key=key))


def _field(scenario: Scenario, attitude: FloatArray, positions_m: FloatArray) -> FloatArray:
    """Return the (N, P, 3) field in the array frame at positions (P, 3) of that frame."""
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_quat(attitude)
    world = np.tile(scenario.site_field_T, (scenario.sample_count, 1))
    if scenario.drift is not None:
        world = world + scenario.drift.variation_T(scenario.time_s, scenario.site_field_T)
    field: FloatArray = np.repeat(rotation.inv().apply(world)[:, None], len(positions_m), axis=1)
    matrix = rotation.as_matrix()
    if scenario.dipole is not None:
        dipole_T = scenario.dipole.field_T(np.einsum("nij,pj->npi", matrix, positions_m))
        field += np.einsum("nji,npj->npi", matrix, dipole_T)
    if scenario.site_gradient_T_per_m is not None:
        in_world = matrix @ positions_m.T
        field += np.swapaxes(scenario.site_gradient_T_per_m @ in_world, 1, 2) @ matrix
    return field


def _covariates(scenario: Scenario, center_T: FloatArray, attitude: FloatArray) -> Covariates:
    """Return the truth that effects follow."""
    time_s, channels = scenario.time_s, (scenario.temperature, scenario.current)
    temperature, current = (None if channel is None else channel.course(time_s) for channel in channels)
    further = {name: channel.course(time_s) for name, channel in scenario.further.items()}
    errors, array = scenario.errors, scenario.array
    return Covariates(time_s, center_T, errors, array, temperature, current, attitude, further=further)


def _readings(
    scenario: Scenario, covariates: Covariates, at_sensors_T: FloatArray, at_scalar_T: FloatArray
) -> tuple[FloatArray, FloatArray | None]:
    """Return what the sensors (N, K, 3) and the scalar magnetometer (N,) read, with effects and noise, tesla."""
    count, array, scalar = scenario.sample_count, scenario.array, scenario.scalar
    generators = [_generator(scenario, "effect", number) for number in range(len(scenario.effects))]
    vectors = scenario.errors.distort(at_sensors_T).reshape(count, -1)
    rows = np.column_stack([vectors, np.linalg.norm(at_scalar_T, axis=1)])
    rows = add_effects(rows, covariates, scenario.effects, generators, "field")
    if array.vector_noise_T is not None:
        for sensor, size in enumerate(array.vector_noise_T):
            own = slice(3 * sensor, 3 * sensor + 3)
            rows[:, own] += _generator(scenario, "vector", sensor).normal(0, size, (count, 3))
    if scalar is None:
        rows[:, -1] = np.nan
    else:
        noise, generator = array.scalar_noise_T or 0.0, _generator(scenario, "scalar")
        rows[:, -1] = scalar.readings(scenario.time_s, rows[:, -1], noise, generator)
    rows = add_effects(rows, covariates, scenario.effects, generators, "reading")
    return rows[:, :-1].reshape(at_sensors_T.shape), None if scalar is None else rows[:, -1]


def twin(calibration: Calibration, recording: Recording, seed: int) -> Recording:
    """Return a recording with the field, attitude, temperature and current of another, and noise of its own.

    The field is what the sensors of the recording agree on, without axes that round, end or jump; whatever else they
    differ in, the twin does not show.

    Parameters
    ----------
    calibration : Calibration
        Errors, noise and effects of the array.
    recording : Recording
        The run.
    seed : int
        Of all random numbers.

    Raises
    ------
    InputError
        When the recording is of another number of sensors, or lacks a channel that an effect needs.
    """
    array, errors, effects = calibration.array, calibration.errors, calibration.effects
    field = agreed_field(calibration.without_effects(recording).readings_T, errors, array, _is_trusted(calibration))
    run = filled(recording)
    covariates = Covariates.of(run, field, errors, array)
    vector_noise, scalar_noise, *of_effects = np.random.default_rng(seed).spawn(2 + len(effects))
    rows = np.column_stack([errors.distort(field).reshape(len(field), -1), covariates.intensity_T])
    rows = add_effects(rows, covariates, effects, of_effects, "field")
    vector_T, scalar_T = _noise(calibration)
    rows[:, :-1] += vector_noise.normal(0, np.repeat(vector_T, 3), (len(field), covariates.scalar_row))
    rows[:, -1] += scalar_noise.normal(0, scalar_T, len(field))
    return with_rows(recording, add_effects(rows, covariates, effects, of_effects, "reading"))


def with_rows(recording: Recording, rows_T: FloatArray) -> Recording:
    """Return a recording with other readings; the scalar is silent where it was.

    Parameters
    ----------
    recording : Recording
        N samples of K sensors.
    rows_T : (N, 3K + 1) array
        What the axes of all sensors read, and the scalar magnetometer, tesla.
    """
    scalar = None if recording.scalar_T is None else np.where(np.isfinite(recording.scalar_T), rows_T[:, -1], np.nan)
    return replace(recording, readings_T=rows_T[:, :-1].reshape(recording.readings_T.shape), scalar_T=scalar)


def _is_trusted(calibration: Calibration) -> NDArray[np.bool_]:
    """Return which axes (3K,) hold no effect that cannot be taken off; all where the others tell no field."""
    matrix = calibration.errors.matrix.reshape(-1, 3)
    is_trusted = np.ones(len(matrix), dtype=bool)
    staying = [fitted for fitted in calibration.effects if not removable([fitted])]
    for part in (part for fitted in staying for part in fitted.contributions if part.sensor >= 0):
        first = 3 * part.sensor
        is_trusted[slice(first, first + 3) if part.axis is None else first + part.axis] = False
    return is_trusted if np.linalg.matrix_rank(matrix[is_trusted]) == 3 else np.ones_like(is_trusted)


def _noise(calibration: Calibration) -> tuple[FloatArray, float]:
    """Return the noise of the sensors (K,) and of the scalar: that stated, as much larger or smaller as was found.

    Where effects are not taken off the residuals, these are no measure of the noise.
    """
    array, left = calibration.array, calibration.reduced_chi_square
    if removable(calibration.effects) != calibration.effects:
        left = {}
    vector, scalar = (min(np.sqrt(left.get(name, 1.0)), LARGEST_NOISE) for name in ("differential", "common_mode"))
    return vector * array.vector_noise_T, float(scalar * array.scalar_noise_T)
