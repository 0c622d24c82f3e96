from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tam_calibration.comparison.mistakes import mistakes_of
from tam_calibration.comparison.mistakes.frames import MIRRORED_FIELDS
from tam_calibration.model.array import Array
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import ORIENTATIONS, SensorErrors
from tam_calibration.model.units import from_degrees
from tam_calibration.simulation import Scenario, simulate
from tam_calibration.simulation.conditions import (
    AttitudeChannel,
    Manoeuvre,
    RandomAttitudes,
    ScalarReference,
    Tumble,
    field_from_elements,
)

SEEDS = st.integers(0, 2**32 - 1)


HYSTERESIS = FittedEffect(
    "hysteresis", {"full_scale_T": 60e-6}, (Contribution(0, 0, "loop", {"play 0.15": 0.01, "play 0.4": 0.01}),)
)


class Pair:
    """A simulation and a recording of one vehicle at one site, on paths of their own."""

    def __init__(self, seed, is_slow=False):
        self.rng = rng = np.random.default_rng(seed)
        self.is_slow = is_slow
        self.sensors = int(rng.choice([1, 2, 4]))
        alike = np.repeat(ORIENTATIONS[rng.integers(24)][None], self.sensors, axis=0)
        self.orientation = alike if rng.random() < 0.5 else ORIENTATIONS[rng.integers(24, size=self.sensors)]
        inclination = rng.choice([-1, 1]) * rng.uniform(25, 68)
        self.site_T = field_from_elements(
            rng.uniform(22e-6, 66e-6), from_degrees(inclination), from_degrees(rng.uniform(-20, 20))
        )
        self.real = self.scenario(attitude=AttitudeChannel(from_degrees(rng.uniform(0, 2))))
        self.simulated = self.scenario()
        self.recording = simulate(self.real).recording

    def scenario(self, **given):
        """Return a run with biases of 500 nT, scale errors of 5 % and misalignments of 3°."""
        rng, shape = self.rng, (self.sensors, 3)
        positions = Array.cross(0.5).positions_m[: self.sensors]
        errors = SensorErrors(
            1 + rng.uniform(-0.05, 0.05, shape),
            from_degrees(rng.uniform(-1, 1, shape)),
            rng.uniform(-500e-9, 500e-9, shape),
            from_degrees(rng.uniform(-3, 3, shape)),
            self.orientation,
        )
        gradient = 20e-9 * rng.normal(size=(3, 3))
        gradient = gradient + gradient.T
        limits = from_degrees(rng.uniform(15, 60, 2))
        motions = [Tumble(rng.uniform(0.7, 1.2)), Manoeuvre(*limits, rng.uniform(6, 15)), RandomAttitudes()]
        return Scenario(
            Array(positions, np.full(self.sensors, 20e-9), 1e-9),
            errors,
            self.site_T,
            motions[rng.integers(2 if self.is_slow else 3)],
            int(rng.integers(400, 1000)),
            float(rng.choice([50, 100])),
            int(rng.integers(2**31)),
            scalar=ScalarReference(),
            site_gradient_T_per_m=gradient - np.eye(3) * np.trace(gradient) / 3,
            **{"attitude": AttitudeChannel()} | given,
        )

    def run(self, **changed):
        """Return the simulation's run with something else."""
        return simulate(replace(self.simulated, **changed)).recording

    def told(self, simulation):
        """Return the mistakes of a simulation."""
        return mistakes_of(simulation, self.recording, self.simulated.array, self.real.array)

    def kinds(self, simulation):
        """Return their kinds."""
        return [mistake.kind for mistake in self.told(simulation)]


def read_as(turn, *sensors):
    """Return what makes sensors, all where none is named, read ``turn`` times what they should."""

    def change(pair, run):
        readings = run.readings_T.copy()
        chosen = list(sensors) or slice(None)
        readings[:, chosen] = readings[:, chosen] @ np.asarray(turn, dtype=float).T
        return replace(run, readings_T=readings)

    return change


def noise_only(pair, run):
    """Return a run that ignores the field."""
    return replace(run, readings_T=20e-9 * pair.rng.normal(size=run.readings_T.shape))


def world_only(pair, run):
    """Return a run that reads the world's field without turning it."""
    return replace(run, readings_T=pair.site_T + 20e-9 * pair.rng.normal(size=run.readings_T.shape))


MISTAKES = {
    "gauss_for_tesla": lambda _, run: replace(run, readings_T=1e4 * run.readings_T),
    "millitesla_for_tesla": lambda _, run: replace(run, scalar_T=1e3 * run.scalar_T),
    "microtesla_for_tesla": lambda _, run: replace(run, readings_T=1e6 * run.readings_T, scalar_T=1e6 * run.scalar_T),
    "nanotesla_for_tesla": read_as(1e9 * np.eye(3), 0),
    "tesla_for_nanotesla": lambda _, run: replace(run, readings_T=1e-9 * run.readings_T),
    "tesla_for_microtesla": lambda _, run: replace(run, readings_T=1e-6 * run.readings_T),
    "microtesla_for_nanotesla": lambda _, run: replace(run, readings_T=1e-3 * run.readings_T),
    "no_world_field": noise_only,
    "no_world_field unturned": world_only,
    "frd_for_flu": read_as(np.diag([1, -1, -1])),
    "mirrored_axis": read_as(np.diag([1, -1, 1])),
    "mirrored_axis of one": read_as(np.diag([1, 1, -1]), 0),
    "exchanged_axes": read_as([[1, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "turned_axes": read_as([[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "turned_axes of one": read_as([[0, -1, 0], [1, 0, 0], [0, 0, 1]], 0),
    "attitude_wxyz": lambda _, run: replace(run, attitude=run.attitude[:, [3, 0, 1, 2]]),
    "attitude_inverse": lambda _, run: replace(run, attitude=run.attitude * [-1, -1, -1, 1]),
    "unit_of_time": lambda _, run: replace(run, time_s=1e3 * run.time_s),
    "time_stands_still": lambda _, run: replace(run, time_s=1e-12 * np.arange(run.sample_count)),
}
"""What makes each mistake of a run."""


@pytest.mark.parametrize("name", MISTAKES)
@settings(max_examples=2)
@given(seed=SEEDS)
def test_every_mistake_is_named_and_no_other(name, seed):
    """With sensors in any right-handed orientation and with errors, on any motion."""
    pair = Pair(seed)
    assert pair.kinds(MISTAKES[name](pair, pair.run())) == [name.partition(" ")[0]]


@pytest.mark.parametrize("name", MIRRORED_FIELDS)
@settings(max_examples=2)
@given(seed=SEEDS)
def test_every_mistake_of_the_world_is_named(name, seed):
    """NED for ENU, the other hemisphere, south for north, and all reversed."""
    pair = Pair(seed)
    assert pair.kinds(pair.run(site_field_T=MIRRORED_FIELDS[name] @ pair.site_T)) == [name]


@settings(max_examples=2)
@given(seed=SEEDS)
def test_mujocos_default_field_is_named(seed):
    """Half a gauss that points south is told as gauss for tesla, and as no field of the place."""
    pair = Pair(seed)
    run = pair.run(site_field_T=np.array([0, -0.5e-4, 0]))
    assert pair.kinds(replace(run, readings_T=1e4 * run.readings_T)) == ["gauss_for_tesla", "default_field"]


@settings(max_examples=2)
@given(seed=SEEDS)
def test_a_vertical_field_is_named(seed):
    """The world's z alone."""
    pair = Pair(seed)
    assert pair.kinds(pair.run(site_field_T=pair.site_T * [0, 0, 1])) == ["vertical_field"]


@settings(max_examples=2)
@given(seed=SEEDS)
def test_two_mistakes_are_both_named(seed):
    """Gauss, and NED in the world: what Gazebo's magnetometer had at once."""
    pair = Pair(seed)
    run = pair.run(site_field_T=MIRRORED_FIELDS["ned_for_enu"] @ pair.site_T)
    assert pair.kinds(replace(run, readings_T=1e4 * run.readings_T)) == ["gauss_for_tesla", "ned_for_enu"]


def same_in_all_axes(pair, run):
    """Return a run whose axes have one noise."""
    return replace(run, readings_T=run.readings_T + 20e-9 * pair.rng.normal(size=(run.sample_count, pair.sensors, 1)))


def same_again(pair, run):
    """Return a run whose noise repeats."""
    noise = 20e-9 * pair.rng.normal(size=(200, pair.sensors, 3))
    return replace(run, readings_T=run.readings_T + np.resize(noise, run.readings_T.shape))


@pytest.mark.parametrize(
    ("kind", "noise_T", "change"),
    [
        ("variance_for_deviation", 400e-9, None),
        ("root_for_deviation", np.sqrt(20e-9), None),
        ("no_noise", None, None),
        ("same_noise_in_channels", None, same_in_all_axes),
        ("same_noise_again", None, same_again),
    ],
)
@settings(max_examples=2)
@given(seed=SEEDS)
def test_mistakes_of_noise_are_named(kind, noise_T, change, seed):
    """Where 20 nT are right: their square in nT, their root in T, none, and the same again."""
    pair = Pair(seed, is_slow=True)
    noise = None if noise_T is None else np.full(pair.sensors, noise_T)
    run = pair.run(array=replace(pair.simulated.array, vector_noise_T=noise))
    assert pair.kinds(run if change is None else change(pair, run)) == [kind]


def test_a_variance_in_tesla_is_named():
    """It is a billion times too little."""
    pair = Pair(4, is_slow=True)
    array = replace(pair.simulated.array, vector_noise_T=np.full(pair.sensors, (20e-9) ** 2))
    (mistake,) = pair.told(pair.run(array=array))
    assert mistake.kind in ("variance_for_deviation", "no_noise") and "20 nT" in mistake.what


def test_the_same_noise_in_two_runs_is_named():
    """On paths of their own."""
    pair = Pair(2, is_slow=True)
    noise = 20e-9 * pair.rng.normal(size=(1000, pair.sensors, 3))
    silent = replace(pair.simulated.array, vector_noise_T=None)
    runs = [simulate(replace(scenario, array=silent)).recording for scenario in (pair.simulated, pair.real)]
    one, other = (replace(run, readings_T=run.readings_T + noise[: run.sample_count]) for run in runs)
    assert [each.kind for each in mistakes_of(one, other, silent, pair.real.array)] == ["same_noise_in_runs"]


@pytest.mark.parametrize("part", range(3))
def test_sound_pairs_are_never_accused(part):
    """Of 90, also with hysteresis, a hum, thousands of nT of iron, another level of noise and no attitude."""
    for seed in range(30 * part, 30 * part + 30):
        pair = Pair(seed)
        rng = np.random.default_rng(seed)
        errors = replace(pair.real.errors, bias_T=rng.uniform(-5e-6, 5e-6, (pair.sensors, 3)))
        pair.recording = simulate(
            replace(pair.real, errors=errors, effects=(HYSTERESIS,) if seed % 2 else ())
        ).recording
        noise = np.full(pair.sensors, 20e-9 * 10 ** rng.uniform(-0.5, 0.5))
        run = pair.run(array=replace(pair.simulated.array, vector_noise_T=noise))
        if seed % 3 == 0:
            hum = 100e-9 * np.sin(2 * np.pi * rng.uniform(5, 24) * run.time_s)
            run = replace(run, readings_T=run.readings_T + hum[:, None, None])
        if rng.random() < 0.2:
            run = replace(run, attitude=None)
        if rng.random() < 0.2:
            pair.recording = replace(pair.recording, attitude=None)
        assert pair.told(run) == (), seed


@settings(max_examples=4)
@given(seed=SEEDS)
def test_two_runs_of_one_simulator_are_not_accused(seed):
    """With other seeds, paths, lengths and rates."""
    pair = Pair(seed)
    pair.recording = simulate(replace(pair.scenario(), errors=pair.simulated.errors)).recording
    assert pair.told(pair.run()) == ()


@settings(max_examples=2)
@given(seed=SEEDS)
def test_without_attitude_nothing_is_said_of_frames(seed):
    """But units and a field that is ignored are told."""
    pair = Pair(seed)
    run = replace(pair.run(), attitude=None)
    assert pair.kinds(read_as(np.diag([1, -1, -1]))(pair, run)) == []
    assert pair.kinds(replace(run, readings_T=1e4 * run.readings_T)) == ["gauss_for_tesla"]
    assert pair.kinds(noise_only(pair, run)) == ["no_world_field"]


QUARTER_TURN = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""What a sensor reads of the field, whose site is turned by 90° about x."""


@pytest.mark.parametrize("turn", [QUARTER_TURN, np.diag([1.0, -1, -1]), ORIENTATIONS[23], np.diag([1.0, -1, 1])])
def test_without_attitude_a_sensor_turned_against_others_is_told(turn):
    """Where they lie alike in the recording; in words by the axes that it reads, and those that put it right."""
    four = (pair for pair in map(Pair, range(100)) if pair.sensors == 4)
    pair = next(pair for pair in four if (np.ptp(pair.orientation, axis=0) == 0).all())
    run = replace(pair.run(), attitude=None)
    readings_T = run.readings_T.copy()
    readings_T[:, 2] = readings_T[:, 2] @ turn.T
    (mistake,) = pair.told(replace(run, readings_T=readings_T))
    right_handed = "frd_for_flu" if turn[0, 0] > 0 and turn[1, 1] < 0 else "turned_axes"
    assert mistake.kind == (right_handed if np.linalg.det(turn) > 0 else "mirrored_axis")
    assert mistake.where == "sensor 3" and "not those of sensors 1, 2 and 4, as the recording's are" in mistake.what
    if turn is QUARTER_TURN:
        assert mistake.what.endswith("they are turned: x, y, z read x, z, -y")
        assert mistake.mend.startswith("publish x = x, y = -z, z = y of") and "turn its site" in mistake.mend


@pytest.mark.parametrize("sensor", [1, 2])
def test_without_attitude_a_mirrored_sensor_is_told_however_sensors_lie(sensor):
    """Handedness does not depend on how the others are turned."""
    four = (pair for pair in map(Pair, range(100)) if pair.sensors == 4)
    pair = next(pair for pair in four if np.ptp(pair.orientation, axis=0).any())
    run = replace(read_as(np.diag([1, 1, -1]), sensor - 1)(pair, pair.run()), attitude=None)
    (mistake,) = pair.told(run)
    assert (mistake.kind, mistake.where) == (
        "mirrored_axis",
        f"sensor {sensor}",
    ) and "axis z is reversed" in mistake.what


def test_sentences_name_place_and_mend():
    """In the words of simulators, for sensor 1 of two or four."""
    pair = next(pair for pair in map(Pair, range(20)) if pair.sensors == 4)
    (mistake,) = pair.told(MISTAKES["mirrored_axis of one"](pair, pair.run()))
    assert mistake.where == "sensor 1"
    assert mistake.what == "the simulation's axes of sensor 1 are not the recording's: axis z is reversed"
    assert "z = -z" in mistake.mend
    (mistake,) = pair.told(MISTAKES["gauss_for_tesla"](pair, pair.run()))
    assert mistake.where == "all sensors" and mistake.what.startswith("the simulation's field is in gauss, and tesla")
    assert "multiply the sensor's output by 0.0001" in mistake.mend and "<use_units_gauss>" in mistake.mend


@pytest.mark.parametrize(("is_shared", "kinds"), [(True, ["same_noise_in_channels"]), (False, [])])
def test_jerks_of_the_motion_hide_no_noise_and_make_none(is_shared, kinds):
    """A course with kinks, as thrusters make: noise that all sensors share is told, and sound noise is not accused."""
    runs = []
    for seed, noise_shape in ((7, (1500, 1 if is_shared else 4, 3)), (8, (1500, 4, 3))):
        generator = np.random.default_rng(seed)
        rates = generator.normal(0, 0.3, (30, 3)).repeat(50, axis=0)
        turns = Rotation.from_rotvec(np.cumsum(rates / 5, axis=0))
        attitude = (turns * Rotation.from_rotvec(generator.normal(0, 1e-3, (1500, 3)))).as_quat()
        field_T = turns.inv().apply([1e-6, 20e-6, -45e-6])[:, None]
        readings_T = field_T + np.broadcast_to(generator.normal(0, 1e-9, noise_shape), (1500, 4, 3))
        runs.append(Recording(np.arange(1500) / 5, readings_T, attitude=attitude))
    array = Array.cross(0.5, vector_noise_T=1e-9, scalar_noise_T=1e-10)
    assert [mistake.kind for mistake in mistakes_of(*runs, array, array)] == kinds


@pytest.mark.parametrize(("part", "kinds"), [(1 / 120, ["no_noise"]), (1 / 80, [])])
def test_a_noise_of_a_hundredth_is_none(part, kinds):
    """Whatever the simulated sensors are: the recording's have a hundred times as much."""
    pair = Pair(3, is_slow=True)
    quiet = replace(pair.simulated.array, vector_noise_T=part * pair.simulated.array.vector_noise_T)
    assert pair.kinds(pair.run(array=quiet)) == kinds
