"""A simulator's noise that is none: absent, a variance for a standard deviation, or the same again.

That noise is the same in several sensors whose generators have one seed is issue 411 of Basilisk. The elements of
Gazebo's ``<noise>`` are standard deviations; a message's covariance holds variances. MuJoCo adds no noise to sensors
since its version 3.1.4 (its issue 1603).

Noise is the fast part of what a sensor reads that motion does not make. High differences lose motion that is slow
against the sampling. Where that is not enough, what attitude explains is taken away before. Noise is as large along the
field as across it, and motion changes the intensity hardly: by that motion which is left over is told from noise.
"""

from collections.abc import Iterator
from math import comb

import numpy as np

from tam_calibration.comparison.result import Mistake
from tam_calibration.core.noise import noise_deviation
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensors_in_words import sensors_in_words
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT, FloatArray, to_nanotesla

ORDER = 8
"""Of the differences: a turn of 1 rad/s at 20 Hz leaves 1e-11 of the field; noise is a third as well known as by its
own values."""

ALONG = 0.5
"""Least part along the field, of what is across it, that is noise: of white noise it is 1, of motion a twentieth."""

SLOW = 0.5
"""Part of the readings' spread that the differences of a followed motion make; those of attitudes drawn anew for each
sample make as much as the spread, and what attitude leaves of them is not noise but every small effect."""

_LAGS = np.arange(1, 13)
"""Samples on, at which noise is compared with white noise: a hum, which sensors share, does not die down in them."""

NEAR_WHITE = 0.3
"""By which its autocorrelation may differ there: of 300 samples each has an error of 0.1."""

_OF_WHITE = np.array([(-1.0) ** lag * comb(2 * ORDER, ORDER + lag) / comb(2 * ORDER, ORDER) for lag in _LAGS])
"""Autocorrelation of the differences of white noise there."""

NO_NOISE_T = 2e-12
"""Rounding of the Earth's field to 32 bits makes 1e-12 T."""

JERK = 5.0
"""Robust standard deviations from which a difference is that of a jerk; of noise one in 2 million is."""

SHARED = 0.01
"""Part of its noise by which a sensor differs from others of the same noise: errors of the sensors leave less."""

FEWEST = 40
"""Samples: four for each of the ten numbers by which attitude explains an axis."""


def noise_sequence(recording: Recording, sensor: int) -> FloatArray | None:
    """Return differences (N - 8, 3) of the noise of a sensor, as large as it is; None where motion hides it.

    Parameters
    ----------
    recording : Recording
        Of N samples, tesla.
    sensor : int
        From 0.
    """
    readings = recording.readings_T[:, sensor]
    if len(readings) < FEWEST:
        return None
    tried = [readings]
    is_slow = _size(differences(readings)) < SLOW * _size(readings - readings.mean(axis=0))
    if is_slow and (residual := _beside_attitude(recording, sensor)) is not None:
        tried.append(residual)
    return next((_without_jerks(differences(each)) for each in tried if _is_noise(each, readings)), None)


def _without_jerks(sequence_T: FloatArray) -> FloatArray:
    """Return differences (n, 3) with 0 for all that a jerk of the motion, which all sensors share, has a part in."""
    is_jerk = np.abs(sequence_T) > JERK * noise_deviation(sequence_T, axis=0)
    touched = np.apply_along_axis(np.convolve, 0, is_jerk, np.ones(2 * ORDER + 1), "same") > 0
    return np.where(touched, 0.0, sequence_T)


def noise_level(recording: Recording, sensor: int) -> float | None:
    """Return the standard deviation of the white noise of the axes of a sensor, tesla; None where it is not told.

    Parameters
    ----------
    recording : Recording
        Of N samples, tesla.
    sensor : int
        From 0.
    """
    sequence = noise_sequence(recording, sensor)
    return _size(sequence) if sequence is not None and all(map(is_white, sequence.T)) else None


def quietest(recording: Recording, sensor: int) -> float:
    """Return how much of a sensor's readings nothing explains, tesla: a bound of its noise that single samples raise.

    Parameters
    ----------
    recording : Recording
        Of N samples, tesla.
    sensor : int
        From 0.
    """
    readings = recording.readings_T[:, sensor]
    if len(readings) < FEWEST:
        return float("inf")
    residuals = [_beside_attitude(recording, sensor), _beside_others(recording, sensor)]
    left = [readings, *(residual for residual in residuals if residual is not None)]
    return min(float(np.sqrt(np.mean(differences(each) ** 2))) for each in left)


def is_shared(recording: Recording, sensor: int) -> bool:
    """Whether the noise of a sensor is that of the others: they explain it, and the attitude does not.

    Parameters
    ----------
    recording : Recording
        Of N samples, tesla.
    sensor : int
        From 0.
    """
    beside = _beside_others(recording, sensor), _beside_attitude(recording, sensor)
    if len(recording.time_s) < FEWEST or beside[0] is None or beside[1] is None:
        return False
    unlike, noise = (_size(differences(residual)) for residual in beside if residual is not None)
    return unlike < SHARED * noise and _is_noise(beside[1], recording.readings_T[:, sensor])


def differences(values: FloatArray) -> FloatArray:
    """Return the differences along the first axis, as large as white noise is."""
    return np.asarray(np.diff(values, n=ORDER, axis=0) / np.sqrt(comb(2 * ORDER, ORDER)))


def is_white(sequence: FloatArray) -> bool:
    """Whether differences (n,), those of jerks 0, are those of white noise that is no rounding."""
    known = sequence != 0
    count = int(known.sum())
    power = float(sequence @ sequence)
    if 2 * count < len(sequence) or power <= count * NO_NOISE_T**2:
        return False
    lagged = np.array(
        [sequence[lag:] @ sequence[:-lag] / max(known[lag:] @ known[:-lag].astype(float), 1.0) for lag in _LAGS]
    )
    return bool((np.abs(lagged * count / power - _OF_WHITE) < NEAR_WHITE).all())


def _is_noise(residual_T: FloatArray, readings_T: FloatArray) -> bool:
    """Whether what is left (N, 3) of readings (N, 3) is noise: as large along the readings as across them."""
    length = np.linalg.norm(readings_T, axis=1)
    along = np.sum(residual_T * readings_T, axis=1) / np.where(length > 0, length, 1)
    return _size(differences(along[:, None])) > ALONG * _size(differences(residual_T))


def _beside_attitude(recording: Recording, sensor: int) -> FloatArray | None:
    """Return what attitude does not explain of a sensor's readings, (N, 3)."""
    from scipy.spatial.transform import Rotation

    attitude = recording.attitude
    if attitude is None or not np.isfinite(attitude).all():
        return None
    return _left_of(recording.readings_T[:, sensor], Rotation.from_quat(attitude).as_matrix().reshape(-1, 9))


def _beside_others(recording: Recording, sensor: int) -> FloatArray | None:
    """Return what the mean of the other sensors does not explain of a sensor's readings, (N, 3)."""
    if recording.sensor_count == 1:
        return None
    readings = recording.readings_T
    return _left_of(readings[:, sensor], np.delete(readings, sensor, axis=1).mean(axis=1))


def _left_of(readings_T: FloatArray, causes: FloatArray) -> FloatArray:
    """Return what causes (N, p) and a constant leave of readings (N, 3)."""
    design = np.column_stack([causes, np.ones(len(causes))])
    solution, _, rank, _ = np.linalg.lstsq(design, readings_T, rcond=1e-9)
    return np.asarray((readings_T - design @ solution) * np.sqrt(len(design) / (len(design) - rank)))


def _size(values_T: FloatArray) -> float:
    """Return the root mean square of the robust deviations of the columns."""
    return float(np.sqrt(np.mean(noise_deviation(values_T, axis=0) ** 2)))


SAME = 0.9
"""Correlation of two sequences of noise from which on they are one; differences of 100
samples have 28 of their own, of which chance makes 0.6 at most."""

SHORTEST = 100
"""Samples that two sequences share at least before they are compared."""

MUCH_MORE = 10.0
"""Times that the recording's noise is more, before a simulation has none: sensors of a picotesla may be right."""

NEARLY_NONE = 100.0
"""Times that the recording's noise is more, before a simulation has none whatever its sensors: no two kinds that are
taken for one another differ by so much."""

NEAR_SQUARE = 0.2
"""Part by which a noise may differ from the square of the right one: each is known to some 6 % from 300 samples."""

NEAR_SQUARE_IN_TESLA = 0.5
"""The same for tesla, where the square is a billion times less and nothing else is near."""

APART = 4.0
"""Times that a noise is more or less than the right one, before a square is more likely than another sensor."""

_MISTAKEN_UNITS = ("nT", "uT", "G", "T")
"""Units in which simulators state noise."""


def mistaken_noise(simulation: Recording, recording: Recording, array: Array) -> list[Mistake]:
    """Return what is wrong with the noise of a simulation.

    Parameters
    ----------
    simulation, recording : Recording
        The two, in tesla.
    array : Array
        Of the recording: the noise that it states is right, else that of the readings.
    """
    sequences = [noise_sequence(simulation, sensor) for sensor in range(simulation.sensor_count)]
    others = [noise_sequence(recording, sensor) for sensor in range(recording.sensor_count)]
    repeated = [*_of_two_channels(simulation, sequences), *_again(sequences), *_of_two_runs(sequences, others)]
    if repeated:
        return repeated
    right = [_right_level(recording, array, sensor) for sensor in range(recording.sensor_count)]
    return list(_levels(simulation, right))


def _right_level(recording: Recording, array: Array, sensor: int) -> float | None:
    return noise_level(recording, sensor) if array.vector_noise_T is None else float(array.vector_noise_T[sensor])


def _white(sequences: list[FloatArray | None]) -> dict[tuple[int, int], FloatArray]:
    """Return the white sequences by sensor and axis, from 0."""
    return {
        (sensor, axis): each[:, axis]
        for sensor, each in enumerate(sequences)
        if each is not None and len(each) >= SHORTEST
        for axis in range(3)
        if is_white(each[:, axis])
    }


def _correlation(one: FloatArray, other: FloatArray) -> float:
    return float(one @ other) / max(float(np.linalg.norm(one) * np.linalg.norm(other)), np.finfo(float).tiny)


def _channel(channel: tuple[int, int]) -> str:
    return f"sensor {channel[0] + 1} axis {'xyz'[channel[1]]}"


def _of_two_channels(simulation: Recording, sequences: list[FloatArray | None]) -> Iterator[Mistake]:
    if all(is_shared(simulation, sensor) for sensor in range(simulation.sensor_count)):
        yield _same_in("all sensors", "all sensors")
        return
    white = _white(sequences)
    channels = list(white)
    for number, first in enumerate(channels):
        same = [each for each in channels[number + 1 :] if abs(_correlation(white[first], white[each])) > SAME]
        if same:
            named = " and ".join(map(_channel, [first, same[0]]))
            named += f" and {len(same) - 1} more axes" if len(same) > 1 else ""
            are_all = len({sensor for sensor, _ in [first, *same]}) == len(sequences)
            yield _same_in(named, "all sensors" if are_all else _channel(first))
            return


def _same_in(named: str, where: str) -> Mistake:
    return Mistake(
        "same_noise_in_channels",
        f"the simulation's noise is the same in {named}",
        where,
        "draw the noise of each axis of each sensor anew, from one generator or from several with other seeds",
    )


def _again(sequences: list[FloatArray | None]) -> Iterator[Mistake]:
    for channel, sequence in _white(sequences).items():
        period = _period(sequence)
        if period:
            yield Mistake(
                "same_noise_again",
                f"the simulation's noise repeats after {period} samples, as seen in {_channel(channel)}: its generator "
                "is set to the same seed again and again",
                "all sensors",
                "make the generator once, before the first sample, and draw from it on",
            )
            return


def _period(sequence: FloatArray) -> int:
    """Return after how many samples differences (n,) come again; 0 where they do not."""
    count = len(sequence)
    spectrum = np.fft.rfft(sequence, 2 * count)
    products = np.fft.irfft(np.abs(spectrum) ** 2)[:count]
    energy = np.concatenate([[0.0], np.cumsum(sequence**2)])
    lags = np.arange(2 * ORDER, count - SHORTEST)
    if not len(lags):
        return 0
    size = np.sqrt(energy[count - lags] * (energy[count] - energy[lags]))
    same = products[lags] > SAME * size
    return int(lags[np.argmax(same)]) if same.any() else 0


def _of_two_runs(sequences: list[FloatArray | None], others: list[FloatArray | None]) -> Iterator[Mistake]:
    white, known = _white(sequences), _white(others)
    for channel in white.keys() & known.keys():
        count = min(len(white[channel]), len(known[channel]))
        if _correlation(white[channel][:count], known[channel][:count]) > SAME:
            yield Mistake(
                "same_noise_in_runs",
                "the noise is the same in both runs, sample by sample",
                "all sensors",
                "give every run another seed",
            )
            return


def _levels(simulation: Recording, right: list[float | None]) -> Iterator[Mistake]:
    """Yield sensors without noise, then those whose noise is a square or a root of the right one."""
    found: dict[tuple[str, str], list[tuple[int, float, float]]] = {}
    for sensor, right_T in enumerate(right[: simulation.sensor_count]):
        own_T = None if right_T is None else _own_level(simulation, sensor, right_T)
        if right_T is not None and own_T is not None and (name := _name(own_T, right_T)):
            found.setdefault(name, []).append((sensor + 1, own_T, right_T))
    for (kind, unit), levels in found.items():
        sensors = [sensor for sensor, _, _ in levels]
        if unit in ("", "T") or len(sensors) == simulation.sensor_count:
            where = sensors_in_words(sensors, simulation.sensor_count)
            own_T, right_T = (float(np.median([level[side] for level in levels])) for side in (1, 2))
            yield _of_level(kind, unit, where, own_T, right_T)


def _own_level(simulation: Recording, sensor: int, right_T: float) -> float | None:
    """Return the noise of a sensor, tesla, or its bound where it has next to none; None where it is not told."""
    bound_T = quietest(simulation, sensor)
    return bound_T if _is_none(bound_T, right_T) else noise_level(simulation, sensor)


def _is_none(own_T: float, right_T: float) -> bool:
    """Whether a noise is as good as none beside the right one."""
    return own_T < right_T / NEARLY_NONE or own_T < min(NO_NOISE_T, right_T / MUCH_MORE)


def _name(own_T: float, right_T: float) -> tuple[str, str] | None:
    """Return the kind of a mistaken noise and the unit, if any, in which it was made; None of one that may be right."""
    if right_T / APART < own_T < right_T * APART:
        return None
    for power, kind in ((2.0, "variance_for_deviation"), (0.5, "root_for_deviation")):
        for unit in _MISTAKEN_UNITS:
            tesla = TESLA_PER_FIELD_UNIT[unit]
            near = NEAR_SQUARE_IN_TESLA if unit == "T" else NEAR_SQUARE
            if abs(own_T / ((right_T / tesla) ** power * tesla) - 1) < near:
                return kind, unit
    return ("no_noise", "") if _is_none(own_T, right_T) else None


def _of_level(kind: str, unit: str, where: str, own_T: float, right_T: float) -> Mistake:
    """Return the mistake of sensors whose noise is so large, tesla, beside the right one."""
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
