"""Effects of the converter: readings that are whole steps (quantization), or stay at an end of the range (saturation).

What lies beyond the range of a converter or amplifier is read as its end. Readings then repeat at the largest or
smallest value, where the other sensors say that the axis should have read more (IEEE Std 1241-2010, Terminology and
Test Methods for Analog-to-Digital Converters, on overload).

Quantized readings of a row differ by multiples of a step. The step is sought as a frequency at which the differences
between readings of nearly the same size have one phase: |mean exp(2πi f d)| is 1 at f = 1/step and its multiples, and
some 1/√M elsewhere. What the decimals of a file make is a lattice as well; it is left aside where its rounding is no
visible part of the noise. Rounding adds the variance step²/12 (Bennett 1948, Spectra of Quantized Signals).

The lattice is a fact of the readings that no chance makes (a probability of (2j/step)^N for readings that lie within j
of it), whatever else is in the residual. It therefore needs no evidence from the residual, but says how much of its
energy is rounding: e = Σ step²/12 times the information of each row. The gain n ln(S0/(S0 - e)) is that of a
regression that explains the same energy, and so comparable with it; a noise of free variance gains less. Where the
residual is not as large as rounding would make it, the stated noise holds it already and nothing is found.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tam_calibration.core.noise import noise_deviation
from tam_calibration.effects.effect import Covariates, Finding, FoundEffect
from tam_calibration.effects.grades import CERTAIN, FEWEST, LEAST_SAMPLES, MINOR, MOST, NEGLIGIBLE, NOTABLE
from tam_calibration.effects.residuals import WhitenedResiduals
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class _Limit:
    row: int
    end: str
    value_T: float
    standard_error_T: float
    samples: NDArray[np.intp]


class Saturation(FoundEffect):
    """An axis that reads the end of its range where the field lies beyond."""

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the limits, and as flagged the samples at them, or why there is none."""
        limits = find_limits(residuals)
        if not limits:
            return "no axis stays at its largest or smallest reading where the others say that it should read more"
        flagged = np.zeros(len(residuals.energy), dtype=bool)
        flagged[np.concatenate([limit.samples for limit in limits])] = True
        saved = sum(float(np.sum(residuals.row_deviations[one.samples, one.row] ** 2 - 1)) for one in limits)
        return self.of_samples(_of_limits(limits), residuals, flagged, saved, 2 * len(limits))

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        return np.clip(rows_T, part.values.get("lower limit", -np.inf), part.values.get("upper limit", np.inf))


def find_limits(residuals: WhitenedResiduals) -> list[_Limit]:
    """Return the limits at which axes stay, at the upper and the lower end."""
    readings = residuals.recording.readings_T.reshape(len(residuals.energy), -1)
    told = [_limit_of(residuals, row, sign, own) for row, own in enumerate(readings.T) for sign in (1.0, -1.0)]
    return [limit for limit in told if limit is not None]


def _limit_of(residuals: WhitenedResiduals, row: int, sign: float, reading: FloatArray) -> _Limit | None:
    """Return the limit at one end of a row: where readings repeat, or where they pile up within their noise."""
    information = residuals.row_information[:, row]
    if not (information > 0).any():
        return None
    noise = 1 / np.sqrt(float(np.mean(information[information > 0])))
    outward = sign * reading
    top = float(outward.max())
    at_limit = np.flatnonzero(outward == top)
    inner = outward[outward < top]
    # On a coarse lattice of readings the next step down holds about as many.
    next_count = int(np.sum(inner == inner.max())) if len(inner) else 0
    is_repeated = len(at_limit) > 3 * (next_count - 1)
    if len(at_limit) == 1 or not is_repeated:
        piled = _pile(outward, sign * residuals.row_shift_T[:, row], noise)
        at_limit = piled if len(piled) or not is_repeated else at_limit
    if len(at_limit) < 2:
        return None
    deviations = residuals.row_deviations[:, row]
    excess = -sign * np.sum(deviations[at_limit]) / (CERTAIN * np.sqrt(len(at_limit)))
    if not excess > max(1.0, float(noise_deviation(deviations))):
        return None
    spread = float(np.std(outward[at_limit]))
    end = "upper limit" if sign > 0 else "lower limit"
    return _Limit(row, end, sign * float(np.mean(outward[at_limit])), spread / np.sqrt(len(at_limit)), at_limit)


def _pile(outward: FloatArray, shift: FloatArray, noise: float) -> NDArray[np.intp]:
    """Return the readings that stay within their noise of one value although they should differ, none if so."""
    expected = outward - shift
    order = np.argsort(expected)[::-1]
    count = np.arange(1, len(order) + 1)
    depth = outward[order] - outward.max()
    scatter = np.cumsum(depth**2) / count - (np.cumsum(depth) / count) ** 2
    lost = np.cumsum(shift[order] ** 2)
    # Energy explained by a constant instead of the expected reading, for the k largest expected readings.
    best = int(np.argmax(lost - count * np.maximum(scatter, 0)))
    chosen = order[: best + 1]
    if len(chosen) < FEWEST:
        return chosen[:0]
    should, did = expected[chosen] - expected[chosen].mean(), outward[chosen] - outward[chosen].mean()
    is_flat = should @ should > len(chosen) * (3 * noise) ** 2 and abs(should @ did) < NOTABLE * (should @ should)
    return chosen if is_flat and np.std(did) < 2 * noise else chosen[:0]


def _of_limits(limits: list[_Limit]) -> Iterator[Contribution]:
    for row, of_row in groupby(limits, key=lambda limit: limit.row):
        ends = {limit.end: (limit.value_T, limit.standard_error_T) for limit in of_row}
        values, errors = ({end: both[index] for end, both in ends.items()} for index in (0, 1))
        sensor, axis = divmod(row, 3)
        yield Contribution(sensor, axis, "limit", values, errors)


_DISTANCE = 500.0
"""Typical difference of the readings compared, in standard deviations of a row's noise."""


@dataclass(frozen=True)
class Lattice:
    """Step and offset of the readings of a row, tesla."""

    row: int
    step_T: float
    offset_T: float


class Quantization(FoundEffect):
    """Readings rounded to coarse steps."""

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the steps, or why rounding is no visible part of the noise."""
        lattices = find_lattices(residuals)
        if not lattices:
            return "no readings are multiples of a step that is large beside the noise"
        counted = residuals.is_counted
        information = residuals.row_information[counted]
        square = np.mean(residuals.row_deviations[counted] ** 2, axis=0)
        lattices = _visible(lattices, square, information.mean(axis=0), int(counted.sum()))
        if not lattices:
            return "readings are multiples of a step, but the stated noise already holds its rounding"
        variance = np.zeros(information.shape[1])
        variance[[one.row for one in lattices]] = [one.step_T**2 / 12 for one in lattices]
        energy, count = float(residuals.energy[counted].sum()), float(residuals.channel_count[counted].sum())
        rounding = min(float((information @ variance).sum()), max(energy - MOST * count, 0.0))
        if rounding < MINOR * (energy - count):
            return "rounding to the steps of the readings is a small part of the gap"
        gain = count * float(np.log(energy / (energy - rounding)))
        parts = _of_lattices(lattices, residuals.covariates.sensor_count)
        return self.found(parts, gain, len(_by_step(lattices)), variance=variance)

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        step, offset = part.values["step"], part.values.get("offset", 0.0)
        return np.round((rows_T - offset) / step) * step + offset


def find_lattices(residuals: WhitenedResiduals) -> list[Lattice]:
    """Return the lattices of all rows whose readings lie on one that is coarse beside the noise."""
    recording = residuals.recording
    columns = list(recording.readings_T.reshape(recording.sample_count, -1).T)
    if recording.scalar_T is not None:
        columns.append(recording.scalar_T[np.isfinite(recording.scalar_T)])
    noise = _row_noise(residuals).tolist()
    told = [_lattice(row, own, noise[row]) for row, own in enumerate(columns) if np.isfinite(noise[row])]
    return [lattice for lattice in told if lattice is not None]


def _row_noise(residuals: WhitenedResiduals) -> FloatArray:
    """Return the stated noise of each row, tesla; infinite where nothing shows it."""
    stated = residuals.covariates.array.vector_noise_T
    shown = np.median(residuals.row_information, axis=0)
    noise: FloatArray = np.divide(1, np.sqrt(shown), out=np.full(len(shown), np.inf), where=shown > 0)
    if stated is not None:
        noise[:-1] = np.where(shown[:-1] > 0, np.repeat(stated, 3), np.inf)
    return noise


def _lattice(row: int, readings: FloatArray, noise_T: float) -> Lattice | None:
    ordered = np.sort(readings - readings.min()) / noise_T
    frequency = _frequency(ordered)
    if frequency is None:
        return None
    # Differences fix the frequency to a part of one over their size; the whole range fixes it finer, by steps.
    reach = 4 * _DISTANCE
    step = _adjusted(ordered[ordered <= reach], 1 / frequency)
    while reach < ordered[-1]:
        reach *= 4
        step = _adjusted(ordered[ordered <= reach], step)
    phase = np.angle(np.mean(np.exp(2j * np.pi * ordered / step))) / (2 * np.pi)
    distance = ordered / step - phase
    distance = (distance - np.round(distance)) * step
    # Readings off a lattice have a uniform error, or that of their noise where values repeat.
    if np.sqrt(np.mean(distance**2)) > MINOR * min(step / np.sqrt(12), 1.0):
        return None
    step_T = float(step * noise_T)
    offset = float(readings.min() + phase * step_T)
    return Lattice(row, step_T, offset - step_T * round(offset / step_T))


def _adjusted(ordered: FloatArray, step: float) -> float:
    """Return the step that fits the multiples best, starting from one that errs by less than half a step in all."""
    if len(ordered) < 3 or ordered[-1] < step:
        return step
    unwound = ordered / step
    phase = np.angle(np.mean(np.exp(2j * np.pi * (unwound - np.round(unwound))))) / (2 * np.pi)
    number = np.round(unwound - phase)
    centered = number - number.mean()
    return float(centered @ ordered / (centered @ centered)) if centered.any() else step


def _frequency(ordered: FloatArray) -> float | None:
    """Return the lowest frequency at which differences of the readings agree in phase, per standard deviation."""
    gaps = np.diff(ordered)
    gaps = gaps[gaps > 0]
    # Rounding to a step below half of the noise makes less than 2 % of its variance: it is not searched.
    if 0 < len(gaps) < (1 - NOTABLE) * len(ordered):
        return 1 / float(gaps.min()) if gaps.min() >= MOST else None
    lag = max(1, int(len(ordered) * _DISTANCE / max(ordered[-1], _DISTANCE)))
    difference = ordered[lag:] - ordered[:-lag]
    if len(difference) < LEAST_SAMPLES:
        return None
    difference = np.sort(difference)
    near = int(np.searchsorted(difference, 4 * _DISTANCE))
    difference = difference[: max(near, len(difference) // 2, LEAST_SAMPLES)]
    # More than 2000 differences would not determine their phases better.
    difference = difference[:: max(1, len(difference) // 2000)]
    # Eight cells of the histogram to the finest step.
    cell = MOST / 8
    histogram = np.bincount((difference / cell + 0.5).astype(np.intp))
    length = 2 ** int(np.ceil(np.log2(2 * len(histogram))))
    coherence = np.abs(np.fft.rfft(histogram, length)) / len(difference)
    frequency = np.arange(len(coherence)) / (length * cell)
    spread = float(np.std(difference))
    sought = (frequency > 4 / max(spread, np.finfo(float).tiny)) & (frequency <= 1 / MOST)
    strong = np.flatnonzero(sought & (coherence > MOST))
    if not len(strong):
        return None
    # The first strong frequency with all that belong to its peak.
    peak = strong[: 1 + int(np.argmax(np.append(np.diff(strong) > 1, True)))]
    return float(frequency[peak[np.argmax(coherence[peak])]])


def _by_step(lattices: list[Lattice]) -> list[list[Lattice]]:
    """Return the lattices in groups of the same step."""
    groups: list[list[Lattice]] = []
    for lattice in sorted(lattices, key=lambda lattice: lattice.step_T):
        if groups and lattice.step_T < groups[-1][0].step_T * (1 + NEGLIGIBLE):
            groups[-1].append(lattice)
        else:
            groups.append([lattice])
    return groups


def _visible(lattices: list[Lattice], square: FloatArray, information: FloatArray, sample_count: int) -> list[Lattice]:
    """Return the lattices whose rows' residuals, of given mean square, are as large as the rounding makes them."""
    fine = np.setdiff1d(np.flatnonzero(information > 0), [lattice.row for lattice in lattices])
    floor = min(1.0, float(np.median(square[fine]))) if len(fine) else 1.0
    kept = []
    for group in _by_step(lattices):
        rows = [lattice.row for lattice in group]
        rounding = float(information[rows].sum()) * group[0].step_T ** 2 / 12
        surplus = float((square[rows] - floor).sum())
        chance = CERTAIN * float(np.sqrt(2 * np.sum(square[rows] ** 2) / sample_count))
        if surplus > max(MOST * rounding, chance):
            kept += group
    return sorted(kept, key=lambda lattice: lattice.row)


def _of_lattices(lattices: list[Lattice], sensor_count: int) -> list[Contribution]:
    """Return the one step of all sensors where they share it, and the steps of the other rows."""
    scalar, steps = 3 * sensor_count, [lattice.step_T for lattice in lattices]
    have_all = sensor_count > 1 and {lattice.row for lattice in lattices}.issuperset(range(scalar))
    parts = []
    if have_all and np.ptp(np.log(steps[:scalar])) < NEGLIGIBLE:
        parts = [Contribution(ALL, None, "lattice", {"step": float(np.median(steps))})]
        lattices = lattices[scalar:]
    for one in lattices:
        sensor, axis = (SCALAR, None) if one.row == scalar else divmod(one.row, 3)
        parts.append(Contribution(sensor, axis, "lattice", {"step": one.step_T, "offset": one.offset_T}))
    return parts
