"""A gap is found in the sensor, axis, time and band in which it was planted, whatever its cause."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.gap.rivals import FunctionOfTime
from tam_calibration.gap.size import examine, rivals
from tam_calibration.gap.where import band_of, locate, main_places, noisy_places, sensors_and_axes, span_of
from tam_calibration.model.fitted_effect import ALL, SCALAR


@pytest.mark.parametrize(
    ("places", "sensors", "axes"),
    [
        ([], (), ()),
        ([(1, 0)], (2,), ("x",)),
        ([(2, 1), (0, 2), (2, 2)], (1, 3), ("y", "z")),
        ([(3, None)], (4,), ("x", "y", "z")),
        ([(SCALAR, None)], ("scalar",), ()),
        ([(SCALAR, None), (1, 0)], (2, "scalar"), ("x",)),
        ([(ALL, None)], (1, 2, 3, 4), ("x", "y", "z")),
    ],
)
def test_places_have_the_names_that_people_use(run, places, sensors, axes):
    """Sensors count from one, in order; the scalar has no axes."""
    assert sensors_and_axes(places, run(30).recording) == (sensors, axes)


def test_an_intensity_that_is_taken_for_constant_is_seen_by_all(run):
    """Without a scalar magnetometer its place is that of all sensors."""
    recording = run(30, has_scalar=False).recording
    assert sensors_and_axes([(SCALAR, None)], recording)[0] == (1, 2, 3, 4)


@pytest.mark.parametrize("row", [0, 4, 11])
def test_a_noisy_axis_is_found(run, row):
    """White noise that one axis has more."""
    made = run(800)
    noise = 2e-9 * np.random.default_rng(1).normal(size=800)
    places, gain = noisy_places(made.with_row(row, noise).channels())
    assert places == [divmod(row, 3)] and gain > 100


def test_a_noisy_sensor_and_a_noisy_scalar_are_found(run):
    """All three axes, or the scalar alone."""
    made, generator = run(800), np.random.default_rng(1)
    added = np.zeros((800, 13))
    added[:, 6:9] = 2e-9 * generator.normal(size=(800, 3))
    assert noisy_places(made.with_added(added).channels())[0] == [(2, None)]
    scalar = made.with_row(12, 5e-9 * generator.normal(size=800))
    assert noisy_places(scalar.channels())[0] == [(SCALAR, None)]


def test_noise_common_to_all_has_no_place(run):
    """A sheet that is wrong for all alike gains nothing beyond chance."""
    assert noisy_places(run(800, sheet=1.3).channels())[1] < 15


@pytest.mark.parametrize(("row", "place"), [(4, (1, 1)), (9, (3, 0)), (12, (SCALAR, None))])
def test_a_drift_without_cause_is_found_in_its_row(run, row, place):
    """The strongest function without physics stands where the drift was planted."""
    made = run(700)
    base = made.with_row(row, 6e-9 * np.sin(0.35 * made.recording.time_s)).model().base()
    strongest = max(rivals(base), key=lambda one: one.delta_bic)
    assert main_places(base, strongest) == [place]


def test_where_without_causes_is_that_of_the_strongest_rival(run):
    """Sensor and axis, and which kind of channel shows it; noise of a sensor where no rival says more."""
    made = run(700)
    model = made.with_row(4, 6e-9 * np.sin(0.35 * made.recording.time_s)).model()
    base = model.base()
    where = locate(base, [], rivals(base), 1.0)
    assert (where.sensors, where.axes) == ((2,), ("y",))
    assert where.evidence["differential_chi_square"] > 1.2
    noisy = made.with_row(7, 3e-9 * np.random.default_rng(2).normal(size=700)).model().base()
    where = locate(noisy, [], rivals(noisy), 1.0)
    assert (where.sensors, where.axes) == ((3,), ("y",))


def test_where_with_causes_is_theirs(run):
    """The places of all causes together."""
    base = run(300).model().base()
    where = locate(base, [[(0, 1)], [(2, 0), (2, 1)]], [], 1.0)
    assert (where.sensors, where.axes) == ((1, 3), ("x", "y"))


def test_the_span_holds_what_is_not_in_the_whole_run(run):
    """A burst of ten seconds, and nothing where the excess is everywhere."""
    made = run(1200)
    time, generator = made.recording.time_s, np.random.default_rng(1)
    burst = np.where((time > 20) & (time < 30), 1, 0) * 20e-9 * generator.normal(size=1200)
    channels = made.with_row(4, burst).channels()
    low, high = span_of(channels, channels.energy_per_sample - channels.channels_per_sample)
    assert low == pytest.approx(20, abs=1.5) and high == pytest.approx(30, abs=1.5)
    everywhere = made.with_row(4, 20e-9 * generator.normal(size=1200)).channels()
    assert span_of(everywhere, everywhere.energy_per_sample - everywhere.channels_per_sample) is None
    assert span_of(channels, -np.ones(1200)) is None


def test_the_band_holds_a_line(run):
    """A line of 3 Hz in a row, and none in white noise or a short run."""
    made = run(1200)
    channels = made.with_row(4, 10e-9 * np.sin(2 * np.pi * 3.0 * made.recording.time_s)).channels()
    low, high = band_of(channels, 4, 1.0)
    assert low == pytest.approx(3, abs=0.1) and high == pytest.approx(3, abs=0.1)
    assert band_of(made.channels(), 4, 1.0) is None
    assert band_of(run(40).channels(), 4, 1.0) is None


def test_evidence_tells_the_two_kinds_of_channels_apart(run):
    """A scalar that is off shows in the common mode only; without one there is none to tell of."""
    made = run(600)
    base = made.with_row(12, 5e-9 * np.sin(0.4 * made.recording.time_s)).model().base()
    evidence = locate(base, [[(SCALAR, None)]], [], 1.0).evidence
    assert evidence["differential_chi_square"] == pytest.approx(1, abs=0.1)
    assert evidence["common_mode_chi_square"] > 5
    missing = replace(base.channels, precision=np.zeros(600))
    evidence = locate(type(base)(missing, [missing.calibration]), [[(0, 0)]], [], 1.0).evidence
    assert np.isnan(evidence["common_mode_chi_square"])
    assert_allclose(evidence["differential_chi_square"], np.mean(base.channels.differential**2))


@pytest.mark.parametrize(("part", "is_told"), [(0.5, True), (0.9, False)])
def test_a_span_of_most_of_the_run_says_nothing(run, part, is_told):
    """Half of it does, of which nine tenths are told; nine tenths of it do not."""
    channels = run(300).channels()
    excess = (np.abs(np.arange(300) - 150) < 150 * part).astype(float)
    assert (span_of(channels, excess) is not None) == is_told


@pytest.mark.parametrize(("other", "place"), [(0.6, None), (0.27, (1, 1))])
def test_an_axis_makes_nearly_all_of_what_is_told_for_it(run, other, place):
    """Beside another with a fourteenth of its energy it stands alone, beside one with a third it does not."""
    made = run(700)
    drift = 8e-9 * np.sin(0.35 * made.recording.time_s)
    base = made.with_row(4, drift).with_row(9, other * drift).model().base()
    found = main_places(base, examine(base, FunctionOfTime()))
    assert found == [place] if place else {sensor for sensor, _ in found} == {1, 3}


@pytest.mark.parametrize(("part", "is_told"), [(0.54, True), (0.57, False)])
def test_a_span_holds_nine_tenths_of_the_excess_in_less_than_half_of_the_run(part, is_told):
    """Of an excess that is even over the first part of a run a twentieth is left out at either end."""
    time_s = np.linspace(0, 100, 10_001)
    channels = SimpleNamespace(covariates=SimpleNamespace(time_s=time_s))
    span = span_of(channels, np.where(time_s <= 100 * part, 1.0, 0.0))
    assert (span is not None) == is_told
    if is_told:
        assert span == pytest.approx((5 * part, 95 * part), abs=0.02)


@pytest.mark.parametrize(
    ("parts", "low_hz", "high_hz"),
    [({2: 0.85, 8: 0.15}, 2, 8), ({2: 0.97, 8: 0.03}, 2, 2), ({2: 0.03, 8: 0.97}, 8, 8), ({50: 1.0}, 50, 50)],
)
def test_the_band_holds_nine_tenths_of_the_energy(parts, low_hz, high_hz):
    """Less a twentieth at either end, up to half the sampling rate."""
    time_s = np.arange(1000) / 100
    series = sum(
        np.sqrt(part) * np.cos(2 * np.pi * hz * time_s) * (1 if hz < 50 else 0.5) for hz, part in parts.items()
    )
    residuals = SimpleNamespace(row_shift_T=100 * series[:, None], row_information=np.ones((1000, 1)))
    covariates = SimpleNamespace(sample_count=1000, step_s=0.01)
    band = band_of(SimpleNamespace(residuals=residuals, covariates=covariates), 0, 1.0)
    assert band == pytest.approx((low_hz, high_hz))
