import numpy as np
import pytest

LEAST_BIT_T = 1e-9


def stuck(bit, is_set, sensor=2, axis=0):
    """Return what a converter of 1 nT does to an axis with one bit stuck."""

    def change(readings):
        codes = np.round(readings[:, sensor - 1, axis] / LEAST_BIT_T).astype(int)
        codes = codes | (1 << bit) if is_set else codes & ~(1 << bit)
        readings[:, sensor - 1, axis] = codes * LEAST_BIT_T

    return change


@pytest.mark.parametrize("bit", [3, 5, 8, 11, 13])
@pytest.mark.parametrize("is_set", [True, False])
def test_a_stuck_bit_is_named(run, bit, is_set):
    """Sensor and axis, and what it leaves out: from 8 nT to a tenth of the range."""
    (fault,) = run.spoiled(stuck(bit, is_set)).faults
    assert (fault.name, fault.sensor, fault.axis, fault.severity) == ("stuck_bits", 2, "x", "refusal")
    left_out_nT = float(fault.sentence.split("band of ")[1].split()[0])
    assert left_out_nT == pytest.approx(2**bit, rel=0.01)


@pytest.mark.parametrize("bit", [5, 10])
def test_one_sensor_alone(run, bit):
    """More bands than poses of a turntable could leave."""
    assert run.spoiled(stuck(bit, True)).of(2).told == [("stuck_bits", 1, "x")]


def test_two_bits_beside_each_other(run):
    """Three quarters are left out."""

    def both(readings):
        stuck(8, True)(readings)
        stuck(9, False)(readings)

    assert run.spoiled(both).told == [("stuck_bits", 2, "x")]


@pytest.mark.parametrize("jump_T", [0.0, 4e-6])
def test_visited_attitudes_leave_out_bands_too(run, jump_T):
    """Where all sensors are turned in steps the others say that the motion leaves them out, also if a bias jumps."""
    rng = np.random.default_rng(3)
    levels = 1e-6 * (4 * np.arange(-12, 12)[:, None] + np.linspace(0, 1.8, 60)).ravel()

    def poses(readings):
        readings[:] = rng.choice(levels, (1500, 1, 1)) + 1e-5 * rng.normal(size=(1500, 1, 3)) * [0, 1, 1]
        readings += 1e-9 * rng.normal(size=readings.shape)
        readings[750:, 1, 0] += jump_T

    assert [told for told in run.spoiled(poses).told if told[0] == "stuck_bits"] == []


def test_a_sensor_that_bends_in_visited_attitudes_has_no_stuck_bit(run):
    """Its readings lie beside the bands by less than a bit would move them."""
    rng = np.random.default_rng(3)
    levels = 1e-6 * (0.8 * np.arange(-20, 20)[:, None] + np.linspace(0, 0.2, 40)).ravel()

    def poses(readings):
        chosen = rng.choice(len(levels), len(readings))
        readings[:] = levels[chosen, None, None] + 1e-5 * rng.normal(size=(1500, 1, 3)) * [0, 1, 1]
        readings[:, [0, 2, 3], 0] += rng.choice([-8e-8, 8e-8], len(levels))[chosen, None]
        readings += 1e-9 * rng.normal(size=readings.shape)

    assert [told for told in run.spoiled(poses).told if told[0] == "stuck_bits"] == []


@pytest.mark.parametrize("leak", [0.0005, -0.0008])
def test_coarse_steps_behind_a_matrix_are_no_stuck_bits(run, leak):
    """A driver that applies a soft-iron matrix to steps of 150 nT widens each by what it adds of the other axes."""

    def mixed(readings):
        steps = 150e-9 * np.round(readings / 150e-9)
        readings[:] = steps + leak * (steps.sum(axis=2, keepdims=True) - steps)

    assert [told for told in run.spoiled(mixed).told if told[0] == "stuck_bits"] == []


def test_steps_are_no_stuck_bits(run):
    """Values that lie on one phase of a period are a lattice."""
    assert {name for name, *_ in run.spoiled(lambda readings: np.round(readings, 7, out=readings)).told} == {
        "quantised"
    }
