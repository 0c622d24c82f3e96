"""A scale factor, or the whole response of a sensor, that changes at once."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.polynomial.legendre import legvander

from tam_calibration.effects.change_points import Change, Path, StepEffect, is_on, shape_of, without
from tam_calibration.effects.effect import Covariates, Shape
from tam_calibration.effects.saturation import inside_range
from tam_calibration.effects.spikes import without_spikes
from tam_calibration.effects.term import Coefficient, Term, WhitenedResiduals
from tam_calibration.model.units import FloatArray

_SMOOTHEST = 4
"""Degree of the polynomials of time that are fitted too, so that a slow change is no step."""

_COARSE = 400
"""Times at which a step is searched first."""


_ENOUGH = 16_000
"""Samples of a thinned recording in which the times are searched."""

_SCALE = Coefficient("scale", "1")
_TURNS = tuple(Coefficient(f"turn about {axis}", "rad") for axis in "xyz")


class ScaleStep(StepEffect):
    """The response of a sensor changes at one time, for good or until another time: it reads (M + ΔM) b."""

    name = "scale_step"

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the times at which a step, and a pair of steps, of one axis and of a sensor explain most.

        None where it explains no more than chance beside polynomials of time.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Of the same N samples.
        """
        time = covariates.time_s[:: _thinning(covariates)]
        paths = list(_paths(without_spikes(inside_range(residuals), of_motion=True)))
        found: dict[tuple[int, int], Change] = {}
        for path in paths:
            for change in path.best(-(-len(time) // _COARSE)):
                price = (path.width + 2 * len(change.cuts)) * np.log(len(time)) + 2 * np.log(len(paths))
                kind = path.width, len(change.cuts)
                net = replace(change, gain=change.gain - price)
                found[kind] = max(found.get(kind, net), net, key=lambda one: one.gain)
        sharp = {kind: one for kind, one in found.items() if one.gain > max(found[kind[0], 1].gain * (kind[1] > 1), 0)}
        cuts = dict.fromkeys(change.cuts for change in sharp.values())
        return [shape_of(time, times) for times in cuts]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return from the one time on a scale and a tilt of each axis and a turn of each sensor.

        The axes' scales and tilts together are any change of the response; what changes a scale amplifies the bias too.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``time_s`` of the step and, where it ends, ``end_s``, seconds.
        """
        since = is_on(covariates.time_s, shape)
        field = np.where(since[:, None], covariates.field_T, 0.0)
        matrix = covariates.errors.matrix
        sensed = field @ matrix.reshape(-1, 3).T
        amplified = np.where(since[:, None], sensed + covariates.errors.bias_T.ravel(), 0.0)
        terms = []
        for row in range(covariates.scalar_row):
            sensor, axis = divmod(row, 3)
            others = [other for other in range(3) if other != axis]
            tilts = [Coefficient(f"tilt towards {'xyz'[other]}", "rad") for other in others]
            terms.append(Term.of_row(covariates, row, "scale", [_SCALE], amplified[:, row, None]))
            terms.append(
                Term.of_row(covariates, row, "tilt", tilts, sensed[:, [3 * sensor + other for other in others]])
            )
        for sensor in range(covariates.sensor_count):
            turned = np.stack([np.cross(axis, field) @ matrix[sensor].T for axis in np.eye(3)], axis=2)
            rows, columns = np.divmod(np.arange(9), 3)
            terms.append(Term(sensor, None, "turn", _TURNS, turned.reshape(-1, 9), 3 * sensor + rows, columns))
        return terms


def _thinning(covariates: Covariates) -> int:
    """Return the distance of the samples among which the times are sought."""
    return -(-covariates.sample_count // _ENOUGH)


def _paths(residuals: WhitenedResiduals) -> Iterator[Path]:
    """Yield the path of a step of each axis' scale, then of each sensor's response, beside slow changes of them.

    Residuals are scaled to unit variance, whatever it is that they hold.
    """
    every, whole = slice(None, None, _thinning(residuals.covariates)), residuals.covariates
    covariates, counted = whole.take(every), residuals.is_counted[every]
    variance = residuals.energy[every][counted].sum() / max(residuals.channel_count[every][counted].sum(), 1)
    scale = 1 / np.sqrt(max(float(variance), np.finfo(float).tiny))
    direction = covariates.field_T / covariates.intensity_T[:, None] * counted[:, None]
    sensed = covariates.sensed_T / np.median(covariates.intensity_T) * counted[:, None]
    phase = 2 * (covariates.time_s - covariates.time_s[0]) / np.ptp(covariates.time_s) - 1
    slow = legvander(phase, _SMOOTHEST)
    own = np.where(counted[:, None], scale * residuals.differential[every], 0)
    own, held = without(own, _products(slow, np.column_stack([counted, direction])))
    has_reference = counted & np.isfinite(residuals.common_mode[every])
    slope = np.where(has_reference[:, None], residuals.row_slope[every], 0)
    first, second = np.triu_indices(3)
    functions = np.column_stack([direction, direction[:, first] * direction[:, second]]) * slope[:, -1:]
    common = np.where(has_reference, scale * residuals.common_mode[every], 0)[:, None]
    common, held_in_common = without(common, _products(slow, functions))
    for row, along in enumerate(residuals.directions):
        size = max(float(np.sqrt(along @ along)), np.finfo(float).tiny)
        between = Path.of(own @ along[:, None] / size, held, size * sensed[:, row, None])
        yield between.beside(Path.of(common, held_in_common, slope[:, row, None] * sensed[:, row, None]))
    for sensor in range(covariates.sensor_count if own.shape[1] else 0):
        within = np.linalg.svd(residuals.directions[3 * sensor : 3 * sensor + 3], full_matrices=False)[2]
        yield Path.of(own @ within.T, held, direction)


def _products(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return the products (N, P Q) of every function of (N, P) with every one of (N, Q)."""
    return (left[:, :, None] * right[:, None, :]).reshape(len(left), -1)
