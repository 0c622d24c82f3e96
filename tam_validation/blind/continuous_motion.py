"""How an array is turned: attitudes as continuous functions of time, so that a delayed reading is a true one."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tam_calibration.model.units import FloatArray, from_degrees

MOTIONS = ("turntable", "tumbling", "diver", "figure_eight")


@dataclass(frozen=True)
class ContinuousMotion:
    """Yaw, pitch and roll as a function of time.

    Parameters
    ----------
    kind : str
        One of `MOTIONS`.
    angles : callable
        From times (n,) in seconds to yaw, pitch and roll (n, 3) in radians.
    """

    kind: str
    angles: Callable[[FloatArray], FloatArray]

    def to_world(self, time_s: FloatArray) -> FloatArray:
        """Return the rotations (n, 3, 3) from the array's frame to the world's, north, west, up."""
        yaw, pitch, roll = self.angles(np.asarray(time_s, dtype=float)).T
        return about("z", yaw) @ about("y", pitch) @ about("x", roll)

    def turning_rate(self, time_s: FloatArray, step_s: float) -> FloatArray:
        """Return the rotation rate (n, 3) in the array's frame [rad/s], by a central difference."""
        half = step_s / 2
        turn = np.swapaxes(self.to_world(time_s - half), 1, 2) @ self.to_world(time_s + half)
        skew = (turn - np.swapaxes(turn, 1, 2)) / (2 * step_s)
        return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


def about(axis: str, angle: FloatArray) -> FloatArray:
    """Return the rotations (n, 3, 3) of vectors about an axis, by the right hand."""
    angle = np.atleast_1d(angle)
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    turn = np.tile(np.eye(3), (len(angle), 1, 1))
    turn[:, first, first] = turn[:, second, second] = np.cos(angle)
    turn[:, second, first] = np.sin(angle)
    turn[:, first, second] = -turn[:, second, first]
    return turn


def draw_motion(rng: Generator, kind: str, duration_s: float, samples: int) -> ContinuousMotion:
    """Draw a motion that turns by not much more than 15 degrees from one sample to the next."""
    return ContinuousMotion(kind, _DRAWN[kind](rng, duration_s, samples))


def _turntable(rng: Generator, duration_s: float, samples: int) -> Callable[[FloatArray], FloatArray]:
    """Tilt the table, turn it in steps there and back, tilt it otherwise; each pose held, jumps between."""
    held = int(rng.integers(1, max(2, min(10, samples // 60) + 1)))
    poses = -(-samples // held) + 2
    around = int(np.clip(poses // 8, 8, 24))
    tilts = -(-poses // around)
    limit = from_degrees(rng.uniform(40, 90))
    pitch = np.repeat(rng.permutation(np.linspace(-limit, limit, tilts)), around)[:poses]
    roll = np.repeat(rng.uniform(-limit, limit, tilts), around)[:poses]
    steps = np.arange(poses) % (2 * around)
    yaw = 2 * np.pi / around * np.minimum(steps, 2 * around - steps) + rng.uniform(0, 2 * np.pi)
    table = np.stack([yaw, pitch, roll], axis=1)[_order(rng, poses)]
    dwell_s = held * duration_s / (samples - 1)
    return lambda time_s: table[np.clip((time_s / dwell_s + 1e-9).astype(int), 0, poses - 1)]


def _order(rng: Generator, poses: int) -> NDArray[np.intp]:
    """Draw the order of poses: once, the first half twice over or there and back, or with a long rest in one."""
    index, half = np.arange(poses), -(-poses // 2)
    start, rest = int(rng.integers(poses // 2)), poses // 5
    resting = np.concatenate([index[:start], np.full(rest, start), index[start : poses - rest]])
    return (index, index % half, np.minimum(index, 2 * half - 1 - index), resting)[rng.integers(4)]


def _tumbling(rng: Generator, duration_s: float, samples: int) -> Callable[[FloatArray], FloatArray]:
    """Turn on and on, or there and back, while pitch and roll swing."""
    turns = rng.uniform(min(5, samples / 25), min(25, samples / 24))
    back = rng.random() < 0.5
    swing = from_degrees(np.array([rng.uniform(20, 90), rng.uniform(20, 120)]))
    speed = turns * rng.uniform(0.15, 0.45, 2)
    phase = rng.uniform(0, 2 * np.pi, 3)

    def angles(time_s: FloatArray) -> FloatArray:
        share = time_s / duration_s
        yaw = 2 * np.pi * turns * (1.6 * share * (1 - share) if back else share) + phase[2]
        pitch, roll = (swing[i] * np.sin(2 * np.pi * speed[i] * share + phase[i]) for i in range(2))
        return np.stack([yaw, pitch, roll], axis=1)

    return angles


def _diver(rng: Generator, duration_s: float, samples: int) -> Callable[[FloatArray], FloatArray]:
    """Turn at random, as a diver with an array in the hands."""
    waves = 5
    turns = rng.uniform(min(5, samples / 40), min(20, samples / 35))
    speed = turns * rng.uniform(0.1, 1.0, (3, waves))
    phase = rng.uniform(0, 2 * np.pi, (3, waves))
    size = from_degrees(np.array([160.0, rng.uniform(35, 70), rng.uniform(35, 80)]))[:, None] / np.sqrt(waves / 2)
    size = size * rng.uniform(0.6, 1.4, (3, waves)) / (0.6 + speed / turns)

    def angles(time_s: FloatArray) -> FloatArray:
        share = np.asarray(time_s)[:, None, None] / duration_s
        return np.asarray((size * np.sin(2 * np.pi * speed * share + phase)).sum(axis=2))

    return angles


def _figure_eight(rng: Generator, duration_s: float, samples: int) -> Callable[[FloatArray], FloatArray]:
    """Write figures of eight while the heading goes slowly around."""
    eights = rng.uniform(min(6, samples / 60), min(16, samples / 60))
    size = from_degrees(np.array([rng.uniform(60, 120), rng.uniform(35, 70), rng.uniform(30, 80)]))
    around = rng.choice([-1, 1]) * rng.uniform(1, 2.5)
    phase = rng.uniform(0, 2 * np.pi, 3)

    def angles(time_s: FloatArray) -> FloatArray:
        share = time_s / duration_s
        run = 2 * np.pi * eights * share
        yaw = size[0] * np.sin(run + phase[0]) + 2 * np.pi * around * share
        pitch = size[1] * np.sin(2 * run + phase[1])
        roll = size[2] * np.sin(run * 0.73 + phase[2])
        return np.stack([yaw, pitch, roll], axis=1)

    return angles


_DRAWN = {
    "turntable": _turntable,
    "tumbling": _tumbling,
    "diver": _diver,
    "figure_eight": _figure_eight,
}
