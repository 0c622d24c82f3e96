"""A simulator's noise that is none: absent, a variance for a standard deviation, or the same again.

That noise is the same in several sensors whose generators have one seed is issue 411 of Basilisk. The elements of
Gazebo's ``<noise>`` are standard deviations; a message's covariance holds variances. MuJoCo adds no noise to sensors
since its version 3.1.4 (its issue 1603).
"""

from collections import defaultdict
from collections.abc import Iterator
from itertools import combinations

import numpy as np

from tam_calibration.comparison.mistakes.fast_residuals import (
    NO_NOISE_T,
    ORDER,
    is_shared,
    is_white,
    noise_level,
    noise_sequence,
    quietest,
)
from tam_calibration.comparison.result import Mistake
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT, FloatArray, to_nanotesla

SAME = 0.9
"""Correlation of two sequences of noise from which on they are one; differences of 100
samples have 28 of their own, of which chance makes 0.6 at most."""

SHORTEST = 100
"""Samples that two sequences share at least before they are compared."""


def mistaken_noise(simulation: Recording, recording: Recording, array: Array) -> list[Mistake]:
    """Return what is wrong with the noise of a simulation.

    Parameters
    ----------
    simulation, recording : Recording
        The two, in tesla.
    array : Array
        Of the recording: the noise that it states is right, else that of the readings.
    """
    own, others = _white(simulation), _white(recording)
    repeated = [*_of_channels(simulation, own), *_of_runs(own, others)]
    return repeated or list(_levels(simulation, recording, array))


def _white(run: Recording) -> dict[tuple[int, int], FloatArray]:
    """Return the white sequences of noise by sensor and axis, from 0."""
    return {
        (sensor, axis): each[:, axis]
        for sensor in range(run.sensor_count)
        if (each := noise_sequence(run, sensor)) is not None and len(each) >= SHORTEST
        for axis in range(3)
        if is_white(each[:, axis])
    }


def _correlation(one: FloatArray, other: FloatArray) -> float:
    """Return the correlation of two sequences, as long as both last."""
    count = min(len(one), len(other))
    one, other = one[:count], other[:count]
    return float(one @ other) / max(float(np.linalg.norm(one) * np.linalg.norm(other)), np.finfo(float).tiny)


def _of_channels(simulation: Recording, white: dict[tuple[int, int], FloatArray]) -> Iterator[Mistake]:
    """Yield that several axes have one noise."""
    if all(is_shared(simulation, sensor) for sensor in range(simulation.sensor_count)):
        named = where = "all sensors"
    else:
        pairs = [pair for pair in combinations(white, 2) if abs(_correlation(*(white[one] for one in pair))) > SAME]
        if not pairs:
            return
        same = [pairs[0][0], *(other for one, other in pairs if one == pairs[0][0])]
        named = " and ".join(map(_channel, same[:2])) + (f" and {len(same) - 2} more axes" if len(same) > 2 else "")
        are_all = len({sensor for sensor, _ in same}) == simulation.sensor_count
        where = "all sensors" if are_all else _channel(same[0])
    yield Mistake(
        "same_noise_in_channels",
        f"the simulation's noise is the same in {named}",
        where,
        "draw the noise of each axis of each sensor anew, from one generator or from several with other seeds",
    )


def _channel(channel: tuple[int, int]) -> str:
    return f"sensor {channel[0] + 1} axis {'xyz'[channel[1]]}"


def _of_runs(white: dict[tuple[int, int], FloatArray], others: dict[tuple[int, int], FloatArray]) -> Iterator[Mistake]:
    """Yield that noise repeats within the simulation, and that it is the same in both runs."""
    for channel, sequence in white.items():
        if period := _period(sequence):
            yield Mistake(
                "same_noise_again",
                f"the simulation's noise repeats after {period} samples, as seen in {_channel(channel)}: its generator "
                "is set to the same seed again and again",
                "all sensors",
                "make the generator once, before the first sample, and draw from it on",
            )
            break
    if any(_correlation(white[channel], others[channel]) > SAME for channel in white.keys() & others.keys()):
        yield Mistake(
            "same_noise_in_runs",
            "the noise is the same in both runs, sample by sample",
            "all sensors",
            "give every run another seed",
        )


def _period(sequence: FloatArray) -> int:
    """Return after how many samples differences (n,) come again; 0 where they do not."""
    count = len(sequence)
    products = np.fft.irfft(np.abs(np.fft.rfft(sequence, 2 * count)) ** 2)[:count]
    energy = np.concatenate([[0.0], np.cumsum(sequence**2)])
    lags = np.arange(2 * ORDER, count - SHORTEST)
    size = np.sqrt(energy[count - lags] * (energy[count] - energy[lags]))
    return next(iter(lags[products[lags] > SAME * size].tolist()), 0)


def _levels(simulation: Recording, recording: Recording, array: Array) -> Iterator[Mistake]:
    """Yield sensors without noise, then those whose noise is a square or a root of the right one."""
    found: dict[tuple[str, str], list[tuple[int, float, float]]] = defaultdict(list)
    count, stated_T = simulation.sensor_count, array.vector_noise_T
    for sensor in range(count):
        right_T = noise_level(recording, sensor) if stated_T is None else float(stated_T[sensor])
        if right_T is None:
            continue
        bound_T = quietest(simulation, sensor)
        own_T = bound_T if _is_none(bound_T, right_T) else noise_level(simulation, sensor)
        if own_T is not None and (name := _name(own_T, right_T)):
            found[name].append((sensor + 1, own_T, right_T))
    for (kind, unit), levels in found.items():
        sensors = [sensor for sensor, _, _ in levels]
        if unit in ("", "T") or len(sensors) == count:
            _, own_T, right_T = np.median(levels, axis=0).tolist()
            yield _of_level(kind, unit, sensors_in_words(sensors, count), own_T, right_T)


def _is_none(own_T: float, right_T: float) -> bool:
    """Whether a noise is practically none compared with the right one."""
    # No two kinds that are taken for one another differ by a factor of 100; sensors of a picotesla may be right.
    return own_T < right_T / 100.0 or own_T < min(NO_NOISE_T, right_T / 10.0)


def _name(own_T: float, right_T: float) -> tuple[str, str] | None:
    """Return the kind of a mistaken noise and the unit, if any, in which it was made; None of one that may be right."""
    # Within a factor of four another sensor is more likely than a square.
    if right_T / 4.0 < own_T < right_T * 4.0:
        return None
    for power, kind in ((2.0, "variance_for_deviation"), (0.5, "root_for_deviation")):
        for unit in ("nT", "uT", "G", "T"):
            tesla = TESLA_PER_FIELD_UNIT[unit]
            # In tesla the square is a billion times less and nothing else is near; else noises are known to some 6 %.
            near = 0.5 if unit == "T" else 0.2
            if abs(own_T / ((right_T / tesla) ** power * tesla) - 1) < near:
                return kind, unit
    return ("no_noise", "") if _is_none(own_T, right_T) else None


def _of_level(kind: str, unit: str, where: str, own_T: float, right_T: float) -> Mistake:
    """Return the mistake of sensors whose noise is not the right one, both in tesla."""
    own, right = (f"{to_nanotesla(level):.3g} nT" for level in (own_T, right_T))
    mend = (
        f"give the simulated sensor a standard deviation of {right_T:.3g} T: <stddev> of Gazebo's <noise>; MuJoCo adds "
        "no noise of its own since 3.1.4, draw it where the sensor's output is published"
    )
    if kind == "no_noise":
        return Mistake(
            kind, f"the simulation has no noise in {where}, {own}, and the recording has {right}", where, mend
        )
    name = "variance" if kind == "variance_for_deviation" else "root of the standard deviation"
    verb = "is" if unit == "T" else "looks like"
    what = (
        f"the simulation's noise of {where} {verb} the {name} in {unit}: {own}, where the standard deviation is {right}"
    )
    return Mistake(kind, what, where, mend)
