"""What a turn has bought so far is what the fit will have."""

from dataclasses import replace

import numpy as np
import pytest
from live_mission import dive, rates_of_dive

from tam_calibration.fit import calibrate
from tam_calibration.fit.turns import LiveCoverage
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import Gyroscope
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import from_degrees


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
