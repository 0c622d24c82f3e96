"""The sealed half of the outside causes. Who writes rules of the diagnosis does not open this file."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.blind.case import make_case
from tam_calibration.blind.catalogue import CATALOGUE
from tam_calibration.blind.entry import MOVING
from tam_calibration.blind.outside import OUTSIDE
from tam_calibration.blind.outside_sealed_causes import SEALED, _followed, _kept, _reported
from tam_calibration.blind.outside_sealed_whole import _dipole, _pulled, _slid
from tam_calibration.blind.plan import Plan

NUMBERED = pytest.mark.parametrize("name", SEALED, ids=range(len(SEALED)))
"""Not by their names, which a report of the tests would tell."""

SMALL = {"s": 1e-4, "nT": 1.0, "T a sample below the fastest": 1e-7, "T of the band": 1e-6}
"""Amplitudes by their units."""


@pytest.fixture
def disturb(draw):
    """Return a function that draws a sealed cause in one of its motions, and what it adds at so many amplitudes."""

    def disturbing(name, seed, times=1.0):
        motions = SEALED[name].motions
        scene = draw(seed, motions=(motions[seed % len(motions)],))
        cause = SEALED[name].draw(np.random.default_rng(seed), scene)
        seen = scene.readings_T, scene.intensity_T
        return cause, cause.change(times * SMALL[cause.amplitude_unit], seen)

    return disturbing


def test_there_are_ten_or_more_of_their_own():
    """No sealed kind is an open one, or an effect of the library."""
    assert len(SEALED) >= 10 and not set(SEALED) & {*OUTSIDE, *CATALOGUE}
    assert all(entry.sealed for entry in SEALED.values()) and not any(entry.sealed for entry in OUTSIDE.values())


@NUMBERED
@pytest.mark.parametrize("seed", range(4))
def test_a_cause_disturbs_one_sensor_or_the_scalar(disturb, name, seed):
    """One place is disturbed and no other, by finite numbers, and the axis is the one that the key tells."""
    cause, (vectors, scalar) = disturb(name, seed)
    assert cause.effect == name and np.isfinite(vectors).all() and np.isfinite(scalar).all()
    size = np.ptp(vectors, axis=0)
    (place,) = cause.sensors
    if place == "scalar":
        assert SEALED[name].scalar_needed and size.max() == 0 < np.ptp(scalar)
        return
    assert np.flatnonzero(size.max(axis=1)).tolist() == [place - 1] and np.ptp(scalar) == 0
    axes = ["xyz".index(axis) for axis in cause.axes] or [0, 1, 2]
    assert np.flatnonzero(size[place - 1]).tolist() == axes


@NUMBERED
def test_the_same_seed_makes_the_same_cause(disturb, name):
    """What is drawn follows from the generator and the scene."""
    (first, changes), (again, same) = disturb(name, 2), disturb(name, 2)
    assert first.parameters == again.parameters and first.sensors == again.sensors
    for one, other in zip(changes, same, strict=True):
        assert_array_equal(one, other)


@NUMBERED
def test_a_cause_grows_with_its_amplitude(disturb, name):
    """Twice the amplitude makes twice the change, or nearly so where it shifts times; a threshold has another law."""
    cause, _ = disturb(name, 1)
    once, twice = (np.concatenate([part.ravel() for part in disturb(name, 1, times)[1]]) for times in (1, 2))
    ratio = np.linalg.norm(twice) / np.linalg.norm(once)
    assert 1.2 < ratio < 8 if cause.amplitude_unit.startswith("T ") else ratio == pytest.approx(2, rel=0.02)


@NUMBERED
@pytest.mark.parametrize("gap", [0.3, 3.0])
def test_every_cause_reaches_its_gap(name, gap):
    """Each is there with the gap asked for, and its key says that it is sealed."""
    case = make_case(Plan("outside", (name,), (gap,)), 1, 1)
    assert case.key["visible_gap"] == pytest.approx(gap, rel=0.02)
    assert [cause["sealed"] for cause in case.key["effects"]] == [True]


@pytest.fixture
def change_of(draw):
    """Return a function that draws a cause, and what it adds to its sensor at an amplitude of one, with the scene."""

    def changing(name, seed, amplitude=1.0, **wish):
        scene = draw(seed, **wish)
        cause = SEALED[name].draw(np.random.default_rng(seed), scene)
        vectors, _ = cause.change(amplitude, (scene.readings_T, scene.intensity_T))
        return scene, cause, vectors[:, cause.sensors[0] - 1]

    return changing


def test_what_follows_the_rate_is_drawn_in_motion_only():
    """A turntable, which stands still while a sample is taken, shows no rate."""
    names = ("slew_limit", "report_on_change", "polled_sensor", "gyro_fusion", "steering_current")
    assert all(SEALED[name].motions == MOVING for name in names)


def test_a_bit_is_set_or_not(change_of):
    """An axis has two errors and no other, and goes from one to the other often."""
    _, _, change = change_of("weak_bit", 1)
    for axis in change.T[np.ptp(change, axis=0) > 0]:
        assert len(np.unique(axis)) == 2 and np.count_nonzero(np.diff(axis)) > 20


def test_a_shared_reference_is_even_in_the_other_axes(change_of):
    """The gain error is of one sign, whatever the signs of the fields."""
    scene, cause, change = change_of("shared_reference", 1)
    core = scene.core(cause.sensors[0] - 1)
    assert (change * core <= 0).all()


def test_noise_of_a_reference_lies_along_the_reading(change_of):
    """All axes err by the same part of what they read."""
    scene, cause, change = change_of("reference_noise", 1)
    assert_allclose(np.cross(change, scene.core(cause.sensors[0] - 1)), 0, atol=1e-22)


def test_an_idle_tone_rests_in_a_zero_field(change_of):
    """It changes fast only where the field along its axis is large."""
    scene, cause, change = change_of("idle_tone", 1)
    step, size = np.abs(np.diff(change, axis=0)), np.abs(scene.core(cause.sensors[0] - 1)[1:])
    weak = size < 0.05
    assert step[weak].max() <= 2 * np.pi * 0.45 * 0.05 * 1.4e-9 < step.max()


def test_a_slow_integrator_catches_up():
    """It goes by its limit until it is there."""
    assert_allclose(_followed(np.array([0.0, 3, 3, 3, 3, 2.5]), np.ones(6)), [0, 1, 2, 3, 3, 2.5])


def test_what_stays_in_its_band_is_not_reported():
    """The last report stands until a value is off by more than the band."""
    assert_array_equal(_reported(np.array([0.0, 0.9, 1.1, 0.5, 0.2, 0.0]), 1.0), [0, 0, 1.1, 1.1, 1.1, 0])


def test_a_handover_is_late():
    """Within the band the cell is the one that it was."""
    assert_array_equal(_kept(np.array([-1.0, 0.1, 0.3, 0.1, -0.1, -0.3]), 0.2), [0, 0, 1, 1, 1, 0])


@pytest.mark.parametrize("name", ["cable_windup", "rubber_mount", "gyro_fusion"])
def test_what_turns_a_sensor_keeps_the_length_of_its_reading(change_of, name):
    """The error lies across the field."""
    scene, cause, change = change_of(name, 1)
    core = scene.core(cause.sensors[0] - 1)
    along = (change * core).sum(axis=1) / np.linalg.norm(core, axis=1)
    assert np.std(along) < 0.15 * np.std(change)


def test_a_tray_slides_to_its_stop():
    """It stays there until the rail slopes the other way."""
    assert_allclose(_slid(np.array([0.6, 0.6, 0.6, -0.5, -2.0])), [0.6, 1, 1, 0.5, -1])


def test_a_dipole_has_twice_the_field_on_its_axis():
    """And it is against the moment beside it."""
    field = _dipole(np.array([0, 0, 1.0]), np.array([[0, 0, 2.0], [2.0, 0, 0]]))
    assert_allclose(field, [[0, 0, 0.25], [0, 0, -0.125]])


def test_remanence_moves_slowly(change_of):
    """From one sample to the next it changes by a small part of all that it does."""
    _, _, change = change_of("viscous_remanence", 1)
    assert np.abs(np.diff(change, axis=0)).max() < 0.2 * np.ptp(change)


def test_a_charge_jumps_up_and_fades(change_of):
    """It rises in few samples only, and never beyond the full current."""
    _, _, change = change_of("sonar_recharge", 1)
    size = np.linalg.norm(change, axis=1)
    assert np.mean(np.diff(size) > 0) < 0.2 and size.max() <= 1.0001e-9


def test_what_has_play_rests_after_a_reversal():
    """It is pulled when the play is used up."""
    assert_allclose(_pulled(np.array([0.0, 1, 3, 2.5, 1.5, 0]), 1.0), [0, 0, 2, 2, 2, 1])
