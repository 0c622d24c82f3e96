"""Noise excess: an axis, a sensor or the scalar magnetometer that is noisier than the others.

Noise is what has no regular cause: an excess that is smooth in time, stands in a line of the spectrum, follows the
direction of the field or comes as spikes is left to other effects. White excess counts, also where it comes and goes,
and so does the 1/f noise of a sensor up to a slope of about 0.9: neighbouring samples are alike by less than 0.75.
"""

from dataclasses import replace

import numpy as np

from tam_calibration.effects.effect import ALL, Contribution, Covariates, Finding, FittedEffect, FoundEffect
from tam_calibration.effects.excess_variance import LARGEST_NOISE, ChannelMoments, Excess, best_excess
from tam_calibration.effects.grades import CERTAIN, LEAST_SAMPLES, NOTABLE
from tam_calibration.effects.quantization import find_lattices
from tam_calibration.effects.regularity import neighbour_covariance, objection_to
from tam_calibration.effects.saturation import inside_range
from tam_calibration.effects.spikes import without_spikes
from tam_calibration.effects.term import WhitenedResiduals, row_deviations
from tam_calibration.model.fitted_effect import SCALAR
from tam_calibration.model.units import FloatArray

_OF_AXIS, _OF_SCALAR = 4, 9
"""Numbers of the calibration that are fitted to the noise of an axis, and to that of the intensity: an ellipsoid."""


class NoiseExcess(FoundEffect):
    """More noise in some rows than in the others."""

    name = "noise_excess"

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the rows with more noise and how much, or why there is none."""
        residuals = without_spikes(inside_range(residuals))
        if residuals.is_counted.sum() < LEAST_SAMPLES:
            return f"a variance needs {LEAST_SAMPLES} samples or more, spikes and the end of the range left out"
        moments = ChannelMoments.of(residuals)
        excess = best_excess(moments, residuals.covariates)
        if excess is None:
            return self._shared(residuals)
        spent = _OF_SCALAR if excess.place.sensor == SCALAR else _OF_AXIS
        count = moments.sample_count
        excess = replace(excess, part=excess.part * count / max(count - spent, 1))
        variance = np.zeros(moments.row_count)
        variance[list(excess.place.rows)] = excess.variance_T2
        objection = (
            "the readings are whole steps" if _is_rounding(residuals, variance) else objection_to(residuals, excess)
        )
        if objection is not None:
            return objection
        return Finding(
            FittedEffect(self.name, {}, _contributions(moments, excess)),
            gain=excess.gain,
            parameter_count=excess.parameter_count,
            variance=variance,
        )

    def _shared(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the noise of all sensors beyond what a data sheet may be wrong by, or that there is none."""
        counted, noise_T = residuals.is_counted, residuals.covariates.array.vector_noise_T
        count = float(residuals.channel_count[counted].sum())
        variance = float(residuals.energy[counted].sum()) / count
        if variance <= LARGEST_NOISE**2 or noise_T is None:
            return "no row is noisier than the others, spikes and readings at the end of the range left out"
        deviations = row_deviations(residuals)[counted]
        surplus, chance = variance - 1, CERTAIN * variance / float(np.sqrt(len(deviations)))
        if any(neighbour_covariance(deviation) > max(NOTABLE * surplus, chance) for deviation in deviations.T):
            return "the excess follows a course in time"
        shared = np.append(surplus * np.repeat(noise_T**2, 3), 0.0)
        if _is_rounding(residuals, shared):
            return "the readings are whole steps"
        beyond = variance / LARGEST_NOISE**2
        size = float(np.sqrt(surplus * np.mean(noise_T**2)))
        error = size * variance / surplus / float(np.sqrt(2 * count))
        values, errors = {"standard deviation": size}, {"standard deviation": error}
        return Finding(
            FittedEffect(self.name, {}, (Contribution(ALL, None, "noise", values, errors),)),
            gain=count * (beyond - 1 - float(np.log(beyond))),
            parameter_count=1,
            variance=shared,
        )

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: np.random.Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        return rows_T + source.normal(0, part.values["standard deviation"], rows_T.shape)


def _is_rounding(residuals: WhitenedResiduals, variance_T2: FloatArray) -> bool:
    """Return whether half of the variance beyond the floor (3K + 1,) is what rounding to whole steps makes."""
    rounding = np.zeros(len(variance_T2))
    for lattice in find_lattices(residuals):
        rounding[lattice.row] = lattice.step_T**2 / 12
    return bool(np.sum(np.minimum(rounding, variance_T2)) > np.sum(variance_T2) / 2)


def _contributions(moments: ChannelMoments, excess: Excess) -> tuple[Contribution, ...]:
    deviation = np.sqrt(excess.variance_T2)
    errors = deviation * moments.relative_error(excess) / 2
    parts = []
    for index, (sensor, axis) in enumerate(excess.place.contribution_keys(is_whole=np.ptp(deviation) == 0)):
        value, error = {"standard deviation": float(deviation[index])}, {"standard deviation": float(errors[index])}
        parts.append(Contribution(sensor, axis, "noise", value, error))
    return tuple(parts)
