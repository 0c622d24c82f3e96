"""Noise excess: an axis, a sensor or the scalar magnetometer that is noisier than the others.

Noise is what has no regular cause: an excess that is smooth in time, stands in a line of the spectrum, follows the
direction of the field or comes as spikes is left to other effects. White excess counts, also where it comes and goes,
and so does the 1/f noise of a sensor up to a slope of about 0.9: neighbouring samples are alike by less than 0.75.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from tam_calibration.effects.effect import ALL, Contribution, Finding, FittedEffect, FoundEffect, Misfit, Situation
from tam_calibration.effects.excess_variance import Excess, Moments, best_excess
from tam_calibration.effects.places import row_deviations, rows_of
from tam_calibration.effects.quantization import find_lattices
from tam_calibration.effects.saturation import inside_range
from tam_calibration.effects.spikes import without_spikes
from tam_calibration.units import FloatArray

_ALIKE = 0.75
"""Mean correlation of the excess with the next three samples from which on it is no noise but a course in time."""

_ALIKE_EVERYWHERE = 0.2
"""The same where all sensors have it, which may as well be anything that the site does."""

_LINE = 0.4
"""Part of the excess within a fortieth of the band from which on it is a line."""

_DIRECTED = 0.35
"""Correlation of the excess at neighbouring directions, far in time, from which on it follows the direction."""

_SIZE_DIRECTED, _SIZE_OF_RATE = 0.2, 0.08
"""Part of the variance of the squared excess that the field's direction, or its change, tells of what is no noise."""

_SHARED_SCALE = 0.15
"""Part of the excess that neighbours foretell as a scale factor, beyond an offset, from which on it is no noise."""

_SPAN, _RIDGE = 8, 0.3
"""Neighbouring samples on either side, and what keeps their regressions from following noise."""

_LARGEST_SHARED = 1.2
"""Noise of all sensors alike, in what the data sheet states, up to which the sheet is merely wrong."""

_CERTAIN = 3.0
"""Standard errors by which either must differ from that of white noise."""

_NEIGHBOURS = 16
_MOST_NEIGHBOURS = 20_000

_HEAVY = 3.0
"""Excess kurtosis, with the variance of the surroundings taken out, from which on it is spikes."""

_FLAT = -0.6
"""The same from which downwards it goes to and fro between few values."""

_LEAST_SAMPLES = 30
_BLOCK = 50
_BANDS = 40


class NoiseExcess(FoundEffect):
    """More noise in some rows than in the others."""

    name = "noise_excess"
    title = "more noise than the others have"
    physics = (
        "The noise of an axis, a sensor or the scalar magnetometer exceeds that of the others: electronics, contacts, "
        "1/f noise of the core (Ripka 2001, Magnetic Sensors and Magnetometers)."
    )
    excitation = "a record of some dozens of samples"
    units: ClassVar[Mapping[str, str]] = {"standard deviation": "T"}

    def find(self, misfit: Misfit) -> Finding | str:
        """Return the rows with more noise and how much, or why there is none."""
        if misfit.is_counted.sum() < _LEAST_SAMPLES:
            return f"a variance needs {_LEAST_SAMPLES} samples or more"
        misfit = without_spikes(inside_range(misfit))
        moments = Moments.of(misfit)
        excess = best_excess(moments, misfit.situation)
        if excess is None:
            return self._shared(misfit)
        variance = np.zeros(moments.row_count)
        variance[list(excess.place.rows)] = excess.variance_T2
        objection = "the readings are whole steps" if _is_rounding(misfit, variance) else _objection(misfit, excess)
        if objection is not None:
            return objection
        return Finding(
            FittedEffect(self.name, {}, _contributions(moments, excess)),
            gain=excess.gain,
            parameter_count=excess.parameter_count,
            variance=variance,
        )

    def _shared(self, misfit: Misfit) -> Finding | str:
        """Return the noise of all sensors beyond what a data sheet may be wrong by, or that there is none."""
        counted, noise_T = misfit.is_counted, misfit.situation.array.vector_noise_T
        count = float(misfit.channel_count[counted].sum())
        variance = float(misfit.energy[counted].sum()) / count
        if variance <= _LARGEST_SHARED**2 or noise_T is None:
            return "no row is noisier than the others, spikes and readings at the end of the range left out"
        deviations = row_deviations(misfit)[counted]
        surplus, chance = variance - 1, _CERTAIN * variance / float(np.sqrt(len(deviations)))
        if any(_alike(deviation) > max(_ALIKE_EVERYWHERE * surplus, chance) for deviation in deviations.T):
            return "the excess follows a course in time"
        shared = np.append(surplus * np.repeat(noise_T**2, 3), 0.0)
        if _is_rounding(misfit, shared):
            return "the readings are whole steps"
        beyond = variance / _LARGEST_SHARED**2
        size = float(np.sqrt(surplus * np.mean(noise_T**2)))
        error = size * variance / surplus / float(np.sqrt(2 * count))
        values, errors = {"standard deviation": size}, {"standard deviation": error}
        return Finding(
            FittedEffect(self.name, {}, (Contribution(ALL, None, "noise", values, errors),)),
            gain=count * (beyond - 1 - float(np.log(beyond))),
            parameter_count=1,
            variance=shared,
        )

    def add(
        self, rows_T: FloatArray, situation: Situation, fitted: FittedEffect, generator: np.random.Generator
    ) -> FloatArray:
        """Return simulated rows (N, 3K + 1) with the effect in them, tesla."""
        rows = rows_T.copy()
        for part in fitted.contributions:
            touched = rows_of(part, situation)
            size = part.values["standard deviation"]
            rows[:, touched] += generator.normal(0, size, (situation.sample_count, len(touched)))
        return rows


def _objection(misfit: Misfit, excess: Excess) -> str | None:
    """Return what speaks against noise as the cause of an excess, in one clause."""
    counted = misfit.is_counted
    row = excess.place.rows[int(np.argmax(excess.part))]
    deviation = row_deviations(misfit)[counted, row]
    variance = float(np.mean(deviation**2))
    surplus = max(variance - excess.floor, 1e-3 * variance)
    chance = _CERTAIN * variance / float(np.sqrt(len(deviation)))
    if _alike(deviation) > max(_ALIKE * surplus, chance):
        return "the excess follows a course in time"
    if _line_part(deviation, excess.floor) > _LINE:
        return "the excess stands in a line of the spectrum"
    direction = (misfit.situation.field_T / misfit.situation.intensity_T[:, None])[counted]
    if _directed(deviation, direction) > max(_DIRECTED * surplus, chance):
        return "the excess follows the direction of the field"
    squares = np.column_stack([direction**2, direction * np.roll(direction, 1, axis=1)])
    if _told(deviation**2, squares) > _SIZE_DIRECTED:
        return "the size of the excess follows the direction of the field"
    changes = [
        np.gradient(direction, axis=0),
        np.diff(direction, 2, axis=0, prepend=direction[:1], append=direction[-1:]),
    ]
    rates = np.column_stack([np.ones(len(direction)), *(np.sum(change**2, axis=1) for change in changes)])
    if _told(deviation**2, rates) > _SIZE_OF_RATE:
        return "the size of the excess follows the rate of the field"
    if _foretold(deviation, direction) - _foretold(deviation, direction[:, :0]) > _SHARED_SCALE:
        return "neighbouring samples share a scale factor"
    kurtosis = _kurtosis(deviation)
    if kurtosis > _HEAVY:
        return "the excess comes as spikes"
    if kurtosis < min(_FLAT, -_CERTAIN * float(np.sqrt(24 / len(deviation)))):
        return "the excess goes between few values"
    return None


def _is_rounding(misfit: Misfit, variance_T2: FloatArray) -> bool:
    """Return whether half of the variance beyond the floor (3K + 1,) is what rounding to whole steps makes."""
    rounding = np.zeros(len(variance_T2))
    for lattice in find_lattices(misfit):
        rounding[lattice.row] = lattice.step_T**2 / 12
    return bool(np.sum(np.minimum(rounding, variance_T2)) > np.sum(variance_T2) / 2)


def _alike(deviation: FloatArray) -> float:
    """Return the mean covariance with the next three samples."""
    return float(np.mean([np.mean(deviation[lag:] * deviation[:-lag]) for lag in (1, 2, 3)]))


def _line_part(deviation: FloatArray, floor: float) -> float:
    """Return the largest part of the excess within a fortieth of the band, its lowest tenth left out."""
    power = np.abs(np.fft.rfft(deviation)[1:]) ** 2 / len(deviation) - floor
    if len(power) < 2 * _BANDS:
        return 0.0
    bands = np.array([band.sum() for band in np.array_split(power, _BANDS)])
    return float(bands[_BANDS // 10 :].max() / max(bands.sum(), np.finfo(float).tiny))


def _directed(deviation: FloatArray, direction: FloatArray) -> float:
    """Return the covariance of samples with the one at the nearest direction that is far off in time."""
    from scipy.spatial import cKDTree

    every = max(1, len(deviation) // _MOST_NEIGHBOURS)
    chosen, values = direction[::every], deviation[::every]
    count = min(_NEIGHBOURS, len(values) - 1)
    _, near = cKDTree(chosen).query(chosen, count + 1)
    is_far = np.abs(near - np.arange(len(values))[:, None]) > len(values) / 20
    found = is_far.any(axis=1)
    nearest = near[np.arange(len(values)), np.argmax(is_far, axis=1)]
    products = (values * values[nearest])[found]
    return float(np.mean(products)) if len(products) > _LEAST_SAMPLES else 0.0


def _told(values: FloatArray, functions: FloatArray) -> float:
    """Return the part of the variance of values (N,) that functions (N, P) tell, adjusted for their number."""
    left = values - functions @ np.linalg.lstsq(functions, values)[0]
    free = len(values) - functions.shape[1]
    return float(1 - np.var(left) * len(values) / (free * max(np.var(values), np.finfo(float).tiny)))


def _foretold(deviation: FloatArray, direction: FloatArray) -> float:
    """Return the part of the variance that regressions of the samples around each one on the direction foretell."""
    functions = np.column_stack([np.ones(len(direction)), direction])
    products = functions[:, :, None] * np.column_stack([functions, deviation])[:, None, :]
    total = np.cumsum(np.pad(products, ((_SPAN + 1, _SPAN), (0, 0), (0, 0))), axis=0)
    around = total[2 * _SPAN + 1 :] - total[: -2 * _SPAN - 1] - products
    squares = around[:, :, :-1] + _RIDGE * np.eye(functions.shape[1])
    foretold = np.einsum("nj,nj->n", functions, np.linalg.solve(squares, around[:, :, -1:])[:, :, 0])
    covariance = np.cov(foretold, deviation)
    return float(max(covariance[0, 1], 0) ** 2 / max(covariance[0, 0] * covariance[1, 1], np.finfo(float).tiny))


def _kurtosis(deviation: FloatArray) -> float:
    """Return the excess kurtosis within blocks of samples, so that a noise that comes and goes has none."""
    blocks = max(1, len(deviation) // _BLOCK)
    square = deviation[: len(deviation) // blocks * blocks].reshape(blocks, -1) ** 2
    ratio = np.mean(square**2, axis=1) / np.maximum(np.mean(square, axis=1) ** 2, np.finfo(float).tiny)
    return float(np.mean(ratio)) - 3.0


def _contributions(moments: Moments, excess: Excess) -> tuple[Contribution, ...]:
    deviation = np.sqrt(excess.variance_T2)
    errors = deviation * moments.relative_error(excess) / 2
    parts = []
    for index, (sensor, axis) in enumerate(excess.place.contribution_keys(is_whole=np.ptp(deviation) == 0)):
        value, error = {"standard deviation": float(deviation[index])}, {"standard deviation": float(errors[index])}
        parts.append(Contribution(sensor, axis, "noise", value, error))
    return tuple(parts)
