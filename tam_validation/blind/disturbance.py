"""The signal of one cause in a recording at any amplitude, and the properties of each kind of cause."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_validation.blind.continuous_motion import MOTIONS
from tam_validation.blind.scene import Scene

Signal = tuple[FloatArray, FloatArray]
"""Change of the readings (N, K, 3) and of the scalar (N,) in tesla."""

_AXES = ("x", "y", "z")

SCALAR = "scalar"
ALL = "all"


@dataclass(frozen=True, eq=False)
class Disturbance:
    """One cause at work in a scene.

    Parameters
    ----------
    effect : str
        Its name; that of an effect of the library, or one that no library holds.
    sensors : tuple
        Where: numbers from 1, "scalar", or "all".
    axes : tuple of str
        The one axis, when no other is disturbed.
    change : callable
        From an amplitude, and the readings and the scalar with their noise, to their `Signal`.
    amplitude_unit : str
    parameters : dict
        The other values drawn, for the key.
    after_noise : bool
        True for what acts on the reading with its noise, in the recorder.
    coefficients : dict
        Coefficients that a diagnosis states too, for an amplitude of one: from names such as "sensor 2 x offset" to
        values in nT, nT/A, nT/°C or s.
    columns : dict
        What is recorded beside the fields because of it: from names of columns to values (N,).
    """

    effect: str
    sensors: tuple[int | str, ...]
    axes: tuple[str, ...]
    change: Callable[[float, Signal], Signal]
    amplitude_unit: str
    parameters: dict[str, Any]
    after_noise: bool = False
    coefficients: dict[str, float] = field(default_factory=dict)
    columns: dict[str, FloatArray] = field(default_factory=dict)


Draw = Callable[[Generator, Scene], Disturbance]


def proportional(signal: Signal) -> Callable[[float, Signal], Signal]:
    """Return a change proportional to the amplitude that does not depend on the readings."""
    return lambda amplitude, _seen: (amplitude * signal[0], amplitude * signal[1])


def silent(scene: Scene) -> Signal:
    """Return no change at all."""
    return np.zeros((scene.sample_count, scene.sensor_count, 3)), np.zeros(scene.sample_count)


def of_sensors(scene: Scene, rows: dict[int, FloatArray]) -> Signal:
    """Return the signal of some sensors: from indices to changes (N, 3)."""
    vectors, scalar = silent(scene)
    for sensor, change in rows.items():
        vectors[:, sensor] = change
    return vectors, scalar


def of_scalar(scene: Scene, change_T: FloatArray) -> Signal:
    """Return the signal of the scalar alone."""
    return silent(scene)[0], change_T


def in_one_sensor(
    scene: Scene, effect: str, sensor: int, mask: FloatArray, change_T: FloatArray, parameters: Mapping[str, object]
) -> Disturbance:
    """Return a cause in one sensor that grows with its amplitude, from its change (N, 3) at an amplitude of one."""
    change = proportional(of_sensors(scene, {sensor: change_T}))
    return Disturbance(effect, (sensor + 1,), named(mask), change, "nT", dict(parameters))


def by_axis(sensor: int, quantity: str, values: FloatArray) -> dict[str, float]:
    """Return the coefficients of a sensor's axes (3,) by their names, those of axes that are not disturbed left out."""
    named_values = zip(_AXES, numbers(values), strict=True)
    return {f"sensor {sensor + 1} {axis} {quantity}": value for axis, value in named_values if value}


def draw_sensor(rng: Generator, scene: Scene) -> int:
    """Draw a sensor's index."""
    return int(rng.integers(scene.sensor_count))


def draw_sensors(rng: Generator, scene: Scene) -> list[int]:
    """Draw the indices of two sensors, or of up to half of all where those are more."""
    count = int(rng.integers(2, max(3, scene.sensor_count // 2 + 1)))
    return [int(one) for one in np.sort(rng.choice(scene.sensor_count, count, replace=False))]


def draw_axes(rng: Generator, chance_of_one: float) -> FloatArray:
    """Draw a mask (3,) of all axes, or with some chance of one."""
    mask = np.ones(3)
    if rng.random() < chance_of_one:
        mask = np.zeros(3)
        mask[rng.integers(3)] = 1
    return mask


def named(mask: FloatArray) -> tuple[str, ...]:
    """Return the name of the one axis of a mask; nothing when there are more."""
    return tuple(_AXES[i] for i in np.flatnonzero(mask)) if np.count_nonzero(mask) == 1 else ()


def draw_direction(rng: Generator) -> FloatArray:
    """Draw a unit vector (3,)."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def where_strong(scene: Scene, vectors: FloatArray) -> tuple[int | str, ...] | None:
    """Return the one sensor, or all, that is disturbed; None when it is neither, so that the place is ambiguous."""
    size = np.abs(vectors - vectors.mean(axis=0)).mean(axis=(0, 2))
    share = size / size.max()
    if scene.sensor_count > 1 and (share > 0.35).all():
        return (ALL,)
    if np.count_nonzero(share > 0.1) == 1:
        return (int(share.argmax()) + 1,)
    return None


def numbers(values: Sequence[float] | FloatArray) -> list[float]:
    """Return numbers for the key, to six digits."""
    return [float(f"{value:.6g}") for value in np.ravel(values)]


MOVING = tuple(motion for motion in MOTIONS if motion != "turntable")

SEVERAL = (3, 4, 6)
"""Numbers of sensors with which a fault of one can be told from what the field does."""


@dataclass(frozen=True)
class Entry:
    """One kind of cause.

    Parameters
    ----------
    draw : callable
    family : str
        Causes of one family at one sensor are hard to tell apart; no pair is made of them.
    channel : str
        The recorded channel that decides for it; nothing when the fields suffice.
    motions : tuple of str
        Those in which it can be seen.
    sensor_counts : tuple of int
        Those with which it can be told from others.
    scalar_needed : bool
    most_nT : float
        The largest change of a reading that it makes in nature.
    most_nT_per_s : float
        The fastest change that it makes in nature, root mean square.
    large : tuple of float
        The large gaps, in noise floors, that it can have in nature.
    named : str
        For a cause outside the library: the name of an effect that is as right an answer as none.
    coarse : bool
        Whether a small gap of it takes a noisy sensor, as one sample in a quiet one is a large gap already.
    """

    draw: Draw
    family: str
    channel: str = ""
    motions: tuple[str, ...] = MOTIONS
    sensor_counts: tuple[int, ...] = (2, 3, 4, 6)
    scalar_needed: bool = False
    most_nT: float = 10_000.0
    most_nT_per_s: float = float("inf")
    large: tuple[float, ...] = (30.0, 1000.0)
    named: str = ""
    coarse: bool = False
