"""A simulator's noise that is none: absent, a variance for a standard deviation, or the same again.

Noise is the fast part of what a sensor reads that motion does not make. High differences lose motion that is slow
against the sampling. Where that is not enough, what attitude explains is taken away before. Noise is as large along the
field as across it, and motion hardly changes the intensity: this separates noise from the motion that is left over.

That noise is the same in several sensors whose generators have one seed is issue 411 of Basilisk. The elements of
Gazebo's ``<noise>`` are standard deviations; a message's covariance holds variances. MuJoCo adds no noise to sensors
since its version 3.1.4 (its issue 1603).
"""

from collections import defaultdict
from collections.abc import Iterator
from itertools import combinations
from math import comb

import numpy as np

from tam_calibration.comparison.result import Mistake
from tam_calibration.core.noise import noise_deviation
from tam_calibration.effects.grades import MINOR
from tam_calibration.gap.regressors import turns
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT, FloatArray, to_nanotesla

ORDER = 8
"""Of the differences: a turn of 1 rad/s at 20 Hz leaves 1e-11 of the field; noise is a third as well known as by its
own values."""

NO_NOISE_T = 2e-12
"""Rounding of the Earth's field to 32 bits makes 1e-12 T."""

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
    # Of attitudes drawn anew for each sample attitude leaves every small effect, not noise alone.
    is_slow = _size(differences(readings)) < 0.5 * _size(readings - readings.mean(axis=0))
    if is_slow and (residual := _residual_from_attitude(recording, sensor)) is not None:
        tried.append(residual)
    return next((_without_jerks(differences(each)) for each in tried if _is_noise(each, readings)), None)


def _without_jerks(sequence_T: FloatArray) -> FloatArray:
    """Return differences (n, 3) with 0 for all that a jerk of the motion, which all sensors share, has a part in."""
    # Of noise one difference in 2 million is as large.
    is_jerk = np.abs(sequence_T) > 5.0 * noise_deviation(sequence_T, axis=0)
    touched = np.apply_along_axis(np.convolve, 0, is_jerk, np.ones(2 * ORDER + 1), "same") > 0
    return np.where(touched, 0.0, sequence_T)


def noise_level(recording: Recording, sensor: int) -> float | None:
    """Return the standard deviation of the white noise of the axes of a sensor, tesla; None where it is not known.

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
    residuals = [_residual_from_attitude(recording, sensor), _residual_from_others(recording, sensor)]
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
    own, noise = _residual_from_others(recording, sensor), _residual_from_attitude(recording, sensor)
    if recording.sample_count < FEWEST or own is None or noise is None:
        return False
    # Errors of the sensors leave less than a hundredth of the noise.
    is_little = _size(differences(own)) < 0.01 * _size(differences(noise))
    return is_little and _is_noise(noise, recording.readings_T[:, sensor])


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
    # Half as many samples again as the differences of white noise are correlated: a hum does not die down in them.
    lags = range(1, 3 * ORDER // 2 + 1)
    of_white = [(-1.0) ** lag * comb(2 * ORDER, ORDER + lag) / comb(2 * ORDER, ORDER) for lag in lags]
    lagged = np.array(
        [sequence[lag:] @ sequence[:-lag] / max(known[lag:] @ known[:-lag].astype(float), 1.0) for lag in lags]
    )
    # Of 300 samples each autocorrelation has an error of 0.11: of twelve the largest is beyond 0.4 once in 400 times.
    return bool((np.abs(lagged * count / power - of_white) < 0.4).all())


def _is_noise(residual_T: FloatArray, readings_T: FloatArray) -> bool:
    """Whether what is left (N, 3) of readings (N, 3) is noise: as large along the readings as across them."""
    length = np.linalg.norm(readings_T, axis=1)
    along = np.sum(residual_T * readings_T, axis=1) / np.where(length > 0, length, 1)
    # Of white noise the part along the field is as large as that across it, of motion a twentieth.
    return _size(differences(along[:, None])) > 0.5 * _size(differences(residual_T))


def _residual_from_attitude(recording: Recording, sensor: int) -> FloatArray | None:
    """Return what attitude does not explain of a sensor's readings, (N, 3)."""
    attitude = recording.attitude
    if attitude is None or not np.isfinite(attitude).all():
        return None
    return _residual_from(recording.readings_T[:, sensor], turns(attitude).reshape(-1, 9))


def _residual_from_others(recording: Recording, sensor: int) -> FloatArray | None:
    """Return what the mean of the other sensors does not explain of a sensor's readings, (N, 3)."""
    if recording.sensor_count == 1:
        return None
    readings = recording.readings_T
    return _residual_from(readings[:, sensor], np.delete(readings, sensor, axis=1).mean(axis=1))


def _residual_from(readings_T: FloatArray, causes: FloatArray) -> FloatArray:
    """Return what causes (N, p) and a constant leave of readings (N, 3)."""
    design = np.column_stack([causes, np.ones(len(causes))])
    solution, _, rank, _ = np.linalg.lstsq(design, readings_T, rcond=1e-9)
    return np.asarray((readings_T - design @ solution) * np.sqrt(len(design) / (len(design) - rank)))


def _size(values_T: FloatArray) -> float:
    """Return the root mean square of the robust deviations of the columns."""
    return float(np.sqrt(np.mean(noise_deviation(values_T, axis=0) ** 2)))


SHORTEST = 100
"""Samples that two sequences share at least before they are compared: their differences have 28 of their own, which
chance correlates by 0.6 at most."""


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
        pairs = [
            pair for pair in combinations(white, 2) if abs(_correlation(*(white[one] for one in pair))) > 1 - MINOR
        ]
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
    if any(_correlation(white[channel], others[channel]) > 1 - MINOR for channel in white.keys() & others.keys()):
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
    return next(iter(lags[products[lags] > (1 - MINOR) * size].tolist()), 0)


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
