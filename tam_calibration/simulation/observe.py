"""From a scenario to the recording that its array would have made, effects included, and the truth behind it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from tam_calibration.effects.ambient_gradient import gradient_field, turned
from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import Effect, LinearEffect
from tam_calibration.effects.library import effect_named
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.further_channels import is_further
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.simulation.scenario import Scenario

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

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
    for index in sorted(range(len(effects)), key=lambda index: effect_named(effects[index].effect).output_stage):
        fitted, generator = effects[index], generators[index]
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
    if isinstance(effect, LinearEffect):
        for name in filter(is_further, effect.needs(fitted)):
            if name not in covariates.further:
                raise InputError(f"the effect {effect.name} follows {name}: add it to further_channels")
    for part in fitted.contributions:
        if part.sensor >= covariates.sensor_count:
            raise InputError(
                f"the effect {effect.name} acts on sensor {part.sensor + 1}, and there are {covariates.sensor_count}"
            )


_RANDOM_PARTS = ("motion", "vector", "scalar", "temperature", "current", "attitude", "effect", "further")
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
    from scipy.spatial.transform import Rotation

    time_s = scenario.time_s
    attitude = scenario.motion.attitudes(time_s, _generator(scenario, "motion"))
    rotation = Rotation.from_quat(attitude)
    at_scalar = np.zeros(3) if scenario.array.scalar_position_m is None else scenario.array.scalar_position_m
    fields = _field(scenario, rotation, np.vstack([np.zeros(3), at_scalar, scenario.array.positions_m]))
    center, at_sensors = fields[:, 0], fields[:, 2:]
    readings, scalar = _readings(scenario, _covariates(scenario, center, attitude), at_sensors, fields[:, 1])
    recording = Recording(
        time_s,
        readings,
        scalar,
        None
        if scenario.temperature is None
        else scenario.temperature.readings(time_s, _generator(scenario, "temperature")),
        None if scenario.current is None else scenario.current.readings(time_s, _generator(scenario, "current")),
        None if scenario.attitude is None else scenario.attitude.readings(attitude, _generator(scenario, "attitude")),
        {
            name: channel.readings(time_s, _generator(scenario, "further", number))
            for number, (name, channel) in enumerate(sorted(scenario.further.items()))
        },
    )
    return Simulation(scenario, recording, attitude, center, _gradient(scenario, rotation))


def _generator(scenario: Scenario, part: str, number: int = 0) -> np.random.Generator:
    key = (_RANDOM_PARTS.index(part), number)
    return np.random.default_rng(np.random.SeedSequence(scenario.seed, spawn_key=key))


def _field(scenario: Scenario, rotation: "Rotation", positions_m: FloatArray) -> FloatArray:
    """Return the (N, P, 3) field in the array frame at positions (P, 3) of that frame."""
    field: FloatArray = np.repeat(_uniform_field(scenario, rotation)[:, None], len(positions_m), axis=1)
    field += _dipole_field(scenario, rotation, positions_m)
    if scenario.site_gradient_T_per_m is not None:
        field += gradient_field(scenario.site_gradient_T_per_m, rotation.as_quat(), positions_m)
    return field


def _uniform_field(scenario: Scenario, rotation: "Rotation") -> FloatArray:
    """Return the (N, 3) drifting field of the site in the array frame."""
    world = np.tile(scenario.site_field_T, (scenario.sample_count, 1))
    if scenario.drift is not None:
        world = world + scenario.drift.variation_T(scenario.time_s, scenario.site_field_T)
    field: FloatArray = rotation.inv().apply(world)
    return field


def _dipole_field(scenario: Scenario, rotation: "Rotation", positions_m: FloatArray) -> FloatArray:
    """Return the (N, P, 3) field of the dipole in the array frame at positions (P, 3) of that frame."""
    if scenario.dipole is None:
        return np.zeros((1, 1, 3))
    matrix = rotation.as_matrix()
    world = scenario.dipole.field_T(np.einsum("nij,pj->npi", matrix, positions_m))
    field: FloatArray = np.einsum("nji,npj->npi", matrix, world)
    return field


def _gradient(scenario: Scenario, rotation: "Rotation") -> FloatArray:
    """Return the (N, 3, 3) gradient tensor at the centre in the array frame."""
    world = np.zeros((3, 3)) if scenario.site_gradient_T_per_m is None else scenario.site_gradient_T_per_m
    if scenario.dipole is not None:
        world = world + scenario.dipole.gradient_T_per_m(np.zeros(3))
    return turned(world[None], rotation.as_quat())[:, 0]


def _covariates(scenario: Scenario, center_T: FloatArray, attitude: FloatArray) -> Covariates:
    """Return the truth that effects follow."""
    temperature, current, time_s = scenario.temperature, scenario.current, scenario.time_s
    return Covariates(
        time_s,
        center_T,
        scenario.errors,
        scenario.array,
        None if temperature is None else temperature.course(time_s),
        None if current is None else current.course(time_s),
        attitude,
        further={name: channel.course(time_s) for name, channel in scenario.further.items()},
    )


def _readings(
    scenario: Scenario, covariates: Covariates, at_sensors_T: FloatArray, at_scalar_T: FloatArray
) -> tuple[FloatArray, FloatArray | None]:
    """Return what the sensors (N, K, 3) and the scalar magnetometer (N,) read, with effects and noise, tesla."""
    count = scenario.sample_count
    generators = [_generator(scenario, "effect", number) for number in range(len(scenario.effects))]
    vectors = scenario.errors.distort(at_sensors_T).reshape(count, -1)
    rows = np.column_stack([vectors, np.linalg.norm(at_scalar_T, axis=1)])
    rows = add_effects(rows, covariates, scenario.effects, generators, "field")
    rows[:, :-1] += _vector_noise(scenario).reshape(-1, 3 * covariates.sensor_count)
    scalar = _scalar(scenario, rows[:, -1])
    rows[:, -1] = np.nan if scalar is None else scalar
    rows = add_effects(rows, covariates, scenario.effects, generators, "reading")
    return rows[:, :-1].reshape(at_sensors_T.shape), None if scalar is None else rows[:, -1]


def _vector_noise(scenario: Scenario) -> FloatArray:
    """Return the (N, K, 3) white noise of the sensors, each from its own generator."""
    noise = scenario.array.vector_noise_T
    if noise is None:
        return np.zeros((1, scenario.array.sensor_count, 3))
    shape = (scenario.sample_count, 3)
    drawn = [_generator(scenario, "vector", sensor).normal(0, size, shape) for sensor, size in enumerate(noise)]
    return np.stack(drawn, axis=1)


def _scalar(scenario: Scenario, intensity_T: FloatArray) -> FloatArray | None:
    if scenario.scalar is None:
        return None
    noise = scenario.array.scalar_noise_T or 0.0
    return scenario.scalar.readings(scenario.time_s, intensity_T, noise, _generator(scenario, "scalar"))
