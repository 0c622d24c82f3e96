"""An attitude that leans on the magnetometer is left out or refused by name; the noise of a sound one is found."""

import re
from dataclasses import replace

import numpy as np
import pytest
from compasses import CROSS, ERRORS, WORLD_T, circles, off_by, recorded, swings, with_compass, worst
from scipy.spatial.transform import Rotation

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import calibrate
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.units import from_degrees

ESTIMATED = replace(CROSS, attitude_noise=np.inf)


def stating(deg):
    """Return the array with a stated noise of attitude."""
    return replace(CROSS, attitude_noise=from_degrees(deg))


def answer(recording, array, **given):
    """Return the calibration, or the sentence of a refusal."""
    try:
        return calibrate(recording, array, **given)
    except (InputError, Refused) as refusal:
        return str(refusal)


@pytest.mark.parametrize(
    ("array", "turns", "filter_s"),
    [(stating(0.1), circles(), 0.0), (stating(0.8), circles(), 3.0), (ESTIMATED, circles(5.0), 0.0)],
)
def test_a_heading_of_a_sensors_own_readings_is_left_out_by_name(array, turns, filter_s):
    """Of full circles, filtered or not, whatever noise is stated; roll and pitch stay, and the errors are right."""
    recording = with_compass(recorded(turns, 1), turns, 2, sensor=2, filter_s=filter_s)
    found = calibrate(recording, array)
    (note,) = found.notes
    assert "the heading of the recorded attitude" in note and ("sensor 3" in note or filter_s)
    assert "gyroscope and accelerometer only" in note and note.endswith("is left out")
    assert worst(found) < 4


def test_a_raw_heading_is_recognised_in_a_narrow_turn():
    """At three degrees of tilt readings tell too little without: the refusal names sensor and remedy."""
    turns = circles(3.0, count=300)
    refusal = answer(with_compass(recorded(turns, 3), turns, 4, tilt_deg=0.5), stating(0.1))
    assert isinstance(refusal, str)
    assert "sensor 1" in refusal and "without the magnetometer" in refusal and "do not determine" in refusal


@pytest.mark.parametrize(
    ("turns", "deg", "array"),
    [
        (circles(), 0.05, ESTIMATED),
        (circles(5.0), 0.5, stating(0.5)),
        (circles(5.0), 0.05, ESTIMATED),
        (swings(15.0), 0.5, ESTIMATED),
    ],
)
def test_a_sound_attitude_is_kept(turns, deg, array):
    """Without a note or a warning, its noise stated or estimated, and with the errors it closes."""
    found = calibrate(recorded(turns, 5, attitude=off_by(turns, deg, 6)), array)
    assert found.notes == () and found.warnings == ()
    assert found.array.attitude_noise == pytest.approx(from_degrees(deg), rel=0.1)
    assert worst(found) < 4.2


def test_a_wrong_noise_of_attitude_is_told_and_not_used():
    """Ten times too small: over 4 runs the intervals hold as with the right one. Too large, it changes no answer."""
    turns, squares = circles(5.0), []
    for seed in range(4):
        recording = recorded(turns, seed, attitude=off_by(turns, 0.5, seed + 100))
        found = calibrate(recording, stating(0.05))
        assert "the stated attitude_noise_deg, 0.05, is too small" in found.warnings[0] and len(found.warnings) == 1
        free = found.standard_errors > 0
        off = (found.errors.to_vector() - ERRORS.to_vector())[free] / found.standard_errors[free]
        squares.append(np.mean(off**2))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.3)
    other = calibrate(recording, stating(5.0))
    assert "the stated attitude_noise_deg, 5, is too large" in other.warnings[0] and len(other.warnings) == 1
    np.testing.assert_allclose(other.standard_errors, found.standard_errors, rtol=0.01)
    assert np.abs(other.errors.to_vector() - found.errors.to_vector())[free].max() < 1e-6


def test_errors_that_last_count_as_larger_ones():
    """The same for 40 samples at a time: over 2 runs intervals hold, and the noise is some √40 times as large."""
    turns, ratios, noises = circles(5.0, count=2400), [], []
    for seed in range(2):
        attitude = off_by(turns, 0.3, seed + 50, lasting=40)
        found = calibrate(recorded(turns, seed, attitude=attitude), ESTIMATED)
        ratios.append(worst(found))
        noises.append(found.array.attitude_noise)
    assert max(ratios) < 4.2
    assert np.median(noises) == pytest.approx(from_degrees(0.3) * np.sqrt(40), rel=0.4)


def test_an_attitude_of_another_convention_is_left_out():
    """The turn from the world to the array is named as what it is not."""
    turns = circles()
    found = calibrate(recorded(turns, 7, attitude=turns.inv()), stating(0.5))
    assert any("turns the world into the array: write the inverse" in note for note in found.notes)
    assert worst(found) < 4


@pytest.mark.parametrize("turns", [circles(5.0), swings(20.0)])
def test_what_unused_attitude_would_bring_is_told_in_numbers(turns):
    """They are those of the fit with it, to a fifth."""
    recording = recorded(turns, 8, attitude=off_by(turns, 0.1, 9))
    found = answer(recording, CROSS)
    if not isinstance(found, Calibration):
        assert "or set attitude_noise_deg: estimate" in found
        return
    (note,) = found.notes
    before, after = map(float, re.search(r"from (\S+) to ([0-9.e-]+)", note).groups())
    beside = calibrate(recording, ESTIMATED)
    ratio = beside.standard_errors / np.where(found.standard_errors > 0, found.standard_errors, np.inf)
    assert after / before == pytest.approx(np.min(ratio[ratio > 0]), rel=0.2)


def test_attitude_that_would_bring_nothing_is_told_too():
    """All round, one degree adds nothing to a scalar and four sensors."""
    turns = Rotation.random(600, np.random.default_rng(1))
    found = calibrate(recorded(turns, 1, attitude=off_by(turns, 1.0, 2)), CROSS)
    assert any("would reduce no standard error by more than 5%" in note for note in found.notes)


@pytest.mark.parametrize(
    ("main_field_T", "is_left_out"),
    [
        (WORLD_T, False),
        (1.3 * WORLD_T, True),
        (Rotation.from_rotvec([0, 0.3, 0]).apply(WORLD_T), True),
    ],
)
def test_a_place_that_contradicts_is_left_out(main_field_T, is_left_out):
    """A field in another direction, or of another size than the scalar reads."""
    turns = circles()
    found = calibrate(recorded(turns, 3, attitude=off_by(turns, 0.2, 4)), ESTIMATED, main_field_T=main_field_T)
    assert any("latitude, longitude and date" in note for note in found.notes) is is_left_out
    assert worst(found) < 4
