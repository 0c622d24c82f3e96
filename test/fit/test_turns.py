"""Turns of a vehicle: the best comes first, none is faster than the vehicle, and each keeps what it promises.

What a turn has bought so far is what the fit will have.
"""

from dataclasses import replace

import numpy as np
import pytest
from live_mission import UNCHANGING, dive, rates_of_dive
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.fit import calibrate
from tam_calibration.fit.prior import prior_of
from tam_calibration.fit.turns import LiveCoverage, Vehicle, _angles, best_turns, excess_of
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import Gyroscope
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import from_degrees

INTENSITY_T, INCLINATION = 55e-6, from_degrees(62.0)
AUV = Vehicle(from_degrees(10.0), from_degrees(15.0), from_degrees(5.0), 10.0)


@pytest.fixture(scope="module")
def prior(wu_run, wu_scenario):
    """Return a calibration of a full turn, whose biases are uncertain by 20 nT since then."""
    array = replace(wu_scenario.array.with_stated_noise(), change_rates=replace(UNCHANGING, bias_per_day=20e-9))
    return prior_of(calibrate(wu_run.recording, array), None, None)


@pytest.fixture(scope="module")
def turns(prior):
    """Return what the vehicle can do."""
    return best_turns(prior, AUV, INCLINATION)


def test_the_turn_that_buys_most_per_minute_comes_first(prior, turns):
    """All headings, with and without swings, but for the one that is no turn."""
    gains = [turn.gain_per_minute for turn in turns]
    before = excess_of(prior, prior.covariance)
    assert gains == sorted(gains, reverse=True) and gains[0] > gains[-1] >= 0
    assert_allclose(gains, [(before - turn.excess) * 60 / turn.duration_s for turn in turns])
    assert len({(turn.yaw, turn.pitch, turn.roll) for turn in turns}) == len(turns) == 15


def test_what_a_vehicle_cannot_do_is_no_turn(prior):
    """One that neither pitches nor rolls only yaws, a quarter of a circle in 18 s at 5°/s."""
    level = best_turns(prior, replace(AUV, pitch_limit=0.0, roll_limit=0.0), INCLINATION)
    assert {(turn.pitch, turn.roll) for turn in level} == {(0.0, 0.0)}
    durations_s = {round(np.degrees(turn.yaw)): turn.duration_s for turn in level}
    assert durations_s == {90: 18.0, 180: 36.0, 360: 72.0}


@pytest.mark.parametrize("turn", [(90.0, 10.0, 15.0), (360.0, 10.0, 0.0), (0.0, 0.0, 15.0), (360.0, 0.0, 0.0)])
def test_no_axis_turns_faster_than_the_vehicle(turn):
    """Each as fast as it can, the roll slower than the pitch by the golden ratio; two swings at least."""
    yaw, pitch, roll = np.radians(turn)
    angles = _angles(yaw, pitch, roll, AUV)
    rates = np.abs(np.diff(angles, axis=0)).max(axis=0) * AUV.sample_rate_hz / AUV.turn_rate
    golden = (1 + np.sqrt(5)) / 2
    duration_s = max(yaw / AUV.turn_rate, 4 * np.pi * max(pitch, golden * roll) / AUV.turn_rate)
    assert len(angles) == pytest.approx(duration_s * AUV.sample_rate_hz, abs=0.51)
    assert_allclose(angles[-1, 0] - angles[0, 0], yaw)
    assert_allclose(rates[0], yaw / (duration_s * AUV.turn_rate), rtol=0.01)
    assert_allclose(rates[1:], [float(pitch > 0), float(roll > 0) / golden], rtol=0.01)
    assert_allclose(np.abs(angles).max(axis=0)[1:], [pitch, roll], rtol=0.01)


@pytest.mark.parametrize("place", [0, 7, 14])
def test_a_turn_keeps_its_promise(prior, turns, place):
    """A simulated recording of it, calibrated beside the prior, leaves the excess that was promised."""
    turn, rng = turns[place], np.random.default_rng(place)
    to_world = Rotation.from_euler("ZYX", _angles(turn.yaw, turn.pitch, turn.roll, AUV))
    intensity_T = prior.calibration.intensity_T
    field_T = to_world.inv().apply(intensity_T * np.array([np.cos(INCLINATION), 0, -np.sin(INCLINATION)]))
    readings_T = prior.errors.distort(field_T)
    readings_T += 1e-9 * rng.normal(size=readings_T.shape)
    scalar_T = intensity_T + 1e-10 * rng.normal(size=len(field_T))
    recording = Recording(np.arange(len(field_T)) / AUV.sample_rate_hz, readings_T, scalar_T)
    found = calibrate(recording, prior.calibration.array, prior=prior)
    assert not found.update.moved
    assert excess_of(prior, found.covariance) == pytest.approx(turn.excess, rel=0.03)


def test_the_excess_is_in_units_of_the_noise(prior):
    """Of nothing unknown it is none, and in proportion to the covariance."""
    excess = excess_of(prior, prior.covariance)
    assert excess_of(prior, 0 * prior.covariance) == pytest.approx(0)
    assert excess_of(prior, 4 * prior.covariance) == pytest.approx(4 * excess)
    # Biases of 20 nT in each sensor against its noise of 1 nT; what else is unknown is less than the noise.
    assert excess == pytest.approx(400, rel=0.05)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"pitch_limit": 1.6}, "pitch limit"),
        ({"pitch_limit": -0.1}, "pitch limit"),
        ({"roll_limit": 3.2}, "roll limit"),
        ({"roll_limit": np.nan}, "roll limit"),
        ({"turn_rate": 0.0}, "turn rate"),
        ({"turn_rate": 3.2}, "turn rate"),
    ],
)
def test_a_vehicle_that_cannot_be_is_refused(change, told):
    """Limits beyond those of a hull are of another unit."""
    with pytest.raises(InputError, match=told):
        replace(AUV, **change)


def test_a_gyroscope_makes_turns_worth_more(prior, turns):
    """Every turn leaves less with a gyroscope, and nothing changes without a stated noise of it."""
    gyroscope = Gyroscope(from_degrees(0.5e-3), from_degrees(0.1))
    better = {each[:3]: each for each in map(_as_tuple, best_turns(prior, AUV, INCLINATION, gyroscope))}
    for turn in map(_as_tuple, turns):
        assert better[turn[:3]][3] <= turn[3] * (1 + 1e-9)
    assert min(better[turn[:3]][3] / turn[3] for turn in map(_as_tuple, turns)) < 0.95
    silent = best_turns(prior, AUV, INCLINATION, Gyroscope())
    assert list(map(_as_tuple, silent)) == list(map(_as_tuple, turns))


def _as_tuple(turn):
    return turn.yaw, turn.pitch, turn.roll, turn.excess


def test_what_a_turn_has_bought_is_told_without_a_fit(true_errors, cross):
    """The standard error of the bias to a fifth, with the gyroscope and without."""
    gyroscope = Gyroscope(from_degrees(4e-3), from_degrees(0.1))
    rng, time_s, tilt = np.random.default_rng(6), np.arange(0, 300, 0.1), from_degrees(5.0)
    array = replace(Array(cross.positions_m[:1], 1e-9, 1e-10), gyroscope=gyroscope)
    errors = type(true_errors).from_vector(true_errors.to_vector()[:1])
    rows = dive(errors, array, rng, time_s, tilt)
    recording = Recording(time_s, rows[:, 1:-2].reshape(-1, 1, 3), rows[:, -2])
    beside = replace(recording, angular_velocity_rad_s=rates_of_dive(gyroscope, rng, time_s, tilt))
    coverage = LiveCoverage()
    for reading, stamp_s in zip(recording.readings_T, time_s.tolist(), strict=True):
        coverage.add(reading[0], stamp_s, True)
    for told, each in zip(coverage.bought(array), (recording, beside), strict=True):
        found = calibrate(each, array).standard_errors[0, 6:9].max()
        assert told == pytest.approx(found, rel=0.2)
