"""The nominal fit stays where sensors and the Earth's field can be, and finds the truth where readings tell it."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.gap import diagnose
from tam_calibration.gap.diagnose import judge
from tam_calibration.gap.model import Model
from tam_calibration.gap.nominal import (
    canonical_correlations,
    objection_to,
    outlying_samples,
    prior_at,
    sensed_intensity,
    significant_correlation,
    steady_parts,
    without_channels,
)
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.geomagnetic_field import EARTH_FIELD, FieldBounds
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors

FIELD_T = np.array([0.0, 20e-6, -43e-6])


def hovering(sensors, samples=600, noise_T=300e-9, tilt_deg=15.0, gains=(1, 1, 1), seed=1):
    """Return a run that turns round but tilts little, its array without stated noise, and the true errors."""
    generator = np.random.default_rng(seed)
    time = np.linspace(0, 75, samples)
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
    judged = judge(recording, array)
    channels = judged.found.nominal.base().channels
    assert judged.found.nominal.objection is None
    assert channels.energy / channels.count == pytest.approx(1, abs=0.1)
    assert judged.gap.verdict == "no_gap"
    assert judged.gap.remarks[0].startswith("tam calibrate would refuse this recording: the readings do not determine")


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
    assert gap.statement.startswith("No verdict on the recording of 75.0 s: the readings do not determine")


def test_an_axis_that_repeats_another_is_refused(run):
    """Scaled and shifted or not, of another sensor or of its own."""
    readings = run(300, 2).recording.readings_T.copy()
    readings[:, 1, 2] = 0.7 * readings[:, 0, 1] + 1e-6
    with pytest.raises(Refused, match="sensor 2 axis z repeats sensor 1 axis y but for scale and offset"):
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
    readings[:, 1] = 3e-5 * np.random.default_rng(4).normal(size=(600, 3))
    gap = diagnose(replace(recording, readings_T=readings), array)
    assert gap.verdict == "not_identifiable" and "its sensors share no motion" in gap.statement


def test_half_of_the_run_is_enough():
    """Zeros in a third of the samples of a sensor: the calibration is that of the others."""
    recording, array, errors = hovering(2, samples=300, tilt_deg=60)
    readings = recording.readings_T.copy()
    readings[::3, 1] = 0
    model = Model.nominal(replace(recording, readings_T=readings), array)
    assert model.objection is None
    assert_allclose(model.errors.bias_T, errors.bias_T, atol=1e-6)


def test_a_contradicted_sheet_gives_way(run):
    """Ten times the stated noise in all sensors: the floor is what is found, and that is said."""
    made = run(600, sheet=10.0)
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "no_gap" and gap.size.floor_T == pytest.approx(1e-9, rel=0.1)
    assert len(gap.remarks) == 4 and "stated 0.1 nT, found" in gap.remarks[0]


def test_noise_has_no_hand():
    """Two sensors that read noise alone are not told to be left-handed; one whose axis is turned round is."""
    recording, array, _ = hovering(2)
    for seed in range(4):
        noise = np.random.default_rng(seed).normal(30e-6, 1e-6, size=(600, 2, 3))
        assert diagnose(replace(recording, readings_T=noise), array).verdict == "not_identifiable"
    readings = recording.readings_T * np.where(np.arange(6).reshape(2, 3) == 4, -1, 1)
    with pytest.raises(
        Refused, match=r"sensor 1 is a mirror image of sensor 2 .* can be decided only with recorded attitude"
    ):
        diagnose(replace(recording, readings_T=readings), array)


@pytest.mark.parametrize(
    ("size", "part", "are_outliers"), [(3.0, 0.01, False), (5.6, 0.01, True), (50.0, 0.007, True), (50.0, 0.014, False)]
)
def test_few_readings_far_beyond_the_others_are_outliers(run, size, part, are_outliers):
    """One in a hundred, and four times as large as they mostly are; what is smaller or more is in the fit."""
    made = run(1000)
    struck = np.arange(1000) < 1000 * part
    readings = np.where(struck[:, None, None], size, 1.0) * made.recording.readings_T
    outlying = outlying_samples(replace(made.recording, readings_T=readings))
    assert np.array_equal(outlying, struck if are_outliers else np.zeros(1000, dtype=bool))


def scattered(time, seed=1):
    """Return (N,) whether something is on: in stretches of 1 to 8 s, for some 70 % of the time."""
    generator, is_on, begin = np.random.default_rng(seed), np.zeros(len(time), dtype=bool), 0.0
    while begin < time[-1]:
        end = begin + generator.uniform(1, 8)
        is_on |= (time >= begin) & (time < end)
        begin = end + generator.uniform(0.3, 3.5)
    return is_on


def test_a_current_of_tens_of_microtesla_is_found(run):
    """A motor runs for most of the time, and no stretch has a fit of sensors: the fit starts beside the current."""
    made = run(300, 2, has_scalar=False)
    generator = np.random.default_rng(3)
    time = made.recording.time_s
    is_on = scattered(time)
    current = is_on * generator.uniform(1, 8, size=61)[time.astype(int)]
    assert 0.6 < is_on.mean() < 0.8
    of_ampere = 6e-6 * generator.normal(size=6)
    added = np.zeros((300, made.row_count))
    added[:, :6] = np.outer(current, of_ampere)
    recording = replace(made.with_added(added).recording, current_A=current)
    judged = judge(recording, made.array)
    at_median = made.errors.bias_T + np.median(current) * of_ampere.reshape(2, 3)
    assert_allclose(judged.found.nominal.errors.bias_T, at_median, atol=0.1e-6)
    assert judged.gap.verdict == "explained"
    assert [cause.fitted.effect for cause in judged.gap.causes] == ["current_interference"]


def test_where_no_bias_follows_the_current_the_fit_starts_where_it_is_off(run):
    """The field of another motor on the same switch, which draws a current of its own."""
    made = run(300, 2, has_scalar=False)
    generator = np.random.default_rng(3)
    time = made.recording.time_s
    is_on = scattered(time)
    other, current = is_on * generator.uniform(1, 8, size=(2, 61))[:, time.astype(int)]
    added = np.zeros((300, made.row_count))
    added[:, :6] = np.outer(other, 6e-6 * generator.normal(size=6))
    recording = replace(made.with_added(added).recording, current_A=current)
    assert without_channels(recording) is None
    assert_allclose(Model.nominal(recording, made.array).errors.bias_T, made.errors.bias_T, atol=0.1e-6)


def test_a_scale_step_of_two_is_found_from_the_steady_half(run, monkeypatch):
    """A gain that doubles tilts the fit to the whole; from the half before it stands alone, at its sensor and time."""
    models, of_steady = [], Model.steady
    monkeypatch.setattr(Model, "steady", lambda whole: models.extend((whole, of_steady(whole))) or models[-1])
    made = run(300, 2, has_scalar=False)
    readings = made.recording.readings_T.copy()
    readings[150:, 1] *= 2
    recording = replace(made.recording, readings_T=readings)
    (cause,) = diagnose(recording, made.array).causes
    nominal, steady = models
    assert np.abs(nominal.errors.bias_T - made.errors.bias_T).max() > 1e-6
    assert_allclose(steady.errors.bias_T, made.errors.bias_T, atol=0.1e-6)
    assert (cause.fitted.effect, cause.sensors) == ("scale_step", (2,))
    assert cause.fitted.shape["time_s"] == pytest.approx(30.0, abs=0.1)


def test_where_nothing_explains_a_gap_it_stands_beside_the_steady_part(run):
    """A sensor that reads one wrong value for half of the time: it is named, and its neighbour is not."""
    made = run(300, 2, has_scalar=False)
    readings = made.recording.readings_T.copy()
    readings[90:225, 1] = 1.1 * readings[90, 1]
    gap = diagnose(replace(made.recording, readings_T=readings), made.array)
    assert gap.verdict == "unexplained" and gap.where.sensors == (2,)


def test_what_leaves_nothing_gross_has_no_other_start(run):
    """A clean run, and one with a thousand noise floors, keep the calibration of the whole."""
    made = run(400)
    assert Model.nominal(made.recording, made.array).steady() is None
    disturbed = made.with_row(4, 3e-7 * np.sin(made.recording.time_s))
    assert Model.nominal(disturbed.recording, made.array).steady() is None


def test_steady_parts_are_of_time_and_of_channels(run):
    """Halves, thirds, and the fifth of the samples in which temperature and current hardly change, in their order."""
    current = np.where(np.arange(300) % 3 == 0, 0.0, np.arange(300))
    recording = replace(run(300).recording, current_A=current, temperature_C=np.append(np.zeros(60), np.arange(1, 241)))
    *stretches, temperature, by_current = steady_parts(recording)
    assert [(one.start, one.stop) for one in stretches] == [(0, 150), (150, 300), (0, 100), (100, 200), (200, 300)]
    assert temperature.tolist() == list(range(60))
    assert len(by_current) == 60 and set(by_current % 3) == {0} and (np.diff(by_current) > 0).all()


def test_a_field_beyond_the_bounds_is_no_field_within_them(run):
    """2 µT that were turned about all axes are no small part of a sphere of the Earth's field: the bound is told."""
    made = run(300, 2, has_scalar=False, noise_T=1e-10)
    gap = diagnose(replace(made.recording, readings_T=0.04 * made.recording.readings_T), made.array)
    assert gap.verdict == "not_identifiable"
    assert "the one that fits best has a field of 2 µT, where the Earth's has 15 to 100" in gap.statement


def test_an_axis_at_the_end_of_its_range_for_a_third_breaks_nothing(run):
    """A step from there leads to no sensor and is not taken; an axis that fails may be named, with its times."""
    made = run(300, 1, has_scalar=False)
    readings = made.recording.readings_T.copy()
    readings[100:200, 0, 0] = readings[100:200, 0, 0].max()
    gap = diagnose(replace(made.recording, readings_T=readings, attitude=None), made.array)
    assert gap.verdict in ("unexplained", "not_identifiable", "partly_explained")
    times = [tuple(cause.fitted.shape.values()) for cause in gap.causes[:1]]
    assert {cause.fitted.effect for cause in gap.causes} <= {"scale_step"}
    assert all(one == pytest.approx(made.recording.time_s[[100, 200]], abs=0.1) for one in times)


def test_any_mounting_shares_all_of_the_motion():
    """A linear map of the readings, shifted."""
    readings = np.random.default_rng(0).normal(size=(500, 1, 3))
    both = np.concatenate([readings, readings @ [[0, 2, 0], [1, 0, 0.3], [0, 0, -1]] + 7], axis=1)
    assert_allclose(canonical_correlations(both), 1, atol=1e-12)


def test_half_of_noise_leaves_its_part():
    """Equal parts of signal and noise in one of two: the root of a half."""
    generator = np.random.default_rng(1)
    signal = generator.normal(size=(20000, 3))
    both = np.stack([signal, signal + generator.normal(size=signal.shape)], axis=1)
    assert_allclose(canonical_correlations(both)[1], np.sqrt(0.5), atol=0.02)


@pytest.mark.parametrize(("samples", "sure"), [(20, 0.5), (900, 0.5), (2500, 0.3), (10000, 0.15)])
def test_what_is_sure_falls_with_the_root_of_the_samples(samples, sure):
    """Noise stays below."""
    assert significant_correlation(samples) == pytest.approx(sure)
    if samples > 100:
        noise = np.random.default_rng(2).normal(size=(samples, 2, 3))
        assert canonical_correlations(noise)[1].max() < 0.4 * sure


def test_spikes_do_not_hide_the_motion():
    """One reading in a hundred is a thousand times as large."""
    readings = np.random.default_rng(3).uniform(-1, 1, size=(1000, 1, 3))
    both = np.concatenate([readings, readings], axis=1)
    both[::100, 1, 0] = 1000
    assert canonical_correlations(both)[1].min() > 0.6


INTENSITY_T = 48e-6


def errors_of(*matrices):
    """Return errors of matrices D Λ without bias."""
    return SensorErrors.from_matrix(np.array(matrices, dtype=float), np.zeros((len(matrices), 3)))


def skewed(degrees):
    """Return a matrix whose second axis stands off the right angle to the third."""
    angle = np.radians(degrees)
    return np.array([[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, 0, 1]])


@pytest.mark.parametrize(
    ("matrix", "intensity_T", "told"),
    [
        (np.eye(3), INTENSITY_T, None),
        (np.diag([0.1, 0.1, 0.1]), INTENSITY_T, None),
        (np.diag([1, 1.4, 1.9]), INTENSITY_T, None),
        (np.diag([1, 1.4, 2.1]), INTENSITY_T, "scale factors of sensor 2 that differ by a factor of 2.1"),
        (skewed(14), INTENSITY_T, None),
        (skewed(-16), INTENSITY_T, "axes of sensor 2 that stand 16 degrees off the right angle"),
        (Rotation.from_rotvec([2.0, 1.0, -0.5]).as_matrix(), INTENSITY_T, None),
        (np.eye(3), 14e-6, "a field of 14 µT, where the Earth's has 15 to 100"),
        (np.eye(3), 101e-6, "a field of 101 µT, where the Earth's has 15 to 100"),
    ],
)
def test_what_nothing_real_has_is_told(matrix, intensity_T, told):
    """The first sensor has no errors; gain and mounting are free."""
    assert objection_to(errors_of(np.eye(3), matrix), intensity_T, EARTH_FIELD) == told


@pytest.mark.parametrize("has_scalar", [True, False])
def test_the_score_is_the_slope_of_the_energy(has_scalar):
    """By differences of the energy over each element of the matrices."""
    generator = np.random.default_rng(3)
    matrix = np.eye(3) + 0.15 * generator.normal(size=(2, 3, 3))
    intensity_T = None if has_scalar else INTENSITY_T

    def energy(change):
        return prior_at(errors_of(*(matrix + change)), intensity_T, EARTH_FIELD).energy

    slope = np.zeros((2, 3, 4))
    for index in np.ndindex(2, 3, 3):
        step = np.zeros((2, 3, 3))
        step[index] = 1e-6
        slope[index] = (energy(step) - energy(-step)) / 2e-6
    assert_allclose(prior_at(errors_of(*matrix), intensity_T, EARTH_FIELD).score, -slope.ravel() / 2, atol=1e-6)


def test_bounds_lie_at_three_and_a_half_deviations():
    """An axis at the widest cosine, and the field at the ends of the Earth's, each cost 3.5²."""
    angle = np.degrees(np.arcsin(0.35))
    assert prior_at(errors_of(skewed(angle)), None, EARTH_FIELD).energy == pytest.approx(3.5**2, rel=0.01)
    assert prior_at(errors_of(np.eye(3)), 15e-6, EARTH_FIELD).energy == pytest.approx(3.5**2, rel=0.01)
    assert prior_at(errors_of(np.eye(3)), np.sqrt(15 * 100) * 1e-6, EARTH_FIELD).energy == pytest.approx(0, abs=1e-9)


def test_two_axes_that_differ_by_the_largest_ratio_cost_as_much():
    """Of logarithms with deviations σ the difference has √2 σ; what the third adds is left out by placing it midway."""
    energy = prior_at(errors_of(np.diag([1, np.sqrt(2), 2])), None, EARTH_FIELD).energy
    assert energy == pytest.approx(3.5**2, rel=0.01)


def test_the_intensity_is_told_in_the_unit_that_suits_the_earth():
    """A sensor that reads ten times as much, or a tenth, beside one without errors."""
    for gain in (0.1, 10):
        assert sensed_intensity(errors_of(gain * np.eye(3), np.eye(3)), INTENSITY_T, EARTH_FIELD) == pytest.approx(
            INTENSITY_T
        )
    assert sensed_intensity(errors_of(2 * np.eye(3), 4 * np.eye(3)), INTENSITY_T, EARTH_FIELD) == pytest.approx(
        2 * INTENSITY_T
    )


def test_bounds_of_another_field_take_the_place_of_the_earths():
    """A coil of 500 µT: the prior stands about its middle, and the Earth's field is none of it."""
    coil = FieldBounds(400e-6, 625e-6)
    assert objection_to(errors_of(np.eye(3)), 500e-6, coil) is None
    assert objection_to(errors_of(np.eye(3)), INTENSITY_T, coil) == "a field of 48 µT, where the array's has 400 to 625"
    assert prior_at(errors_of(np.eye(3)), 400e-6, coil).energy == pytest.approx(3.5**2, rel=0.01)
    assert prior_at(errors_of(np.eye(3)), 500e-6, coil).energy == pytest.approx(0, abs=1e-9)
    assert sensed_intensity(errors_of(0.1 * np.eye(3), np.eye(3)), 500e-6, coil) == pytest.approx(500e-6)
