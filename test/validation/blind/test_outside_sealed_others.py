"""The sealed half of the outside causes. Who writes rules of the diagnosis does not open this file."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.validation.blind.disturbance import MOVING
from tam_calibration.validation.blind.outside_sealed_others import SEALED, _pulled, _smoothed
from tam_calibration.validation.blind.outside_sealed_others_whole import _diffused, _run_down, _since, lagged


def test_what_follows_the_rate_is_drawn_in_motion_only():
    """A turntable, which stands still while a sample is taken, shows no rate."""
    names = ("counted_cycles", "speed_filter", "elevator_servo", "image_stabiliser")
    assert all(SEALED[name].motions == MOVING for name in names)


def test_a_deviation_turns_about_the_mast(change_of):
    """It lies across the mast and the field."""
    scene, cause, change = change_of("deviation_table", 1)
    core = scene.core(cause.sensors[0] - 1)
    assert_allclose(np.sum(change * core, axis=1), 0, atol=1e-22)
    assert_allclose(change @ np.array(cause.parameters["mast"]), 0, atol=1e-14)


def test_a_length_is_controlled_along_the_raw_reading(change_of):
    """Long readings get shorter and short ones longer."""
    scene, cause, change = change_of("length_control", 1)
    raw = scene.readings_T[:, cause.sensors[0] - 1]
    assert_allclose(np.cross(change, raw / np.linalg.norm(raw[0])), 0, atol=1e-22)
    assert np.corrcoef((change * raw).sum(axis=1), np.linalg.norm(raw, axis=1))[0, 1] < -0.3


def test_the_first_count_is_late_by_half_of_its_own(change_of):
    """The error of the axis that is counted first is minus its delay times its rate."""
    scene, cause, change = change_of("counted_cycles", 1, 1e-4)
    sensor, first = cause.sensors[0] - 1, cause.parameters["order"][0]
    late, ahead = (scene.readings_at(scene.time_s + shift_s)[:, sensor, first] for shift_s in (-1e-3, 1e-3))
    expected = scene.core(sensor)[:, first] / 2 * 1e-4 * (ahead - late) / 2e-3
    assert abs(np.corrcoef(change[:, first], expected)[0, 1]) == pytest.approx(1, abs=1e-6)
    assert np.std(change[:, first]) == pytest.approx(np.std(expected), rel=1e-3)


def test_what_is_kept_fades():
    """Each value keeps its own part of the one before."""
    kept = np.array([[0.5, 0, 1], [0.5, 0, 1], [0.25, 0, 1]])
    path = _smoothed(np.array([[0.0, 0, 0], [4, 4, 4], [4, 4, 4]]), kept)
    assert_allclose(path, [[0, 0, 0], [2, 4, 0], [3.5, 4, 0]])


def test_a_fast_axis_is_smoothed_less_than_one_delay_makes(change_of):
    """The error over the rate is smaller where the rate is large."""
    scene, cause, change = change_of("speed_filter", 1, 1e-4)
    rate = np.abs(np.diff(scene.readings_T[:, cause.sensors[0] - 1], axis=0))
    late = np.abs(change[1:]) / np.maximum(rate, 1e-15)
    fast = rate > np.quantile(rate, 0.8, axis=0)
    slow = rate < np.quantile(rate, 0.2, axis=0)
    assert np.median(late[fast]) < 0.5 * np.median(late[slow])


def test_two_oscillators_lock_or_beat():
    """Within the pull the phase rests where the sine makes up for the difference; beyond it runs by Adler's law."""
    locked = _pulled(np.full(5000, 0.005), 0.01, 0.0)
    assert_allclose(np.sin(locked[-1]), 0.5, rtol=1e-6)
    beating = _pulled(np.full(200_000, 0.02), 0.01, 0.0)
    assert beating[-1] / 200_000 == pytest.approx((0.02**2 - 0.01**2) ** 0.5, rel=1e-2)


def test_aliased_mains_stand_in_the_room(change_of):
    """Turned back into the room they are an ellipse of one frequency."""
    scene, cause, change = change_of("unfiltered_mains", 1)
    room = np.einsum("nij,nj->ni", scene.to_world, change @ np.linalg.inv(scene.response[cause.sensors[0] - 1]).T)
    phase = 2 * np.pi * cause.parameters["alias_hz"] * scene.time_s
    wave = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    assert_allclose(wave @ np.linalg.lstsq(wave, room, rcond=None)[0], room, atol=1e-15)


def test_a_radio_sends_in_steps_of_a_decibel(change_of):
    """All powers are whole decibels apart."""
    _, _, change = change_of("transmit_power", 1)
    size = np.linalg.norm(change, axis=1)
    steps_dB = 10 * np.log10(size / size.min())
    assert_allclose(steps_dB, np.round(steps_dB), atol=1e-9)
    assert len(np.unique(np.round(steps_dB))) > 4


def test_a_slip_ring_drops_the_same_at_the_same_angle(change_of):
    """The gain error comes again after a turn."""
    scene, cause, change = change_of("slip_ring", 1, samples=1500)
    gain = (change / scene.core(cause.sensors[0] - 1))[:, 0]
    angle = scene.motion.angles(scene.time_s)[:, 0] % (2 * np.pi)
    order = np.argsort(angle)
    assert np.std(np.diff(gain[order])) < 0.05 * np.std(gain)


def test_degaussing_goes_by_steps(change_of):
    """What its two coils' fields follow has few levels."""
    _, cause, change = change_of("degaussing_steps", 1)
    assert np.linalg.matrix_rank(change / 1e-9, tol=1e-9) == 2
    keep = np.exp(-1 / cause.parameters["memory_samples"])
    asked = (change[1:] - keep * change[:-1]) / (1 - keep)
    assert 4 < len(np.unique(np.round(asked / 1e-15), axis=0)) <= (2 * cause.parameters["steps"] + 1) ** 2


def test_a_couple_is_strong_when_it_is_dipped(change_of):
    """The time is counted from each dip, and the current then falls by Cottrell's law."""
    assert_array_equal(_since(np.array([0.0, 1, 1, 1, 0, 1])), [0, 0, 1, 2, 0, 0])
    _, cause, change = change_of("dipped_couple", 1)
    size = np.linalg.norm(change, axis=1)
    assert np.sum((size[1:] > 0) & (size[:-1] == 0)) == cause.parameters["dips"] >= 6
    assert_allclose(size[1:][(size[1:] > 0) & (size[:-1] == 0)], 1e-9)


def test_what_follows_settles():
    """A step is followed to a part of 1 − 1/e within the memory."""
    path = lagged(np.r_[0.0, np.ones(40)], 5.0)
    assert path[0] == 0 and path[5] == pytest.approx(1 - np.exp(-1)) and path[-1] > 0.999


def test_a_gimbal_keeps_its_field_of_a_size(change_of):
    """A dipole at one distance has from once to twice its least field, whatever way it turns."""
    _, _, change = change_of("gimbal_magnet", 1)
    size = np.linalg.norm(change, axis=1)
    assert size.min() >= 0.9999e-9 and size.max() <= 2.0001e-9


def test_sand_rests_and_runs_down():
    """It lies still within the steepest slope, and beyond it comes to the flatter one."""
    tilts = np.array([0.0, 0.3, 0.7, 0.8])
    lies = _run_down(np.stack([np.sin(tilts), 0 * tilts, np.cos(tilts)], axis=1), 0.6, 0.2)
    assert_allclose(np.arctan2(lies[:, 0], lies[:, 2]), [0, 0, 0.5, 0.5])


def test_a_servo_stops_at_its_stops(draw):
    """Its field in the ship does not go beyond what the largest angle makes."""
    scene = draw(1, motions=("diver",))
    cause = SEALED["elevator_servo"].draw(np.random.default_rng(1), scene)
    _, scalar = cause.change(1.0, (scene.readings_T, scene.intensity_T))
    assert cause.sensors == ("scalar",) and np.abs(scalar).max() < 1e-9 * (np.sin(0.9) + 1 - np.cos(0.9))


def test_a_lens_rests_at_its_stops(change_of):
    """Two motions make the field, and a part of the samples is at a stop of either."""
    _, _, change = change_of("image_stabiliser", 1)
    assert np.linalg.matrix_rank(change / 1e-9, tol=1e-9) == 2
    corners = np.abs(np.diff(change, axis=0)).max(axis=1) < 1e-15
    assert corners.mean() > 0.02


def test_water_diffuses_by_the_root_of_time_at_first():
    """And in the end the sheet is full; before it is put in there is none."""
    early = np.array([0.01, 0.04])
    assert_allclose(_diffused(early), 4 * np.sqrt(early / np.pi), rtol=2e-3)
    assert_allclose(_diffused(np.array([-1.0, 5.0])), [0, 1])


def test_an_alloy_has_no_induced_field_above_its_curie_point(change_of):
    """The colder, the more of it there is; in the heat there is none."""
    scene, _, change = change_of("curie_iron", 1, samples=1500)
    size, warm_C = np.linalg.norm(change, axis=1), scene.temperature(scene.time_s)
    assert 0.1 < np.mean(size == 0) < 0.7
    assert warm_C[size == 0].mean() > warm_C[size > 0].mean()
