from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.exceptions import InputError
from tam_calibration.fit.identifiability import require_accurate, require_determined
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.recording import Recording

FIELD = 54955.83e-9 * np.array([0.42, 0.21, -0.883]) / np.linalg.norm([0.42, 0.21, -0.883])


def turned(errors, rotation, noise_T=1e-9):
    """Return the noisy recording of an array turned by rotations in a uniform field."""
    readings = errors.distort(rotation.inv().apply(FIELD))
    count = len(readings)
    noise = noise_T * np.random.default_rng(5).standard_normal(readings.shape)
    return Recording(np.arange(count) * 0.1, readings + noise, np.full(count, np.linalg.norm(FIELD)))


def turn(axis, count=120):
    """Return one full turn about an axis."""
    return Rotation.from_euler(axis, np.linspace(0, 360, count, endpoint=False)[:, None], degrees=True)


def test_random_attitudes_determine_everything(wu_run, wu_scenario):
    """Wu's 360 random attitudes pass."""
    require_determined(wu_run.recording, wu_scenario.array)


@pytest.mark.parametrize("noise_T", [0.0, 1e-9, 50e-9])
@pytest.mark.parametrize(("axis", "open_"), [("z", "bias z"), ("x", "bias x"), ("y", "bias y")])
def test_a_single_turn_names_the_bias_along_its_axis(wu_run, wu_scenario, axis, open_, noise_T):
    """One turn about one axis leaves the bias along it open, with or without noise."""
    with pytest.raises(InputError, match=rf"do not determine .*{open_}.* of every sensor"):
        require_determined(turned(wu_run.errors, turn(axis), noise_T), wu_scenario.array)


def test_nine_coplanar_poses_are_refused(wu_run, wu_scenario):
    """Nine poses of one turn are as many as parameters of an ellipsoid, and still determine none."""
    with pytest.raises(InputError, match=r"do not determine .*scale factor z"):
        require_determined(turned(wu_run.errors, turn("z", 9)), wu_scenario.array)


def test_two_turns_leave_one_combination_open_and_three_none(wu_run, wu_scenario):
    """Turns about z and x have rank 44 of 45 (Li 2018b); a third one about y completes it."""
    two = Rotation.concatenate([turn("z"), turn("x")])
    with pytest.raises(InputError, match="bias x"):
        require_determined(turned(wu_run.errors, two), wu_scenario.array)
    three = Rotation.concatenate([two, turn("y")])
    require_determined(turned(wu_run.errors, three), wu_scenario.array)


def test_too_few_samples_are_told_with_the_number_of_parameters(wu_run, wu_scenario):
    """Eight samples for 45 parameters are refused with both numbers."""
    with pytest.raises(InputError, match="8 samples cannot determine the 45 parameters of 4 sensors"):
        require_determined(wu_run.recording.take(slice(0, 8)), wu_scenario.array)


def test_too_few_scalar_readings_are_told(wu_run, wu_scenario):
    """A scalar channel with three readings is neither a reference nor none."""
    sparse = np.full(wu_run.recording.sample_count, np.nan)
    sparse[:3] = 54955.83e-9
    with pytest.raises(InputError, match="only 3 samples have a scalar reading"):
        require_determined(replace(wu_run.recording, scalar_T=sparse), wu_scenario.array)


def test_a_large_standard_error_names_its_parameter(wu_run, wu_scenario):
    """After a fit a useless parameter is named with its sensor."""
    calibration = maximum_likelihood(wu_run.recording, wu_scenario.array)
    require_accurate(calibration)
    poor = calibration.covariance.copy()
    poor[31, 31] = 1e-12
    with pytest.raises(InputError, match="do not determine bias y of sensor 3"):
        require_accurate(replace(calibration, covariance=poor))
