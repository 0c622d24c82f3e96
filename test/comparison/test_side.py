"""What the judge says of a side, and plain figures of recordings whose stamps and steps are known."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from tam_calibration import read_scenario
from tam_calibration.comparison import side as side_module
from tam_calibration.comparison.compare import side_of
from tam_calibration.comparison.side import Figure, side_by_side
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.sensor_errors import PARAMETER_NAMES


@pytest.fixture(scope="session")
def with_stamps(side):
    """Return a function that gives the side of a run with other stamps."""

    def make(time_s, kept=None):
        own = side(1)
        kept = np.ones(own.recording.sample_count, dtype=bool) if kept is None else kept
        recording = replace(own.recording, time_s=time_s).take(kept)
        return replace(own, recording=recording)

    return make


@cache
def figures_of(side):
    """Return the figures of a side."""
    return [one.recording for one in side_by_side(side, side)]


def figure(side, group, name):
    """Return one figure of a side."""
    (found,) = [one for one in figures_of(side) if (one.group, one.name) == (group, name)]
    return found


def standing(one, other, group, name):
    """Return how one figure stands in two sides."""
    return Figure(figure(one, group, name), figure(other, group, name)).standing


def even(side, rate_hz):
    """Return the stamps of a side at an even rate."""
    return np.arange(side.recording.sample_count) / rate_hz


def test_stamps_tell_rate_jitter_and_loss(side, with_stamps):
    """Stamps with normal errors of 0.2 ms have intervals with √2 times that; lost samples are counted."""
    generator = np.random.default_rng(0)
    count = side(1).recording.sample_count
    time_s = even(side(1), 50.0) + generator.normal(0, 2e-4, count)
    kept = np.ones(count, dtype=bool)
    kept[100:150] = kept[400] = kept[500:504] = False
    made = with_stamps(time_s, kept)
    rate, jitter, lost = (figure(made, "stamps", name) for name in ("rate", "jitter", "part lost"))
    assert rate.value == pytest.approx(50.0, abs=3 * rate.standard_error) and rate.standard_error < 0.05
    assert jitter.value == pytest.approx(np.sqrt(2) * 2e-4, abs=3 * jitter.standard_error)
    assert jitter.standard_error < 0.05 * jitter.value
    assert lost.value == pytest.approx(55 / count)


def test_even_stamps_have_neither_jitter_nor_loss(side, with_stamps):
    """An interval is a hole from one and a half of the median."""
    made = with_stamps(even(side(1), 100.0))
    assert figure(made, "stamps", "jitter").value == pytest.approx(0, abs=1e-12)
    assert figure(made, "stamps", "part lost").value == 0
    count = made.recording.sample_count
    for late, is_hole in ((0.49, False), (0.51, True)):
        time_s = even(side(1), 100.0) + late / 100.0 * (np.arange(count) >= 500)
        assert (figure(with_stamps(time_s), "stamps", "part lost").value > 0) == is_hole


def test_the_largest_reading_and_coverage_are_of_the_path(side):
    """They are stated, and never differ: a part of the run sees less of the sphere."""
    own = side(1)
    part = replace(own, recording=own.recording.take(slice(0, 100)))
    largest = figure(own, "sensor 3", "largest reading")
    assert largest.value == np.abs(own.recording.readings_T[:, 2]).max() and not largest.is_of_simulation
    assert figure(own, "path", "part of the sphere").value > 1.5 * figure(part, "path", "part of the sphere").value
    assert standing(own, part, "path", "part of the sphere") == "same"


def test_a_scalar_that_is_missing_differs(side):
    """Its presence differs, its rate cannot be told; a scalar of half the rate is told."""
    own = side(1)
    without = replace(own, recording=replace(own.recording, scalar_T=None))
    assert standing(own, without, "scalar", "present") == "differs"
    assert standing(own, without, "scalar", "rate") == "cannot tell"
    half = own.recording.scalar_T.copy()
    half[::2] = np.nan
    slower = replace(own, recording=replace(own.recording, scalar_T=half))
    assert figure(slower, "scalar", "rate").value == pytest.approx(figure(own, "scalar", "rate").value / 2)
    assert standing(own, slower, "scalar", "rate") == "differs"


def test_figures_differ_beyond_tolerance_and_chance(side, with_stamps):
    """Rates and jitters within one per cent are the same, and what is within 4.5 standard errors."""
    one = with_stamps(even(side(1), 100.0))
    for rate, expected in ((100.9, "same"), (101.2, "differs")):
        assert standing(one, with_stamps(even(side(1), rate)), "stamps", "rate") == expected
    generator = np.random.default_rng(1)
    unit = generator.normal(size=one.recording.sample_count)
    for jitter_s, expected in ((5e-5, "same"), (2e-4, "differs")):
        other = with_stamps(even(side(1), 100.0) + jitter_s * unit)
        assert standing(one, other, "stamps", "jitter") == expected
    lost = Figure(*2 * [figure(one, "stamps", "part lost")])
    assert lost.standing == "same" and lost.standard_errors != lost.standard_errors


def test_the_limits_of_the_same():
    """As they are stated."""
    limits = side_module.LEAST_HOLE, side_module.CERTAIN, side_module.NEGLIGIBLE
    assert limits == (1.5, 4.5, 0.01)


def test_two_runs_of_one_simulator_do_not_differ(side):
    """Other seeds change no figure of the simulation."""
    assert {figure.standing for figure in side_by_side(side(1), side(2))} <= {"same", "cannot tell"}


def test_errors_of_the_sensors_stand_with_their_standard_errors(side):
    """Twelve of each sensor, in SI, the truth within 4.5 of their standard errors."""
    truth = read_scenario("tumble_100_hz").errors.to_vector().ravel()
    found = [one for one in figures_of(side(1)) if one.name in PARAMETER_NAMES]
    assert len(found) == len(truth) == 48
    near = [abs(one.value - value) <= 4.5 * one.standard_error for one, value in zip(found, truth, strict=True)]
    assert sum(near) == 48


def test_a_sensor_that_is_late_is_told_with_its_delay(side):
    """Readings of sensor 3 that are 2 ms old: the delay is told to microseconds, and that of the others as none."""
    own = side(1)
    readings_T = own.recording.readings_T.copy()
    path = CubicSpline(own.recording.time_s, readings_T[:, 2])
    readings_T[:, 2] = path(own.recording.time_s - 0.002)
    late = replace(own, recording=replace(own.recording, readings_T=readings_T))
    found = {one.name: one for one in figures_of(late)}
    for sensor, delay_s in ((2, 0.0), (3, 0.002), (4, 0.0)):
        one = found[f"delay of sensor {sensor}"]
        assert one.value == pytest.approx(delay_s, abs=4.5 * one.standard_error) and 0 < one.standard_error < 2e-5
    assert standing(own, late, "stamps", "delay of sensor 3") == "differs"


def test_without_motion_no_delay_is_told(side):
    """Poses in no order tell none: NaN, and no failure."""
    own = side(1)
    mixed = own.recording.readings_T[np.random.default_rng(4).permutation(own.recording.sample_count)]
    jumping = replace(own, recording=replace(own.recording, readings_T=mixed))
    (found,) = [one for one in figures_of(jumping) if one.name == "delay of sensor 2"]
    assert np.isnan(found.value)


def test_the_noise_of_every_axis_and_of_the_scalar_is_found(side, sheet):
    """A run without effects has white noise of the level that was simulated."""
    *axes, scalar = side(1).gap.noise
    assert [(one.sensor, one.axis) for one in axes] == [(k, axis) for k in (1, 2, 3, 4) for axis in "xyz"]
    assert [one.level_T for one in axes] == pytest.approx([sheet] * 12, rel=0.1)
    assert {one.colour for one in axes} == {"white"}
    assert (scalar.sensor, scalar.colour) == (0, "white") and scalar.level_T == pytest.approx(1e-10, rel=0.1)


def test_what_effects_add_is_no_noise(side, sheet):
    """A drift that the diagnosis names is taken off before the noise is measured."""
    found = side(1, 3)
    assert [cause.fitted.effect for cause in found.gap.causes] == ["temperature_drift"]
    assert [one.level_T for one in found.gap.noise[:-1]] == pytest.approx([sheet] * 12, rel=0.1)


def test_a_run_that_determines_no_calibration_is_refused(run, cross):
    """A few samples tell nothing: the refusal says so."""
    with pytest.raises(Refused):
        side_of(run(1).take(slice(0, 20)), cross)
