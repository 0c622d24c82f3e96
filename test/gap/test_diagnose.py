"""What a diagnosis makes of recordings that are short, poor, broken or not of the array."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.effects.library import installed_effects
from tam_calibration.fit import calibrate
from tam_calibration.gap import diagnose
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording


@pytest.mark.parametrize(
    ("samples", "sensors", "needed"), [(1, 4, 24), (5, 4, 24), (23, 4, 24), (20, 2, 24), (40, 1, 69), (5, 30, 24)]
)
@pytest.mark.parametrize("has_scalar", [True, False])
def test_too_few_samples_have_no_verdict(run, samples, sensors, needed, has_scalar):
    """It is said how many there must be, of every effect, and no figure is made up."""
    made = run(samples, sensors, has_scalar)
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "not_identifiable" and gap.causes == ()
    assert f"it takes {needed} samples at least" in gap.statement
    assert {one.effect for one in gap.considered} == set(installed_effects())
    assert {one.status for one in gap.considered} == {"not_identifiable"}
    assert np.isnan(gap.size.before) and gap.next_recording
    assert gap.residue.before.shape == (samples, 3 * sensors + 1)


@pytest.mark.parametrize(("samples", "has_scalar"), [(24, False), (59, True)])
def test_a_short_clean_recording_has_no_gap(run, samples, has_scalar):
    """As soon as there is a verdict it is right, with fewer samples than blocks of the folds too."""
    made = run(samples, has_scalar=has_scalar)
    assert diagnose(made.recording, made.array).verdict == "no_gap"


def test_another_array_is_refused(run):
    """The number of sensors must be that of the array."""
    with pytest.raises(InputError, match="the recording has 4 sensors, the array 2: use the array file"):
        diagnose(run(30).recording, Array(np.zeros((2, 3))))


@pytest.mark.parametrize(
    ("factor", "hint"), [(1e6, "is this µT given as T"), (1e9, "nT given as T"), (1e4, "gauss given as T")]
)
def test_another_unit_is_refused(run, factor, hint):
    """The sentence guesses the unit."""
    recording = run(30).recording
    with pytest.raises(InputError, match=hint):
        diagnose(replace(recording, readings_T=factor * recording.readings_T), run(30).array)


@pytest.mark.parametrize(("sensor", "axes", "where"), [(2, [1], "sensor 3 axis y"), (1, [0, 1, 2], "sensor 2")])
def test_a_stuck_axis_is_refused(run, sensor, axes, where):
    """An axis that reads one value would be a scale factor of zero: it is named."""
    made = run(200)
    readings = made.recording.readings_T.copy()
    readings[:, sensor, axes] = 30e-6
    with pytest.raises(Refused, match=f"{where} reads the same value.* throughout"):
        diagnose(replace(made.recording, readings_T=readings), made.array)


def test_constant_readings_are_refused(run):
    """All axes that read one value each."""
    made = run(100)
    readings = np.repeat(made.recording.readings_T[:1], 100, axis=0)
    with pytest.raises(InputError, match="not connected, or was not turned"):
        diagnose(replace(made.recording, readings_T=readings), made.array)


@pytest.mark.parametrize("kind", ["all", "all but one", "second half"])
def test_holes_of_the_scalar_are_no_gap(run, kind):
    """Where there is no reference the sensors are compared with each other; nothing is warned of."""
    made = run(200)
    hole = {
        "all": np.ones(200, dtype=bool),
        "all but one": np.arange(200) != 7,
        "second half": np.arange(200) > 100,
    }[kind]
    recording = replace(made.recording, scalar_T=np.where(hole, np.nan, made.recording.scalar_T))
    gap = diagnose(recording, made.array)
    assert gap.verdict == "no_gap"
    missing = {one.effect for one in gap.considered if one.status == "channel_missing"}
    assert ("scalar_heading_error" in missing) == (kind == "all")


@pytest.mark.parametrize("left", [1, 100])
def test_holes_of_channels_are_no_gap(run, left):
    """Temperature, current and attitude with one value each, or every second."""
    made, channels = run(200), {}
    for channel in ("temperature_C", "current_A", "attitude"):
        channels[channel] = getattr(made.recording, channel).copy()
        channels[channel][np.arange(200) % (200 // left) != 0] = np.nan
    assert diagnose(replace(made.recording, **channels), made.array).verdict == "no_gap"


def test_holes_in_time_are_no_gap(run):
    """A pause of half a minute, samples lost by chance, and steps of time that are never the same."""
    made, kept = run(500), np.random.default_rng(1).random(500) < 0.6
    kept[150:350] = False
    assert diagnose(made.recording.take(kept), made.array).verdict == "no_gap"


def test_a_noise_that_is_not_stated_is_estimated(run):
    """Of the sensors, the scalar, or both."""
    made = run(100)
    positions, vector, scalar = made.array.positions_m, made.array.vector_noise_T, made.array.scalar_noise_T
    for array in (Array(positions), Array(positions, vector), Array(positions, None, scalar)):
        gap = diagnose(made.recording, array)
        assert gap.verdict == "no_gap"
        assert gap.size.floor_T == pytest.approx(1e-9, rel=0.1)


def test_a_drift_of_one_of_twelve_sensors_is_found(run):
    """In a recording of twice as many samples as sensors."""
    made = run(24, 12)
    made = made.with_row(28, 8e-9 * (made.recording.temperature_C - 20))
    without = set(installed_effects()) - {"temperature_drift"}
    (cause,) = diagnose(made.recording, made.array, without=without).causes
    assert (cause.fitted.effect, cause.sensors, cause.axes) == ("temperature_drift", (10,), ("y",))


@pytest.mark.parametrize("poses", [4, 24])
def test_poses_are_no_gap(run, poses):
    """An array that rests in few attitudes for long, as on a turntable."""
    made = run(240, noise_T=1e-30)
    index = np.linspace(0, 239, poses).astype(int).repeat(120 // poses)
    readings = made.recording.readings_T[index] + 1e-9 * np.random.default_rng(1).normal(size=(120, 4, 3))
    recording = replace(made.recording.take(slice(120)), readings_T=readings, attitude=made.recording.attitude[index])
    array = replace(made.array, vector_noise_T=np.full(4, 1e-9))
    assert diagnose(recording, array).verdict == "no_gap"


def test_an_array_at_rest_has_no_cause(run):
    """Noise about one attitude."""
    made = run(480, noise_T=1e-30)
    index = np.zeros(480, dtype=int)
    array = replace(made.array, vector_noise_T=np.full(4, 1e-9))
    for seed in range(2):
        readings = made.recording.readings_T[index] + 1e-9 * np.random.default_rng(seed).normal(size=(480, 4, 3))
        recording = replace(made.recording, readings_T=readings, attitude=made.recording.attitude[index])
        assert diagnose(recording, array).verdict in ("no_gap", "not_identifiable")


@pytest.mark.parametrize("damage", ["few", "plane", "still"])
def test_what_a_calibration_would_refuse_is_told_first(run, damage):
    """The sentence of the calibration, in front of all others; without a verdict the time is told too."""
    made = run(15 if damage == "few" else 300, 1 if damage == "few" else 2, has_scalar=False)
    recording = replace(made.recording, attitude=None)
    if damage == "few":
        recording = recording.take(slice(0, 8))
    else:
        angle = np.linspace(0, 20, 300) * (damage == "plane")
        field = 45e-6 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(300)])
        noise_T = 1e-9 * np.random.default_rng(0).normal(size=(300, 2, 3))
        recording = replace(recording, readings_T=made.errors.distort(field) + noise_T)
    with pytest.raises(InputError) as refusal:
        calibrate(recording, made.array)
    gap = diagnose(recording, made.array)
    assert gap.remarks[0] == f"tam calibrate would refuse this recording: {refusal.value}."
    if damage != "plane":
        first, last = recording.time_span_s
        assert gap.statement.startswith(f"No verdict on the recording of {last - first:.1f} s: ")


def test_single_readings_that_repeat_are_told_as_the_calibration_takes_them(run):
    """Readings that stick for a while cost a calibration these readings alone: no remark says that it is refused."""
    made = run(600)
    readings_T = made.recording.readings_T.copy()
    for start in (100, 300, 450):
        readings_T[start : start + 12, 2] = readings_T[start, 2]
    recording = replace(made.recording, readings_T=readings_T)
    calibration = calibrate(recording, made.array)
    (left_out,) = (note for note in calibration.notes if "are left out" in note)
    remarks = diagnose(recording, made.array).remarks
    assert remarks[0] == f"tam calibrate leaves out single readings: {left_out}."
    assert not any("refuse" in remark for remark in remarks)


def test_what_came_near_for_a_while_is_told_first(run):
    """When the residual is large, as a calibration warns, where no cause explains it."""
    made = run(600)
    time_s = made.recording.time_s
    nearness = 1 / (1 + ((time_s - time_s[400]) / (0.05 * time_s[-1])) ** 2) ** 1.5
    passed_T = np.outer(nearness, [90e-9, -40e-9, 70e-9])[:, None] * np.array([1.0, 0.7, 0.5, 0.8])[:, None]
    recording = replace(made.recording, readings_T=made.recording.readings_T + passed_T)
    (doubt,) = (one for one in calibrate(recording, made.array).warnings if "something magnetic came near" in one)
    gap = diagnose(recording, made.array)
    assert gap.remarks[0] == f"tam calibrate would doubt this recording: {doubt}."


def test_a_scalar_that_follows_the_direction_is_told(run):
    """A magnet beside it looks like biases of all sensors, which leave no gap."""
    made = run(600)
    made = made.with_row(made.row_count - 1, 50e-9 * made.recording.readings_T[:, 0, 0] / 5e-5)
    (doubt,) = (one for one in calibrate(made.recording, made.array).warnings if "the scalar follows" in one)
    gap = diagnose(made.recording, made.array)
    assert (gap.verdict, gap.remarks[0]) == ("no_gap", f"tam calibrate would doubt this recording: {doubt}.")


def test_one_absurd_reading_is_no_other_cause(run):
    """A sample of one tesla in all sensors breaks nothing."""
    made = run(400)
    readings = made.recording.readings_T.copy()
    readings[100] = 1.0
    gap = diagnose(replace(made.recording, readings_T=readings), made.array)
    assert {cause.fitted.effect for cause in gap.causes} <= {"outliers"}


def test_an_attitude_of_zeros_is_refused(run):
    """Messages without attitude hold four zeros."""
    with pytest.raises(InputError, match="30 of 30 attitudes are four zeros, first in sample 1"):
        replace(run(30).recording, attitude=np.zeros((30, 4)))


def test_a_left_handed_sensor_is_refused(run):
    """An axis of the wrong sign is named with its sensor and whom it contradicts, as a calibration names it."""
    made = run(400)
    sign = np.where(np.arange(12).reshape(4, 3) == 4, -1, 1)
    with pytest.raises(Refused, match=r"sensor 2 is left-handed .* against sensor 1 and .* axis y is reversed"):
        diagnose(replace(made.recording, readings_T=made.recording.readings_T * sign), made.array)


def test_a_tone_near_half_the_sample_rate_is_diagnosed(true_errors, cross):
    """It looks as if two publishers sent in turn, which refuses a calibration; the diagnosis names the law anyway."""
    time_s, rng = np.arange(600) / 20, np.random.default_rng(6)
    angles = np.stack([time_s / 20, 1.2 * np.sin(time_s / 10), 1.5 * np.sin(time_s / 14)], axis=1)
    field_T = Rotation.from_euler("zyx", angles).apply([20e-6, 0, 45e-6], inverse=True)
    readings_T = true_errors.distort(field_T) + 1e-9 * rng.normal(size=(600, 4, 3))
    readings_T[:, 2, 0] += 400e-9 * np.cos(2 * np.pi * 9.0 * time_s)
    recording = Recording(time_s, readings_T, np.full(600, np.linalg.norm(field_T[0])))
    with pytest.raises(Refused, match="alternate between two courses"):
        calibrate(recording, cross)
    gap = diagnose(recording, cross)
    assert (gap.signature[0].law, gap.signature[0].course, gap.signature[0].sensors) == ("offset", "tone", (3,))
