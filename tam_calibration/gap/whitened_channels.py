"""The whitened channels of a recording at a nominal calibration, and normal equations of regressors of its rows.

The field of every sample is eliminated. What remains are 3K - 3 differential channels between the sensors and one
common-mode channel, the scalar minus the length of the weighted mean field of the sensors; white with unit variance
under the model. Where the attitude determines the field (``World``), each axis is a channel of its own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.core.least_squares import Elimination, Normal
from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.residuals import WhitenedResiduals
from tam_calibration.effects.term import Term, at_rows, thinned
from tam_calibration.gap.nominal import ENOUGH_SAMPLES
from tam_calibration.gap.regressors import Regressors, World, calibration_regressors, world_design
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.fitted_effect import SCALAR, Shape
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_LAST_RESIDUALS: "WeakKeyDictionary[WhitenedChannels, WhitenedResiduals]" = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class WhitenedChannels:
    """Whitened channels of every sample at nominal errors.

    Parameters
    ----------
    recording : Recording
        As read; a scalar channel is NaN or None where there is no reference.
    covariates : Covariates
        With the field of the world, or the sensors' weighted mean field, its length combined with the scalar by inverse
        variance: its noise is then independent of the residual, and no error of scale is imitated.
    directions : (3K, C) array
        Derivatives of the C differential channels by a shift of each row, 1/T; C is 3K - 3, or 3K with a world.
    differential : (N, C) array
        Residuals of them.
    direction : (N, 4) array
        Of the field in the array frame, and 1.
    turn : (4, 3K + 1) array
        ``direction @ turn`` is the derivative of the scalar minus the length of the field by a shift of each row.
    intensity_residual_T : (N,) array
        That difference; 0 where there is no reference.
    precision : (N,) array
        Its inverse variance, 1/T²; 0 where there is no reference.
    is_counted : (N,) array of bool
        Whether the sample counts.
    stride : int
        Normal equations, energy and count take every stride-th sample.
    """

    recording: Recording
    covariates: Covariates
    directions: FloatArray
    differential: FloatArray
    direction: FloatArray
    turn: FloatArray
    intensity_residual_T: FloatArray
    precision: FloatArray
    is_counted: NDArray[np.bool_]
    stride: int

    @classmethod
    def at(
        cls,
        recording: Recording,
        array: KnownNoiseArray,
        errors: SensorErrors,
        intensity_T: float,
        added_T: FloatArray | None = None,
        is_counted: NDArray[np.bool_] | None = None,
        row_variance: FloatArray | None = None,
        stride: int = 1,
        world: World | None = None,
    ) -> "WhitenedChannels":
        """Return the channels of a recording.

        Parameters
        ----------
        recording : Recording
            With finite channels.
        array : Array
            With the noise of sensors and scalar.
        errors : SensorErrors
            At which the channels are linearised.
        intensity_T : float
            Of the field, where the recording has no scalar channel.
        added_T : (N, 3K + 1) array, optional
            Signal of known effects in the rows, which is subtracted.
        is_counted : (N,) array of bool, optional
            By default every sample counts.
        row_variance : (3K + 1,) array, optional
            Of white noise beyond that of the array, T².
        stride : int
            See the class.
        world : World, optional
            Of a recording with attitude and without scalar: its field takes the place of that of the readings.
        """
        added = np.zeros((1, 3 * recording.sensor_count + 1)) if added_T is None else added_T
        rows = (recording.readings_T - errors.bias_T).reshape(recording.sample_count, -1) - added[:, :-1]
        if world is None:
            elimination = Elimination.of(errors.matrix.reshape(-1, 3), _row_weight(array, row_variance))
            field = rows @ elimination.unmixing.T
            length = norm(field, axis=1)
            direction = field / length[:, None]
            scalar_variance = array.scalar_noise_T**2 + (0.0 if row_variance is None else float(row_variance[-1]))
            measured = np.full(len(rows), intensity_T) if recording.scalar_T is None else recording.scalar_T
            scalar = measured - added[:, -1]
            is_known = np.isfinite(scalar)
            residuals = np.where(is_known, scalar - length, 0.0)
            precision = np.where(is_known, 1 / (scalar_variance + elimination.variance_along(direction.T)), 0.0)
            # Along the direction only, so that no channel depends on a rotation of the array.
            moved = length + (1 - precision * scalar_variance) * residuals
            covariates = Covariates.of(recording, moved[:, None] * direction, errors, array)
        else:
            elimination, covariates = _in_world(recording, array, errors, world, added, row_variance)
            rows = rows - covariates.sensed_T
            direction = covariates.field_T / covariates.intensity_T[:, None]
            residuals = precision = np.zeros(len(rows))
        return cls(
            recording,
            covariates,
            elimination.directions,
            rows @ elimination.directions,
            np.column_stack([direction, np.ones(len(rows))]),
            _row_turn(elimination),
            residuals,
            precision,
            np.ones(len(rows), dtype=bool) if is_counted is None else is_counted,
            stride,
        )

    def whitened(self, spreads_T: Sequence[FloatArray]) -> "WhitenedChannels":
        """Return the channels whitened for further noise that each sample has along one direction of the rows.

        A spread (N, 3K + 1) of the rows, tesla, is a direction d of the channels. It adds d dᵀ to their covariance, for
        which (1 + d dᵀ)^(-1/2) whitens them, and the directions of further spreads.
        """
        differential, residual_T = self.differential, self.intensity_residual_T
        waiting: list[tuple[FloatArray, FloatArray]] = [
            (one[:, :-1] @ self.directions, np.sum(self.row_direction * one, axis=1)) for one in spreads_T
        ]
        while waiting:
            (along, common_T), *waiting = waiting
            root = np.sqrt(1 + np.sum(along**2, axis=1) + self.precision * common_T**2)
            white = [(differential, residual_T), *waiting]
            for index, (own, own_T) in enumerate(white):
                off = np.sum(along * own, axis=1) + self.precision * common_T * own_T
                taken = off / (root * (1 + root))
                white[index] = own - taken[:, None] * along, own_T - taken * common_T
            (differential, residual_T), *waiting = white
        return replace(self, differential=differential, intensity_residual_T=residual_T)

    @property
    def row_direction(self) -> FloatArray:
        """(N, 3K + 1) how a shift of each row moves the scalar minus the length of the field."""
        return self.direction @ self.turn

    @cached_property
    def coupling(self) -> FloatArray:
        """(3K + 1, 3K + 1) information of the differential channels on shifts of the rows, 1/T²."""
        coupling = np.zeros((len(self.directions) + 1,) * 2)
        coupling[:-1, :-1] = self.directions @ self.directions.T
        return coupling

    def terms(self, effect: LinearEffect, shape: Shape) -> list[Term]:
        """Return the terms of an effect at the samples that the normal equations take.

        Parameters
        ----------
        effect : LinearEffect
            Its terms are those at the covariates of these channels.
        shape : Shape
            Parameters on which the effect depends otherwise than linearly, SI.
        """
        terms = effect.terms(self.covariates, shape)
        return list(terms) if self.stride == 1 else list(thinned(terms, self.stride))

    def design(self, terms: Sequence[Term]) -> Regressors:
        """Return terms side by side, at the samples that the normal equations take, to which others are thinned."""
        taken = len(self._taken)
        if any(len(term.features) != taken for term in terms):
            terms = list(thinned(terms, self.stride))
        if self.covariates.follows_attitude:
            terms = [self._on_sensors(term) for term in terms]
        return Regressors.of(terms)

    def _on_sensors(self, term: Term) -> Term:
        """Return what an intensity that is not measured, and too large by a term, takes from the readings."""
        if term.sensor != SCALAR:
            return term
        covariates = self.covariates
        along = (covariates.sensed_T / covariates.intensity_T[:, None])[:: self.stride]
        features = -(along[:, :, None] * term.features[:, None, :]).reshape(len(along), -1)
        rows, atoms = np.divmod(np.arange(features.shape[1]), len(term.columns))
        return replace(term, features=features, rows=rows, columns=term.columns[atoms])

    @cached_property
    def calibration(self) -> Regressors:
        """The design of the calibration itself, at the samples that the normal equations take."""
        own = calibration_regressors(self.covariates, self.stride)
        if not self.covariates.follows_attitude:
            return own
        unit = float(np.mean(self.covariates.intensity_T))
        return Regressors.joined([own, world_design(self.covariates, unit, self.stride)])

    @property
    def has_scalar(self) -> bool:
        """Whether the intensity is measured, and not taken for constant."""
        return self.recording.scalar_T is not None

    @property
    def channels_per_sample(self) -> FloatArray:
        """(N,) number of channels of each sample that counts."""
        return np.asarray(self.is_counted * (self.differential.shape[1] + (self.precision > 0)))

    @cached_property
    def count(self) -> float:
        """Number of channels n."""
        return float(self.channels_per_sample[:: self.stride].sum())

    @cached_property
    def energy_per_sample(self) -> FloatArray:
        """(N,) sums of the squares of each sample's channels."""
        return np.asarray(np.sum(self.differential**2, axis=1) + self.precision * self.intensity_residual_T**2)

    @cached_property
    def energy(self) -> float:
        """Sum of the squares of all channels that count."""
        return float((self.energy_per_sample * self.is_counted)[:: self.stride].sum())

    @property
    def residuals(self) -> WhitenedResiduals:
        """Input of the effects that are not found by regression; it is large, and only the last one is cached."""
        if self not in _LAST_RESIDUALS:
            _LAST_RESIDUALS.clear()
            _LAST_RESIDUALS[self] = self._whitened_residuals()
        return _LAST_RESIDUALS[self]

    def _whitened_residuals(self) -> WhitenedResiduals:
        root = np.sqrt(self.precision)
        return WhitenedResiduals(
            self.recording,
            self.covariates,
            self.differential,
            self.directions,
            np.where(self.precision > 0, root * self.intensity_residual_T, np.nan),
            root[:, None] * self.row_direction,
            self.differential.shape[1] + (self.precision > 0.0),
            self.is_counted,
        )

    def cross(self, left: Regressors, right: Regressors, part: slice | None = None) -> FloatArray:
        """Return the information (P, Q) between the columns of two designs.

        Parameters
        ----------
        left, right : Regressors
            Of P and Q columns, made by ``design`` or ``calibration``.
        part : slice, optional
            Of the samples that the normal equations take; by default all.
        """
        between = np.zeros((left.features.shape[1], right.features.shape[1]))
        common = np.zeros((left.width, right.width))
        for piece in self._pieces(part):
            first = self.samples_of(left, piece)
            second = first if right is left else self.samples_of(right, piece)
            between += first[0] @ second[0].T
            if self._has_reference:
                common += first[1] @ second[1].T
        coupling: FloatArray = at_rows(at_rows(self.coupling, right.rows).T, left.rows)
        by_atom: FloatArray = between[np.ix_(left.index, right.index)] * coupling
        return common + left.by_column(right.by_column(by_atom.T).T)

    @cached_property
    def _has_reference(self) -> bool:
        return bool(self.precision.any())

    def samples_of(self, design: Regressors, piece: slice) -> tuple[FloatArray, FloatArray]:
        """Return the features (F, n) of a design, 0 in samples not counted, and its effect on the whitened common mode.

        Parameters
        ----------
        design : Regressors
            Made by ``design`` or ``calibration``, with F features.
        piece : slice
            The n samples, of those that the normal equations take.

        Returns
        -------
        (F, n) array, (W, n) array
            W is the width of the design, or 0 without any reference.
        """
        counted = self._taken[piece]
        features = np.ascontiguousarray(design.features[piece].T)
        if not counted.all():
            features = features * counted
        if not self._has_reference:
            return features, features[:0]
        by_atom = features[design.index]
        by_atom *= at_rows(self.slope[:, piece], design.rows)
        return features, design.by_column(by_atom)

    @cached_property
    def _taken(self) -> NDArray[np.bool_]:
        """(n,) whether a sample that the normal equations take counts."""
        return self.is_counted[:: self.stride]

    @cached_property
    def slope(self) -> FloatArray:
        """(3K + 1, n) derivative of the whitened common mode by a shift of each row, in the samples that are taken."""
        every = slice(None, None, self.stride)
        return np.asarray(self.turn.T @ (np.sqrt(self.precision[every]) * self.direction[every].T))

    @cached_property
    def _taken_score(self) -> FloatArray:
        """(n, 3K + 1) score of the rows in the samples that the normal equations take."""
        taken = slice(None, None, self.stride)
        by_row = self.direction[taken] @ self.turn * (self.precision * self.intensity_residual_T)[taken, None]
        by_row[:, :-1] += self.differential[taken] @ self.directions.T
        by_row[~self._taken] = 0
        return np.asarray(by_row)

    def score(self, design: Regressors, part: slice | None = None) -> FloatArray:
        """Return the score (P,) of the columns of a design: their products with the residuals.

        Parameters
        ----------
        design : Regressors
            Of P columns, made by ``design`` or ``calibration``.
        part : slice, optional
            Of the samples that the normal equations take; by default all.
        """
        total = np.zeros((design.features.shape[1], self.turn.shape[1]))
        for piece in self._pieces(part):
            total += design.features[piece].T @ self._taken_score[piece]
        return design.by_column(design.of_atoms(total))

    def normal(self, design: Regressors, part: slice | None = None) -> Normal:
        """Return the normal equations of a design.

        Parameters
        ----------
        design : Regressors
            Of P columns, made by ``design`` or ``calibration``.
        part : slice, optional
            Of the samples that the normal equations take; by default all.
        """
        energy, count = (
            float(one[:: self.stride][part or slice(None)].sum())
            for one in (self.energy_per_sample * self.is_counted, self.channels_per_sample)
        )
        return Normal(self.cross(design, design, part), self.score(design, part), energy, count)

    def _pieces(self, part: slice | None) -> Iterator[slice]:
        start, stop, step = (part or slice(None)).indices(len(self._taken))
        for first in range(start, stop, ENOUGH_SAMPLES * step):
            yield slice(first, min(first + ENOUGH_SAMPLES * step, stop), step)


def _in_world(
    recording: Recording,
    array: KnownNoiseArray,
    errors: SensorErrors,
    world: World,
    added_T: FloatArray,
    row_variance: FloatArray | None,
) -> tuple[Elimination, Covariates]:
    """Return the elimination of a known field, and the covariates with the field of the world in them."""
    assert recording.attitude is not None and recording.scalar_T is None
    beyond = np.append(world.variance_T2, 0.0)
    weight = _row_weight(array, beyond if row_variance is None else beyond + row_variance)
    attitude = world.attitude(recording.attitude)
    # An intensity that is taken for constant and is too large by what is added to it.
    field = world.field(attitude) * (1 - added_T[:, -1:] / world.intensity_T)
    covariates = replace(Covariates.of(recording, field, errors, array), attitude=attitude, follows_attitude=True)
    return Elimination.of_known_field(weight), covariates


def _row_weight(array: KnownNoiseArray, row_variance: FloatArray | None) -> FloatArray:
    """Return the inverse standard deviation (3K,) of the rows of the sensors, 1/T."""
    variance = np.repeat(array.vector_noise_T**2, 3)
    return 1 / np.sqrt(variance if row_variance is None else variance + row_variance[:-1])


def _row_turn(elimination: Elimination) -> FloatArray:
    """Return the (4, 3K + 1) matrix from direction and 1 to the derivatives by the rows of scalar minus length."""
    turn = np.zeros((4, elimination.unmixing.shape[1] + 1))
    turn[:3, :-1], turn[3, -1] = -elimination.unmixing, 1
    return turn
