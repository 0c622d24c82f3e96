"""Where a gap lies, without assuming a cause."""

from collections.abc import Iterable

import numpy as np

from tam_calibration.core.normal_equations import ridged
from tam_calibration.effects.grades import LEAST_SAMPLES, MINOR, MOST, NEGLIGIBLE, NOTABLE
from tam_calibration.gap.hypothesis import Hypothesis, Place
from tam_calibration.gap.regression import Base, columns_of
from tam_calibration.gap.result import Where
from tam_calibration.gap.size import Evidence
from tam_calibration.gap.support import LEAST_EVIDENCE
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.fitted_effect import ALL, SCALAR
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray


def sensors_and_axes(places: Iterable[Place], recording: Recording) -> tuple[tuple[int | str, ...], tuple[str, ...]]:
    """Return the sensor numbers (or "scalar") and axes of places.

    A constant intensity in place of a scalar channel counts as all sensors.

    Parameters
    ----------
    places : iterable of Place
        Index of the sensor, ``SCALAR`` or ``ALL``, and of the axis; None for all axes.
    recording : Recording
        Of K sensors, with or without a scalar channel.
    """
    sensor_count = recording.sensor_count
    places = [(ALL if sensor == SCALAR and recording.scalar_T is None else sensor, axis) for sensor, axis in places]
    found = {sensor for sensor, _ in places}
    if ALL in found:
        found = found - {ALL} | set(range(sensor_count))
    sensors: list[int | str] = [sensor + 1 for sensor in sorted(found - {SCALAR})]
    if SCALAR in found:
        sensors.append("scalar")
    axes = {axis for sensor, axis in places if sensor != SCALAR}
    if not axes:
        return tuple(sensors), ()
    if None in axes:
        return tuple(sensors), ("x", "y", "z")
    return tuple(sensors), tuple("xyz"[axis] for axis in sorted(axis for axis in axes if axis is not None))


def noisy_places(channels: WhitenedChannels) -> tuple[list[Place], float]:
    """Return the axis, sensor or scalar whose larger noise explains most, with twice the log-likelihood ratio.

    The ratio is that of two variances to one: of the channels that depend on the place, and of the rest.
    """
    counted = channels.is_counted
    total, count = channels.energy, channels.count
    direction, score = channels.row_direction, channels.row_score
    best: tuple[list[Place], float] = ([], 0.0)
    for place, rows in _candidates(channels):
        energy = _energy_along(channels, direction[:, rows], score[:, rows], rows)[counted]
        inside, outside = float(energy.sum()), total - float(energy.sum())
        many = len(rows) * len(energy)
        rest = count - many
        if rest <= NEGLIGIBLE * many or outside <= 0 or inside / many <= outside / rest:
            continue
        gain = count * np.log(total / count) - many * np.log(inside / many) - rest * np.log(outside / rest)
        if gain > best[1]:
            best = place, float(gain)
    return best


def _candidates(channels: WhitenedChannels) -> list[tuple[list[Place], list[int]]]:
    sensors = channels.covariates.sensor_count
    found: list[tuple[list[Place], list[int]]] = []
    for sensor in range(sensors):
        found += [([(sensor, axis)], [3 * sensor + axis]) for axis in range(3)]
        if sensors > 2:
            found.append(([(sensor, None)], [3 * sensor, 3 * sensor + 1, 3 * sensor + 2]))
    if channels.recording.scalar_T is not None:
        found.append(([(SCALAR, None)], [channels.covariates.scalar_row]))
    return found


def _energy_along(channels: WhitenedChannels, direction: FloatArray, score: FloatArray, rows: list[int]) -> FloatArray:
    """Return the energy (N,) of each sample that shifts of some rows can explain."""
    information = np.broadcast_to(
        channels.coupling[np.ix_(rows, rows)], (len(channels.intensity_residual_T), len(rows), len(rows))
    ).copy()
    information += channels.precision[:, None, None] * direction[:, :, None] * direction[:, None, :]
    size = np.sqrt(np.maximum(np.einsum("nii->ni", information), np.finfo(float).tiny))
    scaled = ridged(information / (size[:, :, None] * size[:, None, :]))
    solved = np.linalg.solve(scaled, (score / size)[:, :, None])[:, :, 0]
    return np.asarray(np.sum(solved * score / size, axis=1))


def span_of(channels: WhitenedChannels, excess: FloatArray) -> tuple[float, float] | None:
    """Return the span, s, that holds nearly all energy in excess of noise, where it is a small part of the run.

    Parameters
    ----------
    channels : WhitenedChannels
        Of N samples, with their time stamps.
    excess : (N,) array
        Energy of each sample in excess of that expected of noise alone; 0 where a sample does not count.
    """
    total = np.cumsum(excess)
    if total[-1] <= 0:
        return None
    margin = MINOR / 2
    first = int(np.searchsorted(total, margin * total[-1]))
    last = int(np.searchsorted(total, (1 - margin) * total[-1]))
    time_s = channels.covariates.time_s
    low, high = float(time_s[first]), float(time_s[min(last, len(time_s) - 1)])
    return (low, high) if high - low < MOST * float(np.ptp(time_s)) else None


def band_of(channels: WhitenedChannels, row: int, variance: float) -> tuple[float, float] | None:
    """Return the band, Hz, that holds most power of a row in excess of white noise, where it is not white.

    Parameters
    ----------
    channels : WhitenedChannels
        Of N samples; the median of their time steps gives the frequencies.
    row : int
        Index of the row.
    variance : float
        Of the channels' white noise, over that of the array.
    """
    covariates = channels.covariates
    if covariates.sample_count < 2 * LEAST_SAMPLES:
        return None
    shift = channels.residuals.row_shift_T[:, row] * np.sqrt(channels.residuals.row_information[:, row] / variance)
    power = np.abs(np.fft.rfft(shift)) ** 2 / len(shift)
    frequency = np.fft.rfftfreq(len(shift), covariates.step_s)
    beyond = np.maximum(power[1:] - 1, 0) * (power[1:] > 1 + 3.0)
    if beyond.sum() < NEGLIGIBLE * len(beyond):
        return None
    total = np.cumsum(beyond)
    low = int(np.searchsorted(total, MINOR / 2 * total[-1]))
    high = int(np.searchsorted(total, (1 - MINOR / 2) * total[-1]))
    if high - low > MOST * len(beyond):
        return None
    return float(frequency[1 + low]), float(frequency[1 + high])


def locate(base: Base, causes: list[list[Place]], rivals: Iterable[Evidence], variance: float) -> Where:
    """Return where the gap of a nominal model lies.

    Parameters
    ----------
    base : Base
        The nominal calibration.
    causes : list of list of Place
        Of accepted causes; where there are none, those of the strongest rival without physics are returned.
    rivals : iterable of Evidence
        At the nominal calibration.
    variance : float
        Of the channels' white noise.
    """
    channels = base.channels
    noisy, gain = noisy_places(channels)
    strongest = max(rivals, key=lambda rival: rival.delta_bic, default=None)
    if causes:
        places = [place for cause in causes for place in cause]
    elif strongest is not None and strongest.delta_bic > max(LEAST_EVIDENCE, NOTABLE * gain):
        places = main_places(base, strongest)
    else:
        places = noisy
    sensors, axes = sensors_and_axes(places, channels.recording)
    excess = (channels.energy_per_sample / variance - channels.channels_per_sample) * channels.is_counted
    row = _first_row(places, channels)
    known = channels.is_counted & (channels.precision > 0)
    per_channel = {
        "differential_chi_square": _mean(channels.differential[channels.is_counted] ** 2),
        "common_mode_chi_square": _mean(channels.precision[known] * channels.intensity_residual_T[known] ** 2),
        "two_variances_gain": gain,
    }
    return Where(sensors, axes, span_of(channels, excess), band_of(channels, row, variance), per_channel)


def main_places(base: Base, rival: Evidence) -> list[Place]:
    """Return the place of a rival: the single axis, or the fewest sensors, that explain nearly all of its gain.

    Parameters
    ----------
    base : Base
        Null model, which is eliminated.
    rival : Evidence
        For a function without physics, in the residual of this base.
    """
    assert isinstance(rival.form, Hypothesis)
    terms = rival.form.terms
    columns = columns_of(terms)
    projected = base.project(base.channels.design(terms))
    whole = projected.gain()[0]

    def explained(kept: Iterable[int]) -> float:
        return projected.take(np.concatenate([columns[index] for index in kept])).gain()[0]

    def of_place(*places: Place) -> list[int]:
        return [
            index
            for index, term in enumerate(terms)
            if any(term.sensor == sensor and axis in (None, term.axis) for sensor, axis in places)
        ]

    every = list(dict.fromkeys((term.sensor, term.axis) for term in terms))
    single = max(every, key=lambda place: explained(of_place(place)))
    if explained(of_place(single)) >= (1 - NOTABLE) * whole:
        return [single]
    left: list[Place] = list(dict.fromkeys((sensor, None) for sensor, _ in every))
    chosen: list[Place] = []
    while left:
        best = max(left, key=lambda place: explained(of_place(*chosen, place)))
        chosen.append(best)
        left.remove(best)
        if explained(of_place(*chosen)) >= (1 - NOTABLE) * whole:
            break
    return chosen


def _first_row(places: list[Place], channels: WhitenedChannels) -> int:
    sensor, axis = places[0] if places else (0, 0)
    if sensor == SCALAR:
        return channels.covariates.scalar_row
    return 3 * max(sensor, 0) + (axis or 0)


def _mean(values: FloatArray) -> float:
    """Return the mean, NaN of nothing."""
    return float(np.mean(values)) if values.size else float("nan")
