"""Uncertainty of calibration and effects that are fitted together, from the residual as it is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tam_calibration.correction.calibration import Calibration, EffectSize
from tam_calibration.effects.removal import on_sensors
from tam_calibration.effects.term import Coefficient, Term, at_rows
from tam_calibration.fit.scale import free_scale
from tam_calibration.gap.coloured import covariance_of
from tam_calibration.gap.model import Model, Part
from tam_calibration.gap.nominal import stepped
from tam_calibration.gap.regression import Base, pseudo_inverse
from tam_calibration.gap.regressors import Regressors
from tam_calibration.gap.selection import columns_of
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.fitted_effect import ALL, FittedEffect, Shape
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_STEP = 0.01
"""Step of a parameter of the shape for numerical derivatives, as a part of its value."""

_ROUNDING = 1e-9
"""Part of what an effect adds below which a step of its shape changes nothing: rounding is 1e-15 of it, and a step that
tells anything of a parameter changes more than 1e-6."""

_FIRST_TURN = slice(9, 12)
"""Misalignment of the first sensor, which is zero."""

_SAMPLES = 2000
"""Samples, spread over the recording, over which the uncertainty of an effect's signal is averaged."""


@dataclass(frozen=True, eq=False)
class Joint:
    """The parameters of calibration and effects at the end of their fit.

    Parameters
    ----------
    model : Model
        With the array, the errors and the intensity of the calibration.
    free : tuple of tuple of str
        Parameters of the shape of each effect that were fitted.
    """

    model: Model
    free: tuple[tuple[str, ...], ...]

    @cached_property
    def effects(self) -> tuple[FittedEffect, ...]:
        """The effects with values and standard errors."""
        effects, start = [], 0
        for part, terms, names in zip(self.model.parts, self._terms, self.free, strict=True):
            end = start + len(part.values)
            fitted = part.fitted(terms, self._covariance[start:end, start:end])
            variance = np.diag(self._covariance)[end : end + len(names)]
            known = {name: float(np.sqrt(value)) for name, value in zip(names, variance, strict=True) if value > 0}
            effects.append(replace(fitted, shape_errors=known))
            start = end + len(names)
        return tuple(effects)

    def shared_covariance(self, errors: SensorErrors, has_scalar: bool) -> FloatArray:
        """Return what the effects' uncertainty adds to the covariance (12 K, 12 K) of errors in the first's frame.

        Parameters
        ----------
        errors : SensorErrors
            Of K sensors, in the frame of the first.
        has_scalar : bool
            Whether a scalar reference determines the common scale; else the geometric mean of the determinants is 1.
        """
        if not self.model.parts:
            return np.zeros((errors.to_vector().size,) * 2)
        shift = pseudo_inverse(self._nominal.information) @ self._channels.cross(self._nominal.designs[0], self._design)
        return self._of_errors(errors, has_scalar, -shift, self._covariance)

    def covariance_in_world(self) -> FloatArray:
        """Return the covariance (12 K, 12 K) of the errors in the field of the world, the effects taken as known.

        It is scaled by the residual, as nobody states the noise of an attitude.
        """
        base = self.model.base()
        factor = base.energy / max(base.channels.count - base.rank, 1.0)
        own = self._nominal.inverse
        return self._of_errors(self.model.errors, False, np.eye(len(own)), factor * own)

    def _of_errors(
        self, errors: SensorErrors, has_scalar: bool, shift: FloatArray, covariance: FloatArray
    ) -> FloatArray:
        """Return the covariance of the errors from that of P coefficients, whose units shift the design of them."""
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0))
        columns = [
            (self._moved(errors, has_scalar, step) - self._moved(errors, has_scalar, -step)) / 2
            for step in (shift * deviation).T
        ]
        slope = np.column_stack(columns)
        slope[_FIRST_TURN] = 0
        correlation = covariance / np.outer(*[np.where(deviation > 0, deviation, 1)] * 2)
        by_parameter: FloatArray = slope @ correlation @ slope.T
        return by_parameter

    def _moved(self, errors: SensorErrors, has_scalar: bool, step: FloatArray) -> FloatArray:
        """Return the flattened parameters of errors after a step of their design."""
        unit = float(np.mean(self._channels.covariates.intensity_T))
        if self.model.world is not None:
            return self.model.world.stepped(errors, step, unit)[0].to_vector().ravel()
        moved = stepped(errors, step, unit)
        if not has_scalar:
            moved = SensorErrors.from_matrix(free_scale(moved.matrix) * moved.matrix, moved.bias_T, errors.orientation)
        return moved.to_vector().ravel()

    def sizes(self, calibration: Calibration) -> tuple[EffectSize, ...]:
        """Return the size of each effect in the outputs of a calibration, and its standard error."""
        unmix = calibration.correction_matrix
        some = slice(None, None, -(-self.model.recording.sample_count // _SAMPLES))
        sizes, start = [], 0
        for part, terms, all_terms, fitted in zip(
            self.model.parts, self._terms, self._all_terms, self.effects, strict=True
        ):
            own = slice(start, start + sum(len(term.coefficients) for term in all_terms))
            start = own.stop
            if on_sensors(fitted) is None:
                sizes.append(EffectSize(np.zeros(9), np.zeros(9)))
                continue
            added = part.signal(terms, unmix.shape[1] + 1)[:, :-1] @ unmix.T
            sizes.append(EffectSize(_rms(added), _deviation(all_terms, unmix, self._covariance[own, own], some)))
        return tuple(sizes)

    @cached_property
    def _channels(self) -> WhitenedChannels:
        return self.model.base().channels

    @cached_property
    def _nominal(self) -> Base:
        return Base(self._channels, [self._channels.calibration])

    @cached_property
    def _terms(self) -> list[list[Term]]:
        return [part.terms(self._channels) for part in self.model.parts]

    @cached_property
    def _all_terms(self) -> list[list[Term]]:
        """For each effect its terms, then one term for each free parameter of its shape."""
        return [
            [*terms, *(_moved(part, name, self._channels) for name in names)]
            for part, terms, names in zip(self.model.parts, self._terms, self.free, strict=True)
        ]

    @cached_property
    def _design(self) -> Regressors:
        return self._channels.design([term for terms in self._all_terms for term in terms])

    @cached_property
    def _covariance(self) -> FloatArray:
        """Covariance of all coefficients and free shape parameters, the calibration marginalised."""
        left_out = [term for part in self.model.parts for term in part.left_out(self._channels)]
        return covariance_of(self._nominal, [self._design], left_out)


def _moved(part: Part, name: str, channels: WhitenedChannels) -> Term:
    """Return the derivative of what an effect adds by one parameter of its shape, as a term."""
    size = _STEP * part.shape[name] or _STEP
    count = channels.covariates.scalar_row + 1

    def added(value: float) -> FloatArray:
        shape: Shape = {**part.shape, name: value}
        moved = replace(part, shape=shape)
        return moved.signal(moved.terms(channels), count)

    above, below = added(part.shape[name] + size), added(part.shape[name] - size)
    change = above - below
    # At two layers that are alike the share of either makes no difference, but for rounding.
    slope = change / (2 * size) if np.abs(change).max() > _ROUNDING * np.abs(above).max() else np.zeros_like(change)
    rows = np.flatnonzero(slope.any(axis=0))
    parameter = Coefficient(name, part.effect.shape_units[name])
    return Term(ALL, None, name, (parameter,), slope[:, rows], rows, np.zeros(len(rows), dtype=np.intp))


def _rms(values: FloatArray) -> FloatArray:
    root: FloatArray = np.sqrt(np.mean(values**2, axis=0))
    return root


def _deviation(terms: Sequence[Term], unmix: FloatArray, covariance: FloatArray, some: slice) -> FloatArray:
    """Return the root mean square (9,) of the standard deviation of what terms add to the outputs."""
    by_column = np.zeros((len(terms[0].features[some]), 9, len(covariance)))
    for term, columns in zip(terms, columns_of(terms), strict=True):
        on_outputs = at_rows(np.vstack([unmix.T, np.zeros(len(unmix))]), term.rows)
        for atom in np.flatnonzero(on_outputs.any(axis=1)):
            by_column[:, :, columns[term.columns[atom]]] += term.features[some, atom, None] * on_outputs[atom]
    variance = np.einsum("nop,pq,noq->o", by_column, covariance, by_column, optimize=True) / len(by_column)
    deviation: FloatArray = np.sqrt(variance)
    return deviation
