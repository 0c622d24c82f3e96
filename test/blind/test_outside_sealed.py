"""The sealed half of the outside causes. Who writes rules of the diagnosis does not open this file."""

import numpy as np
import pytest

from tam_calibration.blind.case import make_case
from tam_calibration.blind.entry import MOVING
from tam_calibration.blind.outside import OUTSIDE
from tam_calibration.blind.outside_sealed import SEALED
from tam_calibration.blind.outside_sealed_motion import _swung
from tam_calibration.blind.plan import Plan

NUMBERED = pytest.mark.parametrize("name", SEALED, ids=range(len(SEALED)))
"""Not by their names, which a report of the tests would tell."""


def test_there_are_ten_or_more_of_their_own():
    """No sealed kind is an open one."""
    assert len(SEALED) >= 10 and not set(SEALED) & set(OUTSIDE)
    assert all(entry.sealed for entry in SEALED.values()) and not any(entry.sealed for entry in OUTSIDE.values())


@NUMBERED
def test_a_cause_disturbs_one_sensor_or_the_scalar(draw, name):
    """One place is disturbed, no other by more than a quarter of it, and the axis is the one that the key tells."""
    for seed in range(3):
        scene = draw(seed)
        cause = SEALED[name].draw(np.random.default_rng(seed), scene)
        vectors, scalar = cause.change(1.0, (scene.readings_T, scene.intensity_T))
        assert cause.effect == name and np.isfinite(vectors).all() and np.isfinite(scalar).all()
        size = np.abs(vectors - vectors.mean(axis=0)).mean(axis=0)
        (place,) = cause.sensors
        if place == "scalar":
            assert size.max() == 0 < np.ptp(scalar)
            continue
        strength = size.max(axis=1)
        assert np.delete(strength, place - 1).max() <= 0.25 * strength[place - 1] > 0
        if cause.axes:
            assert np.flatnonzero(size[place - 1]).tolist() == ["xyz".index(cause.axes[0])]


@NUMBERED
@pytest.mark.parametrize("gap", [0.3, 3.0])
def test_every_cause_reaches_its_gap(name, gap):
    """Each is there with the gap asked for, and its key says that it is sealed."""
    case = make_case(Plan("outside", (name,), (gap,)), 1, 1)
    assert case.key["visible_gap"] == pytest.approx(gap, rel=0.02)
    assert [cause["sealed"] for cause in case.key["effects"]] == [True]


def test_what_follows_the_rate_is_drawn_in_motion_only():
    """A turntable, which stands still while a sample is taken, shows no rate."""
    assert SEALED["centrifugal_bias"].motions == SEALED["gyroscopic_shift"].motions == MOVING


def test_a_shift_by_rotation_follows_the_rate_about_the_field(draw):
    """The scalar errs by the rotation about the field, of either sign."""
    scene = draw(1)
    _, scalar = SEALED["gyroscopic_shift"].draw(np.random.default_rng(1), scene).change(1.0, ())
    rate = scene.motion.turning_rate(scene.time_s, 1e-3)
    about = (rate * scene.field_T).sum(axis=1) / scene.intensity_T
    assert abs(np.corrcoef(scalar, about)[0, 1]) > 0.9


def test_a_pendulum_swings_at_its_own_period():
    """After a step it passes the new rest after a quarter of its period, overshoots, and comes to rest there."""
    drive = np.zeros((400, 3))
    drive[1:, 0] = 1
    path = _swung(drive, 2 * np.pi / 20, 0.1)[:, 0]
    assert 5 <= np.argmax(path > 1) <= 8 and path.max() > 1.5
    assert path[-1] == pytest.approx(1, abs=1e-3)
