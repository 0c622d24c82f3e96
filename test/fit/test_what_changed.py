"""What changed within a recording, in words that lead to the repair."""

from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration import read_scenario
from tam_calibration.fit import calibrate
from tam_calibration.fit.what_changed import what_changed
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import Manoeuvre, Tumble

COUNT, RATE_HZ = 600, 10.0


def offset(size_nT, sensor=1, axis=0):
    """Return a change of one bias."""

    def change(readings_T):
        readings_T[:, sensor, axis] += 1e-9 * size_nT
        return readings_T

    return change


def scaled(factor, *where):
    """Return a change of the gain of a sensor, or of one axis."""

    def change(readings_T):
        readings_T[(slice(None), *where)] *= factor
        return readings_T

    return change


def turned(readings_T):
    """Turn sensor 3 by two degrees."""
    readings_T[:, 2] = Rotation.from_rotvec([0, np.radians(2), 0]).apply(readings_T[:, 2])
    return readings_T


def swapped(readings_T):
    """Exchange the axes x and z of sensor 2."""
    readings_T[:, 1] = readings_T[:, 1][:, [2, 1, 0]]
    return readings_T


def replaced(readings_T):
    """Put another sensor in the place of sensor 2."""
    matrix = np.eye(3) + 0.03 * np.random.default_rng(4).normal(size=(3, 3))
    readings_T[:, 1] = readings_T[:, 1] @ matrix + 500e-9
    return readings_T


def bytes_of(readings_T):
    """Exchange the two bytes of the counts of sensor 4."""
    readings_T[:, 3] = np.round(readings_T[:, 3] / 2e-9).astype(np.int16).byteswap() * 2e-9
    return readings_T


def magnet(readings_T):
    """Attach a magnet that is nearer to some sensors than to others."""
    return readings_T + 1e-6 * np.outer([1.6, 1.0, 0.8, 1.2], [2, 1, -2])


def iron(readings_T):
    """Attach soft iron, which makes another field of each."""
    errors = read_scenario("wu_table_1").errors
    change = np.array([[1.02, 0.01, 0.0], [0.01, 0.97, -0.01], [0.0, -0.01, 1.01]])
    return np.einsum("kij,nkj->nki", errors.matrix @ change, errors.restore(readings_T)) + errors.bias_T


def offsets_of_all(readings_T):
    """Give each axis another offset."""
    return readings_T + np.random.default_rng(5).normal(size=readings_T.shape[1:]) * 20e-6


CHANGES = {
    "sensors 1 and 3 are exchanged": lambda readings_T: readings_T[:, [2, 1, 0, 3]],
    "the sensors are in the order 3, 1, 2, 4": lambda readings_T: readings_T[:, [2, 0, 1, 3]],
    "axes x, z of sensor 2 are exchanged": swapped,
    "the sign of sensor 4 z changes": scaled(-1, 3, 2),
    "the bias of sensor 2 x changes by 60 nT": offset(60),
    "the gain of sensor 1 changes by a factor of 1.5": scaled(1.5, 0),
    "the gain of sensor 3 y changes by a factor of 0.98": scaled(0.98, 2, 1),
    "the gain of all sensors changes by a factor of 1.1": scaled(1.1),
    "sensor 3 is turned by 2°": turned,
    "the gains, axes and biases of sensor 2 change": replaced,
    "something magnetic adds up to 1500 nT to all sensors": lambda readings_T: readings_T + np.array([1e-6, 0, -1e-6]),
    "something magnetic adds up to 4800 nT to all sensors": magnet,
    "iron that moves with the array changes the field of all sensors": iron,
    "the biases of all sensors change by up to": offsets_of_all,
    "sensor 4 contradicts the others": bytes_of,
}


def run_of(scenario, change, first, last=None, **other):
    """Return a recording that changes for some samples, and its array."""
    made = simulate(replace(scenario, sample_count=COUNT, rate_hz=RATE_HZ, **other)).recording
    readings = made.readings_T.copy()
    readings[first:last] = change(readings[first:last].copy())
    return replace(made, readings_T=readings)


@pytest.mark.parametrize(("words", "first"), [*zip(CHANGES, cycle([200, 400]), strict=False)])
def test_a_change_is_named_with_its_time(wu_scenario, words, first):
    """Whether most samples are before or after it: what is so afterwards, and from when on."""
    told = what_changed(run_of(wu_scenario, CHANGES[words], first), wu_scenario.array)
    assert told.what.startswith(words)
    assert told.what.endswith(f" from {first / RATE_HZ:.1f} s on")
    assert f"--until {first / RATE_HZ:.1f}" in told.todo
    assert told.is_explained == (CHANGES[words] is not bytes_of)


@pytest.mark.parametrize("words", list(CHANGES)[::4])
def test_it_is_the_first_that_a_calibration_says(wu_scenario, words):
    """Nothing is said of turning the array, which was turned all round."""
    with pytest.raises(Refused, match=f"^{words}.* from 30.0 s on: "):
        calibrate(run_of(wu_scenario, CHANGES[words], 300), wu_scenario.array)


@pytest.mark.parametrize(("lag", "words", "first"), [(2, "0.2 s later", 200), (-1, "0.1 s earlier", 400)])
def test_a_clock_that_steps_is_named(wu_scenario, lag, words, first):
    """The stamps of one driver, against those of the others."""
    slow = replace(wu_scenario, motion=Tumble(np.radians(20)))
    made = simulate(replace(slow, sample_count=COUNT + 4, rate_hz=RATE_HZ)).recording
    readings_T = made.readings_T[2:-2].copy()
    readings_T[first:, 2] = made.readings_T[2 + first - lag : COUNT + 2 - lag, 2]
    told = what_changed(replace(made.take(slice(2, -2)), readings_T=readings_T), wu_scenario.array)
    assert told.what == f"the readings of sensor 3 come {words} from {first / RATE_HZ:.1f} s on"


def test_a_multiplexer_that_stops_is_named(wu_scenario):
    """Each channel has noise of its own."""
    noise_T = 1e-9 * np.random.default_rng(3).normal(size=(COUNT, 3))

    def stopped(readings_T):
        readings_T[:, 2] = readings_T[:, 1] + noise_T[: len(readings_T)]
        return readings_T

    told = what_changed(run_of(wu_scenario, stopped, 400), wu_scenario.array)
    assert told.what == "sensor 3 reads what sensor 2 reads from 40.0 s on"


def test_what_ends_has_two_times(wu_scenario):
    """A magnet that is there for a while."""
    recording = run_of(wu_scenario, lambda readings_T: readings_T + 3e-6, 100, 280)
    with pytest.raises(Refused, match=r"adds .* to all sensors between 10.0 and 28.0 s: .*--until 10.0, --from 28.0"):
        calibrate(recording, wu_scenario.array)


def test_what_fails_at_first_is_left_out_at_first(wu_scenario):
    """The readings after it are the calibration."""
    told = what_changed(run_of(wu_scenario, bytes_of, 0, 250), wu_scenario.array)
    assert told.sentence == "sensor 4 contradicts the others until 25.0 s: leave that time out (--from 25.0)"


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("the bias of sensor 1 y changes by 60 nT", offset(60, 0, 1)),
        ("the sign of sensor 1 z changes", scaled(-1, 0, 2)),
        ("the gain of sensor 1 changes by a factor of 1.02", scaled(1.02, 0)),
        ("the readings follow another calibration", scaled(1.2, 0, 0)),
    ],
)
def test_of_one_sensor_the_intensity_tells(wu_scenario, words, change):
    """There is no other sensor to compare it with."""
    recording = run_of(wu_scenario, change, 250)
    one = replace(recording, readings_T=recording.readings_T[:, :1])
    array = Array(np.zeros((1, 3)), np.array([1e-9]), 1e-10)
    assert what_changed(one, array).what == f"{words} from 25.0 s on"


def test_a_small_change_is_a_warning_with_honest_standard_errors(wu_scenario):
    """Two and a half nanotesla beside one of noise: the errors before it are less than three standard errors off."""
    calibration = calibrate(run_of(wu_scenario, offset(2.5), 350), wu_scenario.array)
    assert any(warning.startswith("the bias of sensor 2 x changes by") for warning in calibration.warnings)
    distance = calibration.errors.to_vector() - wu_scenario.errors.to_vector()
    free = calibration.standard_errors > 0
    assert np.all(np.abs(distance[free]) < 3 * calibration.standard_errors[free])


def test_a_large_change_is_a_warning_where_the_residual_is_accepted(wu_scenario):
    """A person may know better."""
    recording = run_of(wu_scenario, offset(60), 300)
    calibration = calibrate(recording, wu_scenario.array, accept=["residual"])
    assert calibration.warnings[0].startswith("the bias of sensor 2 x changes by 60 nT from 30.0 s on: ")


def test_a_change_near_an_end_leaves_the_calibration_of_the_longer_part(wu_scenario):
    """The screening leaves the other part out; the warning says what changed, and no note calls it bad readings."""
    calibration = calibrate(run_of(wu_scenario, offset(500), 480), wu_scenario.array)
    assert calibration.samples == 480
    assert calibration.warnings[0].startswith(
        "the bias of sensor 2 x changes by 500 nT from 48.0 s on, and this is the"
    )
    assert calibration.notes == ()


def test_a_sensor_that_fails_at_the_end_is_left_out_with_a_note(wu_scenario):
    """That is no other calibration."""

    def noise(readings_T):
        readings_T[:, 1] = np.random.default_rng(7).normal(size=readings_T[:, 1].shape) * 30e-6
        return readings_T

    calibration = calibrate(run_of(wu_scenario, noise, 540), wu_scenario.array)
    assert calibration.warnings == () and "sensor 2" in calibration.notes[0]


def test_lack_of_coverage_keeps_its_sentence(wu_scenario):
    """A turn about one axis is that, with or without a change."""
    flat = Manoeuvre(0.0, 0.0, 60.0)
    with pytest.raises(InputError, match="turn the array"):
        calibrate(run_of(wu_scenario, offset(0), 300, motion=flat), wu_scenario.array)
