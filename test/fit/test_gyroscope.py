"""Angular velocity makes a calibration of a narrow turn; one that is wrong is found, and told in one sentence."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from compasses import with_compass
from scipy.spatial.transform import Rotation
from swinging_circle import GYROSCOPE, attitude_at
from swinging_circle import made as made_of

from tam_calibration.fit import calibrate
from tam_calibration.fit.gyroscope_check import judge_gyroscope
from tam_calibration.fit.gyroscope_likelihood import GyroscopeLikelihood
from tam_calibration.fit.gyroscope_path import GyroscopePath, GyroscopeState, GyroscopeUse
from tam_calibration.fit.likelihood import ChannelMaps
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.problem import Known
from tam_calibration.model.data_sheet import Tolerances
from tam_calibration.model.mounting import Mounting
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import from_degrees
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import Manoeuvre

COUNT = 2000
made = partial(made_of, count=COUNT)


@cache
def calibrated(gyroscope=GYROSCOPE):
    """Return the calibration of one sensor's recording where so much is stated of the gyroscope; computed once."""
    recording, array, _ = made()
    return calibrate(recording, replace(array, gyroscope=gyroscope))


@cache
def calibrated_alone():
    """Return the calibration of that recording without angular velocity; computed once."""
    recording, array, _ = made()
    return calibrate(replace(recording, angular_velocity_rad_s=None), array)


def with_rates(recording, change):
    """Return a recording whose angular velocity is a function of the recorded one."""
    return replace(recording, angular_velocity_rad_s=change(recording.angular_velocity_rad_s))


@pytest.mark.parametrize(("sensors", "has_scalar"), [(1, True), (4, False)])
def test_a_narrow_turn_becomes_a_calibration(sensors, has_scalar):
    """The vertical bias is known twice as well as by the intensity alone, and the errors are right."""
    recording, array, errors = made(sensors, has_scalar=has_scalar)
    found = calibrated() if has_scalar else calibrate(recording, array)
    bias_error_T = found.standard_errors[0, 8]
    assert bias_error_T < 12e-9
    away = (found.errors.bias_T - errors.bias_T) / found.standard_errors[:, 6:9]
    assert np.abs(away).max() < 3.5
    if has_scalar:
        without = calibrated_alone()
        assert without.method == "maximum_likelihood" and without.standard_errors[0, 8] > 2 * bias_error_T


def test_its_derivatives_are_those_of_its_residuals():
    """By every unknown of the gyroscope, and by the errors of the sensors, to first order in the turn of a sample."""
    recording, _, errors = made(count=1500, noise=0.0)
    rows = recording.readings_T.reshape(1500, 3).T / 50e-6
    path = GyroscopePath(recording.time_s, recording.angular_velocity_rad_s, 0.1, recording.time_span_s)
    state = GyroscopeState.at_rest(np.eye(3), 0.0).of_modes(path.modes)
    use = GyroscopeUse(GYROSCOPE.noise_density, GYROSCOPE.bias, 0.1, state)
    likelihood = GyroscopeLikelihood(rows, path, np.full(1, 2e-5), use)
    matrix, bias = errors.matrix, errors.bias_T / 50e-6

    def residual(matrix, bias, state):
        channels = ChannelMaps.at(matrix, bias, likelihood.vector_noise)
        return likelihood._chain(channels, state).residual

    channels = ChannelMaps.at(matrix, bias, likelihood.vector_noise)
    chain = likelihood._chain(channels, state)
    columns = likelihood._columns(chain, likelihood._factor(chain, use.density), state)
    for index in range(state.size):
        step = np.zeros(state.size)
        step[index] = 1e-6
        moved = (residual(matrix, bias, state.moved(step)) - chain.residual) / 1e-6
        np.testing.assert_allclose(columns[12 + index], moved, atol=1e-2 * np.abs(moved).max())
    for row, column in [(0, 0), (1, 2), (2, 3)]:
        step = np.zeros((1, 3, 4))
        step[0, row, column] = 1e-6
        moved = residual(matrix + step[..., :3], bias + step[..., 3], state) - chain.residual
        by_row = np.tensordot(channels.response[4 * row + column], columns[:12], 1)
        np.testing.assert_allclose(by_row, moved / 1e-6, atol=1e-2 * np.abs(moved).max() / 1e-6)


def test_few_long_turns_tell_as_much_as_many_short_ones():
    """Turns over several samples know the bias of the gyroscope as well."""
    recording, array, _ = made()
    _, judged = judge_gyroscope(recording, array, Known())
    assert judged.fit is not None and judged.fit.use.stride == 1
    rows = recording.readings_T.reshape(COUNT, 3).T / 50e-6
    path = GyroscopePath(recording.time_s, recording.angular_velocity_rad_s, 0.1, recording.time_span_s)
    state = judged.fit.state
    use = GyroscopeUse(GYROSCOPE.noise_density, GYROSCOPE.bias, 0.1, state)
    fine = GyroscopeLikelihood(rows, path, np.full(1, 2e-5), use)
    own = slice(12, 15)
    for times in (2, 5):
        first, other = (
            each.linearize(np.eye(3)[None], np.zeros((1, 3)), state) for each in (fine, fine.coarser(times))
        )
        assert other.count < first.count / times + 3
        np.testing.assert_allclose(np.diag(other.information)[own], np.diag(first.information)[own], rtol=0.1)


FAULTS = {
    "in degrees": (np.degrees, "the angular velocity is in °/s"),
    "late": (lambda rates: np.vstack([rates[:3], rates[:-3]]), "the angular velocity is 0.3 s late"),
    "early": (lambda rates: np.vstack([rates[2:], rates[-2:]]), "the angular velocity is 0.2 s early"),
    "biased": (lambda rates: rates + from_degrees(2.0), "the gyroscope's bias is"),
    "askew": (Rotation.from_rotvec([0.1, -0.1, 0.1]).apply, "the gyroscope is turned by 9.9°"),
    "on its side": (Rotation.from_rotvec([0, 0, np.pi / 2]).apply, "the gyroscope is turned by 90°"),
    "saturated": (
        lambda rates: np.clip(rates, [-0.03, -0.03, -1], [0.03, 0.03, 1]),
        "are at the end of the gyroscope's range",
    ),
    "of another scale": (lambda rates: 1.02 * rates, "scale and angles of the gyroscope's axes differ by up to 2"),
}
"""What may be wrong with an angular velocity that is used all the same, and what the note or the doubt of it says."""


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_told_and_estimated(fault):
    """The fault is in the notes or the doubts, and the bias along the vertical is within its errors."""
    change, words = FAULTS[fault]
    recording, array, errors = made(seed=4)
    found = calibrate(with_rates(recording, change), array)
    assert any(words in note for note in (*found.warnings, *found.notes)), found.notes
    assert np.abs((found.errors.bias_T - errors.bias_T) / found.standard_errors[:, 6:9]).max() < 4


@pytest.mark.parametrize("angle_deg", [9, 90, 180])
def test_a_gyroscope_that_is_turned_far_is_doubted_unless_that_is_stated(angle_deg):
    """Some degrees are its mounting; all sensors may be mounted otherwise than stated where it is a half turn."""
    recording, array, _ = made(4, seed=4)
    turn = Rotation.from_rotvec([from_degrees(angle_deg), 0.0, 0.0])
    turned = with_rates(recording, turn.apply)
    found = calibrate(turned, array)
    is_doubted = found.warnings[0].startswith(f"the gyroscope is turned by {angle_deg}° against sensor 1")
    assert is_doubted == (angle_deg > 9)
    if is_doubted:
        assert found.quality.next[0] == "state imu_rotation_deg, or rotations_deg of the sensors, in the array file"
    stated = calibrate(Mounting(imu_rotation=turn.inv().as_quat()).turned(turned), array)
    assert not any("is turned by" in told for told in (*stated.warnings, *stated.notes))


def test_gaps_cost_what_they_hide():
    """Samples without angular velocity make the errors larger, not wrong."""
    recording, array, errors = made()

    def holed(rates):
        rates = rates.copy()
        rates[500:900] = rates[::40] = np.nan
        return rates

    whole, found = calibrated(), calibrate(with_rates(recording, holed), array)
    assert whole.standard_errors[0, 8] < found.standard_errors[0, 8] < 2 * whole.standard_errors[0, 8]
    assert np.abs((found.errors.bias_T - errors.bias_T) / found.standard_errors[:, 6:9]).max() < 4


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rates: np.random.default_rng(1).normal(size=rates.shape), "does not go with the turns of the field"),
        (lambda rates: rates * [1, -1, 1], "left-handed"),
        (lambda rates: np.where(np.arange(len(rates))[:, None] % 50 < 2, rates, np.nan), "too few samples"),
        (np.zeros_like, "too few samples"),
    ],
)
def test_what_is_no_angular_velocity_of_the_array_is_left_out(change, words):
    """The answer is then that of the readings alone, with a note."""
    recording, array, _ = made()
    found, alone = calibrate(with_rates(recording, change), array), calibrated_alone()
    assert any(words in note and "left out" in note for note in found.notes), found.notes
    np.testing.assert_allclose(found.standard_errors[0, 8], alone.standard_errors[0, 8], rtol=0.02)
    np.testing.assert_allclose(found.errors.bias_T, alone.errors.bias_T, atol=1e-9)


@pytest.mark.parametrize(("factor", "size"), [(0.1, "small"), (10.0, "large")])
def test_a_wrong_noise_is_told(factor, size):
    """A stated noise that is ten times too small or too large is a warning, and the noise of the residuals counts."""
    stated = replace(GYROSCOPE, noise_density=factor * GYROSCOPE.noise_density)
    right, found, estimated = (calibrated(each) for each in (GYROSCOPE, stated, None))
    assert any(f"is too {size}" in warning for warning in found.warnings)
    for each in (found, estimated):
        np.testing.assert_allclose(each.standard_errors[0, 8], right.standard_errors[0, 8], rtol=0.2)


def test_a_scale_error_that_is_stated_counts():
    """A scale that is known to one per mille makes the bias of the vertical less certain, and needs no note."""
    exact, stated = (calibrated(each) for each in (GYROSCOPE, replace(GYROSCOPE, scale_error=1e-3)))
    assert any("scale_error_percent" in note for note in exact.notes)
    assert not any("scale_error_percent" in note for note in stated.notes)
    assert stated.standard_errors[0, 8] > 2 * exact.standard_errors[0, 8]


@pytest.mark.parametrize("moved_T", [0.0, 5e-9, 5e-6])
def test_a_prior_that_is_contradicted_is_no_fault_of_the_gyroscope(wu_run, wu_scenario, moved_T):
    """A bias that moved is found as without it, and the gyroscope makes the errors no larger."""
    pier = maximum_likelihood(wu_run.recording, wu_scenario.array)
    vector = wu_scenario.errors.to_vector()
    vector[2, 6:9] += moved_T / np.sqrt(3)
    swing = Manoeuvre(from_degrees(5.0), from_degrees(5.0), 120.0)
    scenario = replace(wu_scenario, errors=SensorErrors.from_vector(vector), motion=swing, sample_count=600)
    made = simulate(replace(scenario, rate_hz=10.0, gyroscope=GYROSCOPE, seed=8)).recording
    array = replace(wu_scenario.array, gyroscope=GYROSCOPE)
    beside, alone = (calibrate(each, array, prior=pier) for each in (made, replace(made, angular_velocity_rad_s=None)))
    moved = [[(each.kind, each.sensor) for each in found.update.moved] for found in (beside, alone)]
    assert moved[0] == moved[1] == ([("bias", 3)] if moved_T else []) and beside.notes == alone.notes
    assert (beside.standard_errors <= 1.001 * alone.standard_errors).all()
    away = (beside.errors.to_vector() - vector)[:, :9] / beside.standard_errors[:, :9]
    assert np.abs(away).max() < 4


def test_a_mounting_that_is_stated_ties_the_frame_of_the_sensors():
    """The misalignments of all sensors, sensor 1 too, are those against the gyroscope, and within their errors."""
    recording, array, errors = made(4, seed=11, count=1500)
    turn = Rotation.from_rotvec([0.05, -0.03, 0.08])
    turned = with_rates(recording, turn.apply)  # the sensors are turned by the inverse against the gyroscope
    truth = SensorErrors.from_matrix(errors.matrix @ turn.inv().as_matrix(), errors.bias_T)
    alone, tied = (calibrate(turned, each) for each in (array, replace(array, mounting_error=from_degrees(0.01))))
    assert "gyroscope" in tied.frame and tied.frame != alone.frame
    assert not alone.standard_errors[0, 9:].any() and (tied.standard_errors[0, 9:] > from_degrees(0.01)).all()
    away = (tied.errors.to_vector() - truth.to_vector()) / tied.standard_errors
    assert np.abs(away).max() < 4 and tied.standard_errors[:, 9:].max() < from_degrees(0.57)
    assert tied.held_out is not None


def test_a_gyroscope_counts_before_an_attitude_that_leans_on_the_magnetometer():
    """The AHRS of a compass that is not calibrated changes nothing beside a gyroscope, and the answer says so."""
    recording, array, errors = made()
    turns = attitude_at(recording.time_s, recording.time_s[-1])
    ahrs = with_compass(recording, turns, 2, filter_s=2.0)
    found, without = calibrate(ahrs, replace(array, attitude_noise=from_degrees(0.1))), calibrated()
    assert any("attitude is left out beside the gyroscope" in note for note in found.notes)
    np.testing.assert_array_equal(found.errors.to_vector(), without.errors.to_vector())
    assert np.abs((found.errors.bias_T - errors.bias_T) / found.standard_errors[:, 6:9]).max() < 4


def test_rates_and_tolerances_are_used_together():
    """A narrow turn of an array whose data sheet states tolerances is calibrated by the gyroscope all the same."""
    recording, array, errors = made(sensors=4, count=600)
    tolerances = Tolerances(scale_factor=0.05, non_orthogonality=0.02, bias_T=5e-6, misalignment=0.05)
    found = calibrate(recording, replace(array, tolerances=tolerances))
    standard_errors = found.standard_errors[:, 6:9]
    assert (np.abs(found.errors.bias_T - errors.bias_T) < 4.5 * standard_errors).all() and standard_errors.max() < 2e-8
