"""A gap is found in the sensor, axis, time and band in which it was planted; its causes have their numbers."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.effect import Finding
from tam_calibration.gap import diagnose
from tam_calibration.gap.causes import (
    _moved,
    _places,
    considered,
    is_drift,
    locate,
    numbered_causes,
    sensors_and_axes,
    span_of,
)
from tam_calibration.gap.laws.law import Signature
from tam_calibration.gap.laws.signature import Law
from tam_calibration.gap.size import Evidence
from tam_calibration.gap.steps import Step
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect

EVERY = (1, 2, 3, 4)
TONE = Law(Signature("offset", "tone", (2,), ("y",), 0.9, ((2,),), "3.5 Hz", (), 50.0), 0.5)
SLOW = Law(Signature("offset", "slow", (3,), ("z",), 0.1, ((3,),), None, (), 20.0), 0.1)


def at(sensors, axes):
    """Return what a place needs of a cause."""
    return SimpleNamespace(sensors=sensors, axes=tuple(axes))


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


def test_where_with_causes_is_theirs(run):
    """The places of all causes together."""
    where = locate(run(300).model().base().channels, [at((1,), "y"), at((3,), "xy")], [TONE], 1.0)
    assert (where.sensors, where.axes) == ((1, 3), ("x", "y"))


def test_where_without_causes_is_the_place_of_the_strongest_law(run):
    """With the band that the recording resolves about its tone, and none of another course or without a law."""
    channels = run(300).model().base().channels
    where = locate(channels, [], [TONE, SLOW], 1.0)
    assert (where.sensors, where.axes) == ((2,), ("y",))
    width = 1 / np.ptp(channels.covariates.time_s)
    assert where.frequency_hz == pytest.approx((3.5 - width, 3.5 + width))
    assert locate(channels, [], [SLOW, TONE], 1.0).frequency_hz is None
    assert locate(channels, [], [], 1.0).sensors == ()


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


def test_evidence_tells_the_two_kinds_of_channels_apart(run):
    """A scalar that is off shows in the common mode only; without one there is none to tell of."""
    made = run(600)
    base = made.with_row(12, 5e-9 * np.sin(0.4 * made.recording.time_s)).model().base()
    evidence = locate(base.channels, [], [TONE], 1.0).evidence
    assert evidence["differential_chi_square"] == pytest.approx(1, abs=0.1)
    assert evidence["common_mode_chi_square"] > 5
    missing = replace(base.channels, precision=np.zeros(600))
    evidence = locate(missing, [], [TONE], 1.0).evidence
    assert np.isnan(evidence["common_mode_chi_square"])
    assert_allclose(evidence["differential_chi_square"], np.mean(base.channels.differential**2))


@pytest.mark.parametrize(("part", "is_told"), [(0.5, True), (0.9, False)])
def test_a_span_of_most_of_the_run_says_nothing(run, part, is_told):
    """Half of it does, of which nine tenths are told; nine tenths of it do not."""
    channels = run(300).channels()
    excess = (np.abs(np.arange(300) - 150) < 150 * part).astype(float)
    assert (span_of(channels, excess) is not None) == is_told


@pytest.mark.parametrize(("part", "is_told"), [(0.54, True), (0.57, False)])
def test_a_span_holds_nine_tenths_of_the_excess_in_less_than_half_of_the_run(part, is_told):
    """Of an excess that is even over the first part of a run a twentieth is left out at either end."""
    time_s = np.linspace(0, 100, 10_001)
    channels = SimpleNamespace(covariates=SimpleNamespace(time_s=time_s))
    span = span_of(channels, np.where(time_s <= 100 * part, 1.0, 0.0))
    assert (span is not None) == is_told
    if is_told:
        assert span == pytest.approx((5 * part, 95 * part), abs=0.02)


@dataclass(frozen=True)
class OfScalar:
    """A cause in the scalar."""

    fitted: SimpleNamespace
    sensors: tuple = ("scalar",)
    axes: tuple = ()


def test_a_cause_of_the_scalar_moves_to_the_field_where_it_may_act_there():
    """A field that drifts does, an error of the scalar's heading does not."""
    common = Signature("offset", "slow", EVERY, (), 0.9, (EVERY, ("scalar",)), None, (), 50.0)
    drift, heading = (OfScalar(SimpleNamespace(effect=one)) for one in ("geomagnetic_drift", "scalar_heading_error"))
    assert _moved(drift, [common], ("scalar",)).sensors == EVERY
    assert _moved(heading, [common], ("scalar",)).sensors == ("scalar",)


@pytest.mark.parametrize("other", [3, 6])
def test_leakage_from_another_sensor_may_be_a_gain(run, other):
    """All sensors read one field: leakage from the same axis of another is a gain, that from another axis is none."""
    made = run(300)
    windows = np.sin(0.7 * made.recording.time_s) > 0.4
    leaking = made.with_row(0, 3e-4 * windows * made.recording.readings_T.reshape(-1, 12)[:, other + (other == 6)])
    (cause,) = diagnose(leaking.recording, leaking.array).causes
    names = {cause.fitted.effect, *cause.indistinguishable_from}
    assert ({"gain_switching", "crosstalk"} <= names) == (other == 3) and "crosstalk" in names


@pytest.mark.parametrize(("gain", "is_leakage"), [(3e-4, True), (0.03, False)])
def test_a_large_gain_is_no_leakage(run, gain, is_leakage):
    """Sensors that are turned against each other by a degree do not read the same: a hundredth of 130 floors shows."""
    made = run(300, seed=2)
    windows = np.sin(0.7 * made.recording.time_s) > 0.4
    amplified = made.with_row(4, gain * windows * made.recording.readings_T[:, 1, 1])
    (cause,) = diagnose(amplified.recording, amplified.array).causes
    assert cause.fitted.effect == "gain_switching"
    assert ("crosstalk" in cause.indistinguishable_from) == is_leakage


@pytest.mark.parametrize(("course", "is_one"), [(np.linspace(18, 26, 300), True), (20 + np.sin(np.arange(300)), False)])
def test_a_channel_that_only_rises_is_a_drift(run, course, is_one):
    """Any other slow course explains as much as it."""
    recording = replace(run(300).recording, temperature_C=course)
    assert is_drift("temperature_drift", recording) == is_one
    assert not is_drift("bias_jump", recording)


@pytest.mark.parametrize(("part", "sensors"), [(0.09, {1}), (0.11, {1, 2})])
def test_a_sensor_has_an_effect_from_a_tenth_of_the_largest_on(run, part, sensors):
    """Less is what the common field carries over from the other."""
    parts = tuple(
        Contribution(sensor, axis, "offset", {"offset": size})
        for sensor, size in ((1, 1e-9), (2, part * 1e-9))
        for axis in range(3)
    )
    fitted = FittedEffect("temperature_drift", {"time_constant_s": 0.0, "reference_C": 20.0}, parts)
    assert {sensor for sensor, _ in _places(fitted, run(60).channels().covariates)} == sensors


@pytest.mark.parametrize(("evidence", "why"), [(11.9, "noise alone"), (12.1, "it leaves a part of the law")])
def test_why_an_effect_is_no_cause_is_told(evidence, why):
    """Odds of 400 to one in white noise, or less."""
    weighed = tuple(SimpleNamespace(effect=name, delta_bic=evidence) for name in ("bias_jump", "flexure"))
    cause = SimpleNamespace(fitted=FittedEffect("bias_jump", {}, ()), delta_bic=90.0, r2_cv=0.8)
    named, one = considered(SimpleNamespace(considered=(), weighed=weighed), (cause,))
    assert (named.status, named.delta_bic, named.r2_cv) == ("supported", 90.0, 0.8)
    assert (one.status, one.delta_bic) == ("not_supported", evidence) and one.why.startswith(why)


def test_what_is_found_twice_is_one_cause_with_the_evidence_of_the_first(run):
    """Spikes that another step has taken up beside: their energies add up, and the share is of what closes."""
    fitted = FittedEffect("outliers", {}, (Contribution(1, 0, "offset", {"count": 5.0}),))
    findings = [Finding(fitted, gain, 1, flagged=np.arange(60) == at) for at, gain in ((3, 300.0), (9, 100.0))]
    law = Signature("samples", "random", (2,), ("x",), 1.0, ((2,),), None, (), 300.0)
    steps = tuple(Step(Evidence("outliers", one, one.gain - 10, one.gain), law) for one in findings)
    model = replace(run(60).model(), findings=tuple(findings))
    found = SimpleNamespace(steps=steps, nominal=model, considered=())
    (cause,) = numbered_causes(found, model, SimpleNamespace(closed=0.8), {"outliers": 0.9})
    assert (cause.delta_bic, cause.probability, cause.sensors) == (290.0, 0.9, (2,))
    assert (cause.share, cause.r2_cv) == (pytest.approx(1.0), pytest.approx(0.8))
