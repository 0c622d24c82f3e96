"""The direction of the field against the turns of a gyroscope shows what all sensors and the scalar feel alike."""

import re
from dataclasses import replace

import numpy as np
import pytest
from swinging_circle import COUNT, RATE_HZ, WORLD_T, attitude_at, made

from tam_calibration.gap import diagnose
from tam_calibration.gap.diagnose import judge
from tam_calibration.gap.field_direction import field_direction
from tam_calibration.gap.model import Model

TIME_S = np.arange(COUNT) / RATE_HZ
STEP_T = np.outer(TIME_S[:1500] >= 50.0, [20e-9, 0.0, 30e-9])
PASSED_T = np.outer(np.exp(-(((TIME_S - 150.0) / 8.0) ** 2)), [50e-9, 80e-9, 0.0])


@pytest.mark.parametrize("sensors", [1, 4])
def test_a_magnet_that_moves_on_the_vehicle_is_seen(sensors):
    """All channels agree, so that there is no gap; the remark says when the field changed, and by how much."""
    recording, array, _ = made(sensors, seed=3, count=1500, added_T=STEP_T)
    gap = diagnose(recording, array)
    assert gap.verdict == "no_gap"
    (remark,) = gap.remarks
    found = re.search(r"no such turn: by (\S+) nT at (\S+) s\.", remark)
    assert found, remark
    along = attitude_at(50.0, TIME_S[1499]).inv().apply(WORLD_T / np.linalg.norm(WORLD_T))
    across_nT = 1e9 * np.linalg.norm(np.cross(STEP_T[-1], along))
    # Four standard errors of two samples, and rounding.
    assert float(found[1]) == pytest.approx(across_nT, abs=5.0)
    assert float(found[2]) == pytest.approx(50.0, abs=0.2)


def test_a_source_that_is_passed_comes_and_goes():
    """Its field rises and falls around the moment at which it is nearest."""
    recording, array, _ = made(4, seed=3, added_T=PASSED_T)
    (remark,) = field_direction(Model.nominal(recording, array), recording, array)
    assert remark.count(" nT from ") == 2, remark
    assert " from 13" in remark and " from 15" in remark, remark


def test_one_sensor_that_was_hardly_turned_has_no_gap():
    """An axis that lies across the field explains noise by a large shift, which is no gross disturbance."""
    recording, array, _ = made(1, seed=7)
    assert diagnose(recording, array).verdict == "no_gap"


def test_a_left_handed_gyroscope_or_set_of_sensors_is_said():
    """A set that is left-handed throughout agrees with itself: only the turns tell."""
    recording, array, _ = made(4, seed=3, count=600)
    mirrored = replace(recording, readings_T=recording.readings_T * [1.0, 1.0, -1.0])
    (remark,) = field_direction(Model.nominal(mirrored, array), mirrored, array)
    assert "left-handed" in remark


@pytest.fixture(scope="module")
def still():
    """Return a recording, its array, and its diagnosis with a gyroscope that stands still."""
    recording, array, _ = made(4, seed=2, count=1200)
    silent = replace(recording, angular_velocity_rad_s=np.zeros_like(recording.angular_velocity_rad_s))
    return recording, array, judge(silent, array)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (np.degrees, "in °/s"),
        (np.negative, "left-handed"),
        (lambda rates: np.random.default_rng(1).normal(size=rates.shape), "does not go with the turns"),
    ],
)
def test_what_is_wrong_with_a_gyroscope_is_said(still, change, words):
    """In one remark."""
    recording, array, judged = still
    changed = replace(recording, angular_velocity_rad_s=change(recording.angular_velocity_rad_s))
    (remark,) = field_direction(judged.found.nominal, changed, array)
    assert words in remark


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_said_of_a_uniform_field(still, seed):
    """Noise, and bias and delay of the gyroscope, are no change of the field."""
    recording, array, judged = still
    rates = made(4, seed=seed, count=1200)[0].angular_velocity_rad_s
    late = np.vstack([rates[:1], rates[:-1]]) + np.array([1e-3, 0.0, -1e-3])
    assert field_direction(judged.found.nominal, replace(recording, angular_velocity_rad_s=late), array) == ()


def test_a_gyroscope_that_cannot_be_used_costs_no_verdict(still):
    """One remark of the diagnosis says why."""
    gap = still[-1].gap
    assert gap.verdict == "no_gap"
    (remark,) = gap.remarks
    assert "too few samples" in remark


@pytest.mark.parametrize("seed", range(3))
def test_stamps_that_jitter_are_no_magnet_and_hide_none(seed):
    """While the array turns, a stamp that is 5 ms off makes one sample's direction wrong, and no other."""
    jitter_s = 0.005 * np.random.default_rng(seed).normal(size=1500)
    told = []
    for added_T in (0.0, 2 * STEP_T):
        recording, array, _ = made(4, seed=seed, count=1500, added_T=added_T)
        jittered = replace(recording, time_s=recording.time_s + jitter_s)
        told.append(field_direction(Model.nominal(jittered, array), jittered, array))
    uniform, (remark,) = told
    assert uniform == ()
    assert re.search(r"no such turn: by \S+ nT (at|from) (49|50)\.\d ", remark), remark
