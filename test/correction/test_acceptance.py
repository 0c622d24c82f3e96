"""What no calibration is beyond, unless somebody accepts it."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tam_calibration.correction.acceptance import LIMITS, beyond_limits, within_limits
from tam_calibration.fit import calibrate
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.results import read_calibration, write_calibration


@pytest.fixture(scope="module")
def calibration(recording, cross):
    """Return a calibration within all limits."""
    return calibrate(recording, cross)


def changed(calibration, part, value):
    """Return a calibration one value of sensor 2 y of which is another."""
    values = getattr(calibration.errors, part).copy()
    values[1, 1] = value
    return replace(calibration, errors=replace(calibration.errors, **{part: values}))


def with_residual(calibration, share, is_estimated=False):
    """Return a calibration that left a share of the intensity of sensor 2."""
    floor = replace(calibration.floor, sensor_intensity_T=np.full(4, 0.1e-9))
    calibration = replace(calibration, noise_is_estimated=is_estimated, floor=floor)
    left = calibration.in_sample.sensor_intensity_T.copy()
    left[1] = share * calibration.intensity_T
    return replace(calibration, in_sample=replace(calibration.in_sample, sensor_intensity_T=left))


def with_gains(calibration, value):
    """Return a calibration whose sensor 2 reads 1.4 times too much along x, and a value along z."""
    factors = calibration.errors.scale_factor.copy()
    factors[1] = 1.4, 1.0, value
    return replace(calibration, errors=replace(calibration.errors, scale_factor=factors))


def with_errors_of_first(calibration, distance):
    """Return a calibration whose sensor 4 has the errors of sensor 1, but for some standard errors of its bias z."""
    vectors = calibration.errors.to_vector()
    vectors[3] = vectors[0]
    vectors[3, 8] += distance * np.hypot(*calibration.standard_errors[[0, 3], 8])
    return replace(calibration, errors=SensorErrors.from_vector(vectors, calibration.errors.orientation))


CASES = {
    "one_sensor": [(with_errors_of_first, None, 10.0, 1.0, "sensors 1 and 4 have the same errors, all twelve within")],
    "scale_factor": [
        (changed, "scale_factor", 0.51, 0.49, "scale factor of sensor 2 y is 0.49, not between 0.5 and 2"),
        (changed, "scale_factor", 1.99, 2.01, "scale factor of sensor 2 y is 2.01"),
        (with_gains, None, 0.71, 0.69, "scale factors of sensor 2 differ by a factor of 2.03, more than 2"),
    ],
    "non_orthogonality": [
        (changed, "non_orthogonality", np.radians(-14.9), np.radians(-15.1), "axes of sensor 2 are 15.1° from"),
    ],
    "bias": [(changed, "bias_T", -1.99e-3, -2.01e-3, "bias of sensor 2 y is -2.01e\\+06 nT, more than 2000000 nT")],
    "residual": [
        (with_residual, None, 0.0049, 0.0051, "leaves 255 nT of sensor 2, more than 0.5% of the field and .* times"),
        (
            partial(with_residual, is_estimated=True),
            None,
            0.0499,
            0.0501,
            "leaves 2505 nT of sensor 2, more than 5% of",
        ),
    ],
}


@pytest.mark.parametrize(("name", "case"), [(name, case) for name, cases in CASES.items() for case in cases])
def test_limits_are_where_they_are_said_to_be(calibration, name, case):
    """Just within is taken; just beyond is refused by sensor, axis and value, or a warning where that is accepted."""
    make, part, within, beyond, sentence = case
    arguments = () if part is None else (part,)
    assert within_limits(make(calibration, *arguments, within), ()).accepted == ()
    too_far = make(calibration, *arguments, beyond)
    with pytest.raises(Refused, match=f"{sentence}.*; where that is so, accept {name}"):
        within_limits(too_far, set(LIMITS) - {name})
    taken = within_limits(too_far, LIMITS)
    assert taken.accepted == (name,) and taken.warnings[0] == beyond_limits(too_far)[name]


def test_every_limit_has_a_case():
    """None is left out above."""
    assert set(CASES) == set(LIMITS)


def test_a_simulator_may_give_all_sensors_the_same_errors(calibration):
    """Then no channel is told to be another's."""
    vectors = np.repeat(calibration.errors.to_vector()[:1], 4, axis=0)
    alike = replace(calibration, errors=SensorErrors.from_vector(vectors, calibration.errors.orientation))
    assert beyond_limits(alike) == {}


def test_a_channel_that_reads_another_sensor_is_refused(recording, cross):
    """With a noise of its own; two sound sensors are not."""
    readings_T = recording.readings_T.copy()
    noise_T = 1e-9 * np.random.default_rng(8).normal(size=readings_T[:, 2].shape)
    readings_T[:, 1] = readings_T[:, 2] + noise_T
    with pytest.raises(Refused, match=r"sensors 2 and 3 have the same errors.*accept one_sensor"):
        calibrate(replace(recording, readings_T=readings_T), cross)


def test_a_file_is_read_within_the_limits_that_were_accepted(calibration, tmp_path):
    """What nobody accepted is refused when it is read: a scale factor of 1e-3 makes 5e7 nT of a field."""
    path = tmp_path / "calibration.yaml"
    too_far = changed(calibration, "scale_factor", 1e-3)
    write_calibration(path, too_far)
    with pytest.raises(
        InputError, match=r"scale factor of sensor 2 y is 0\.001.*calibrate again and accept scale_factor"
    ):
        read_calibration(path)
    write_calibration(path, within_limits(too_far, ["scale_factor"]))
    assert read_calibration(path).accepted == ("scale_factor",)


def test_an_axis_in_another_unit_is_refused(recording, cross):
    """One axis in µT among others in nT has a scale factor of a thousandth; accepted, it is calibrated all the same."""
    readings = recording.readings_T.copy()
    readings[:, 2, 0] /= 1000
    wrong = replace(recording, readings_T=readings)
    with pytest.raises(Refused, match=r"scale factor of sensor 3 x is 0\.000992.*another unit or gain"):
        calibrate(wrong, cross, accept=["unit"])
    calibration = calibrate(wrong, cross, accept=["unit", "scale_factor"])
    assert calibration.accepted == ("scale_factor",)
    assert calibration.errors.scale_factor[2, 0] == pytest.approx(1e-3, rel=0.2)


def test_sensors_that_are_hardly_known_are_not_compared(calibration):
    """A calibration whose parameters may be open, as accepted, is none of one sensor: there is no error to compare."""
    covariance = calibration.covariance.copy()
    covariance[30, 30] = np.inf
    hardly_known = replace(with_errors_of_first(calibration, 0.0), covariance=covariance)
    assert "one_sensor" not in beyond_limits(hardly_known)
