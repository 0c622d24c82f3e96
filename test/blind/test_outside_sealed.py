"""The sealed half of the outside causes. Who writes rules of the diagnosis does not open this file."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.blind.case import make_case
from tam_calibration.blind.catalogue import CATALOGUE
from tam_calibration.blind.entry import MOVING
from tam_calibration.blind.motion import Motion
from tam_calibration.blind.outside import OUTSIDE
from tam_calibration.blind.outside_sealed_causes import SEALED
from tam_calibration.blind.outside_sealed_whole import _behind
from tam_calibration.blind.plan import Plan

NUMBERED = pytest.mark.parametrize("name", SEALED, ids=range(len(SEALED)))
"""Not by their names, which a report of the tests would tell."""

SMALL = {"s": 1e-4, "nT": 1.0}
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
    """Twice the amplitude makes twice the change, or nearly so where it is not linear in it."""
    once, twice = (np.concatenate([part.ravel() for part in disturb(name, 1, times)[1]]) for times in (1, 2))
    assert_allclose(np.linalg.norm(twice), 2 * np.linalg.norm(once), rtol=0.02)


@NUMBERED
@pytest.mark.parametrize("gap", [0.3, 3.0])
def test_every_cause_reaches_its_gap(name, gap):
    """Each is there with the gap asked for, and its key says that it is sealed."""
    case = make_case(Plan("outside", (name,), (gap,)), 1, 1)
    assert case.key["visible_gap"] == pytest.approx(gap, rel=0.02)
    assert [cause["sealed"] for cause in case.key["effects"]] == [True]


def test_what_follows_the_rate_is_drawn_in_motion_only():
    """A turntable, which stands still while a sample is taken, shows no rate."""
    assert SEALED["whipping_boom"].motions == SEALED["drifting_clock"].motions == MOVING


def test_a_joint_follows_when_its_play_is_used_up():
    """Behind by the play while it moves one way, ahead by it after as much of the other way."""
    angle = np.array([0.0, 0.5, 1.5, 4.0, 3.5, 3.0, 2.0, 2.0, 5.0])
    assert_allclose(_behind(angle, 1.0), [0, 0.5, 1, 1, 0.5, 0, -1, -1, 1])


def test_domain_walls_rest_while_the_field_does(draw):
    """Where the field along a core stays as it is, so does what the walls add."""
    scene = draw(1, motions=("turntable",), with_scalar=False)
    cause = SEALED["barkhausen_noise"].draw(np.random.default_rng(3), scene)
    vectors, _ = cause.change(1.0, (scene.readings_T, scene.intensity_T))
    sensor = cause.sensors[0] - 1
    still = np.diff(scene.readings_T[:, sensor], axis=0) == 0
    assert still.any() and np.abs(np.diff(vectors[:, sensor], axis=0)[still]).max() == 0


def test_the_delays_of_a_clock_are_right_on_the_mean(draw):
    """A constant delay would be another cause."""
    scene, asked = draw(4, motions=("diver",)), []

    def angles(time_s):
        asked.append(time_s)
        return np.zeros((len(time_s), 3))

    noting = replace(scene, motion=Motion("diver", angles))
    cause = SEALED["drifting_clock"].draw(np.random.default_rng(4), noting)
    cause.change(0.1, ())
    late_s = noting.time_s - asked[0]
    assert np.mean(late_s) == pytest.approx(0, abs=1e-9) and np.std(late_s) == pytest.approx(0.1)
