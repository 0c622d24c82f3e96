"""The nominal fit stays where sensors and the Earth's field can be, and finds the truth where readings tell it."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.array import Array
from tam_calibration.errors import SensorErrors
from tam_calibration.gap import diagnose
from tam_calibration.gap.model import Model
from tam_calibration.gap.nominal import wild_samples
from tam_calibration.problems import InputError
from tam_calibration.recording import Recording

FIELD_T = np.array([0.0, 20e-6, -43e-6])


def hovering(sensors, samples=1500, noise_T=300e-9, tilt_deg=15.0, gains=(1, 1, 1), seed=1):
    """Return a run that turns round but tilts little, its array without stated noise, and the true errors."""
    generator = np.random.default_rng(seed)
    time = np.arange(samples) / 20
    tilt = np.radians(tilt_deg) * np.array([np.sin(0.71 * time), np.sin(1.13 * time + 1)])
    field = Rotation.from_euler("ZYX", np.column_stack([2 * np.pi * time / 31, *tilt])).inv().apply(FIELD_T)
    mounted = Rotation.from_euler("ZYX", [[90 * sensor, 0, 180 * (sensor % 2)] for sensor in range(sensors)], True)
    skew = np.eye(3) + 0.04 * generator.normal(size=(sensors, 3, 3))
    matrix = np.array(gains[:sensors])[:, None, None] * skew @ mounted.as_matrix()
    matrix = matrix @ SensorErrors.from_matrix(matrix, np.zeros((sensors, 3))).rotation[0].T
    errors = SensorErrors.from_matrix(matrix, 30e-6 * generator.normal(size=(sensors, 3)))
    readings = errors.distort(field) + noise_T * generator.normal(size=(samples, sensors, 3))
    return Recording(time, readings), Array(generator.normal(size=(sensors, 3))), errors


@pytest.mark.parametrize(("sensors", "gains"), [(2, (1, 1)), (3, (1, 1, 1)), (2, (1, 0.1))])
def test_a_hovering_array_has_a_calibration(sensors, gains):
    """Within bounds, with nothing left but noise; why a calibration would be refused is said in front."""
    recording, array, _ = hovering(sensors, gains=gains)
    model = Model.nominal(recording, array)
    assert model.objection is None
    assert model.base().channels.energy / model.base().channels.count == pytest.approx(1, abs=0.1)
    gap = diagnose(recording, array)
    assert gap.verdict == "no_gap"
    assert gap.remarks[0].startswith("tam calibrate would refuse this recording: the readings do not determine")


def test_little_tilt_finds_the_truth():
    """Biases of some 30 µT, from 15 degrees of tilt with 300 nT of noise, which is in the field that is fitted too."""
    recording, array, errors = hovering(2)
    model = Model.nominal(recording, array)
    assert_allclose(model.errors.bias_T, errors.bias_T, atol=3e-6)
    found, true = (one.scale_factor / one.scale_factor.mean() for one in (model.errors, errors))
    assert_allclose(found, true, atol=0.03)


def test_one_sensor_that_hovers_has_no_verdict():
    """Nothing but the length of the field is redundant, and open parameters take that up: the time is told."""
    recording, array, _ = hovering(1, tilt_deg=3)
    gap = diagnose(recording, array)
    assert gap.verdict == "not_identifiable" and gap.causes == ()
    assert gap.statement.startswith("No verdict on the time from 0.0 to 75.0 s: the readings do not determine")


def test_an_axis_that_repeats_another_is_refused(run):
    """Scaled and shifted or not, of another sensor or of its own."""
    readings = run(300, 2).recording.readings_T.copy()
    readings[:, 1, 2] = 0.7 * readings[:, 0, 1] + 1e-6
    with pytest.raises(InputError, match="sensor 2 axis z repeats sensor 1 axis y but for scale and offset"):
        diagnose(replace(run(300, 2).recording, readings_T=readings), run(300, 2).array)


def test_a_millionth_of_noise_is_no_copy(run):
    """Two sensors alike but for noise of 5e-6 of the field's spread are two."""
    made = run(300, 2)
    readings = made.recording.readings_T.copy()
    readings[:, 1] = readings[:, 0] + 2e-10 * np.random.default_rng(0).normal(size=(300, 3))
    assert diagnose(replace(made.recording, readings_T=readings), made.array).verdict != "not_identifiable"


def test_sensors_that_share_no_motion_have_no_verdict():
    """One turns, the other reads noise as large as the field."""
    recording, array, _ = hovering(2)
    readings = recording.readings_T.copy()
    readings[:, 1] = 3e-5 * np.random.default_rng(4).normal(size=(1500, 3))
    gap = diagnose(replace(recording, readings_T=readings), array)
    assert gap.verdict == "not_identifiable" and "its sensors share no motion" in gap.statement


def test_half_of_the_run_is_enough():
    """Zeros in a third of the samples of a sensor: the calibration is that of the others."""
    recording, array, errors = hovering(2, tilt_deg=60)
    readings = recording.readings_T.copy()
    readings[::3, 1] = 0
    model = Model.nominal(replace(recording, readings_T=readings), array)
    assert model.objection is None
    assert_allclose(model.errors.bias_T, errors.bias_T, atol=1e-6)


def test_a_contradicted_sheet_gives_way(run):
    """Ten times the stated noise in all sensors: the floor is what is found, and that is said."""
    made = run(1500, sheet=10.0)
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "no_gap" and gap.size.floor_T == pytest.approx(1e-9, rel=0.1)
    assert len(gap.remarks) == 4 and "stated 0.1 nT, found" in gap.remarks[0]


def test_noise_has_no_hand():
    """Two sensors that read noise alone are not told to be left-handed; one whose axis is turned round is."""
    recording, array, _ = hovering(2)
    for seed in range(4):
        noise = np.random.default_rng(seed).normal(30e-6, 1e-6, size=(1500, 2, 3))
        assert diagnose(replace(recording, readings_T=noise), array).verdict == "not_identifiable"
    readings = recording.readings_T * np.where(np.arange(6).reshape(2, 3) == 4, -1, 1)
    with pytest.raises(InputError, match="sensor 2 has left-handed or dependent axes"):
        diagnose(replace(recording, readings_T=readings), array)


@pytest.mark.parametrize(
    ("size", "part", "are_wild"), [(3.0, 0.01, False), (5.6, 0.01, True), (50.0, 0.014, True), (50.0, 0.028, False)]
)
def test_few_readings_far_beyond_the_others_are_wild(run, size, part, are_wild):
    """One in fifty, and four times as large as they mostly are; what is smaller or more is in the fit."""
    made = run(1000)
    struck = np.arange(1000) < 1000 * part
    readings = np.where(struck[:, None, None], size, 1.0) * made.recording.readings_T
    wild = wild_samples(replace(made.recording, readings_T=readings))
    assert np.array_equal(wild, struck if are_wild else np.zeros(1000, dtype=bool))
