"""The likelihood of the sensors' errors with each sample's field eliminated, linearised.

What is left of a sample's 3K + 1 readings without its three field components is white: 3K - 3 differential channels
between the sensors, and one common-mode channel, the scalar minus the length of the field that the sensors agree on.
The differential channels are bilinear in data and parameters, so that the second moments of the readings, taken once,
serve every point; the common mode takes one pass over the data, in pieces that fit the processor's cache.

The field that the sensors agree on, b, is as noisy as they are, and it is in the slope of the common mode as well as in
its residual r. Their product, the score, therefore is not zero in the mean at the true errors, but of second order in
the noise. With C the covariance of b, u its direction and P = 1 - u uᵀ what lies across it,

    E r = tr(P C) / 2|b|,    cov(u, r) = P C u / |b|,    cov(b, r) = C u.

On the sphere that is nothing. Where the array hardly turns, it pulls what the turn hardly determines by many standard
errors. It is taken off: the estimate solves a corrected score (Stefanski 1985). The noise in it is that of the
residuals, but at most the stated one, as what is more may be no noise. What the weights add is left: it is of second
order in how C differs between directions.

What turns a sample's row into its channels at given parameters: all of it linear but for one length.

A row is [readings, features, 1]; the features say how an ambient gradient is turned, and there are none without one.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.least_squares import Elimination, Normal, gram
from tam_calibration.core.noise import VarianceFactors
from tam_calibration.effects.surroundings import turned
from tam_calibration.fit.ellipsoid import Normalized
from tam_calibration.fit.reference import InterpolationNoise
from tam_calibration.model.array import TENSOR_COLUMNS, TENSOR_ROWS, UNIT_TENSORS
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Turning:
    """How the components of a gradient of the world act on an array that is turned in it.

    Parameters
    ----------
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world.
    positions_m : (K, 3) array
        Of the sensors.
    scalar_position_m : (3,) array
        Of the scalar magnetometer.
    """

    attitude: FloatArray
    positions_m: FloatArray
    scalar_position_m: FloatArray

    @cached_property
    def features(self) -> FloatArray:
        """(N, 25) components in the array frame (slow) of the five unit tensors of the world (fast)."""
        components = turned(UNIT_TENSORS, self.attitude)[:, :, TENSOR_ROWS, TENSOR_COLUMNS]
        return np.swapaxes(components, 1, 2).reshape(len(components), -1)

    @property
    def levers(self) -> FloatArray:
        """(K, 3, 5) fields at the sensors of the five unit tensors of the array frame."""
        return np.asarray(np.einsum("cij,kj->kic", UNIT_TENSORS, self.positions_m))

    @property
    def scalar_lever(self) -> FloatArray:
        """(3, 5) the same at the scalar magnetometer."""
        return np.asarray(np.einsum("cij,j->ic", UNIT_TENSORS, self.scalar_position_m))


@dataclass(frozen=True, eq=False)
class ChannelMaps:
    """Linear maps from rows of Z columns to the channels, and their derivatives by the parameters.

    The parameters are the flattened (3K, 4) rows of [D Λ | o], then the P = 5 components of the gradient, or none.

    Parameters
    ----------
    elimination : Elimination
        Of the field that the sensors agree on from the unbiased readings.
    unbiased : (3K, Z) array
        To the readings without bias and without what the gradient adds.
    at_sensors : (K, 4, Z) array
        To the field at each sensor, and 1: minus the derivative of the unbiased readings by the rows.
    by_gradient : (3K, P, Z) array
        Minus the derivative of the unbiased readings by the gradient.
    at_scalar : (3, Z) array
        To the field at the scalar magnetometer.
    response : (12K + P, 3, Z - 3K + 3) array
        Minus the derivative of the intensity there, in direction ⊗ [field there, features, 1].
    """

    elimination: Elimination
    unbiased: FloatArray
    at_sensors: FloatArray
    by_gradient: FloatArray
    at_scalar: FloatArray
    response: FloatArray

    @classmethod
    def at(
        cls,
        matrix: FloatArray,
        bias: FloatArray,
        vector_noise: FloatArray,
        turning: Turning | None,
        gradient: FloatArray,
    ) -> "ChannelMaps":
        """Return the maps at given errors of the sensors and a given ambient gradient.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            D Λ of each sensor.
        bias : (K, 3) array
            Of each sensor, in the unit of the readings.
        vector_noise : (K,) array
            Standard deviation of the noise of each sensor's axes, in the unit of the readings.
        turning : Turning, optional
            Attitudes and positions by which the gradient acts; None in a uniform field.
        gradient : (P,) array
            Components xx, xy, xz, yy, yz of the ambient gradient in the world, in the unit of the readings per metre;
            not read without ``turning``.
        """
        if turning is None:
            return cls.of_uniform_field(matrix, bias, vector_noise)
        elimination = Elimination.of(matrix.reshape(-1, 3), 1 / np.repeat(vector_noise, 3))
        unmix, rows = elimination.unmixing, matrix.size // 3
        levers, scalar_lever = turning.levers, turning.scalar_lever
        moved = (matrix @ levers).reshape(-1, 5)
        chosen = np.kron(np.eye(5), gradient)
        unbiased = np.column_stack([np.eye(rows), -moved @ chosen, -bias.ravel()])
        center = unmix @ unbiased
        at_sensors = _append_one(center + _features_only(levers @ chosen, rows))
        by_gradient = _features_only(_each(moved), rows)
        at_scalar = center + _features_only(scalar_lever @ chosen, rows)
        field = np.eye(3, 4 + chosen.shape[1]) + _features_only((levers - scalar_lever) @ chosen, 3)
        by_rows = _by_rows(unmix, _append_one(field))
        by_gradient_there = np.swapaxes(_features_only(_each(unmix @ moved - scalar_lever), 3), 0, 1)
        response = np.concatenate([by_rows, by_gradient_there])
        return cls(elimination, unbiased, at_sensors, by_gradient, at_scalar, response)

    @classmethod
    def of_uniform_field(cls, matrix: FloatArray, bias: FloatArray, vector_noise: FloatArray) -> "ChannelMaps":
        """Return the maps in a uniform field; parameters as of ``at``."""
        elimination = Elimination.of(matrix.reshape(-1, 3), 1 / np.repeat(vector_noise, 3))
        count = len(bias)
        unbiased = np.column_stack([np.eye(3 * count), -bias.ravel()])
        center = elimination.unmixing @ unbiased
        at_sensors = np.broadcast_to(_append_one(center), (count, 4, 3 * count + 1))
        response = _by_rows(elimination.unmixing, np.broadcast_to(np.eye(4), (count, 4, 4)))
        none = np.zeros((3 * count, 0, 3 * count + 1))
        return cls(elimination, unbiased, at_sensors, none, center, response)


def _append_one(field: FloatArray) -> FloatArray:
    """Extend maps to a field (..., 3, Z) by one to the 1 in the last column: (..., 4, Z)."""
    one = np.zeros((*field.shape[:-2], 1, field.shape[-1]))
    one[..., -1] = 1
    return np.concatenate([field, one], axis=-2)


def _features_only(of_features: FloatArray, before: int) -> FloatArray:
    """Return maps (..., Q) of the features as maps (..., before + Q + 1) of rows."""
    return np.pad(of_features, [(0, 0)] * (of_features.ndim - 1) + [(before, 1)])


def _each(of_components: FloatArray) -> FloatArray:
    """Return maps (M, 5) of components in the array frame as maps (M, 5, 25) of features, one for each unit tensor."""
    return np.asarray(np.einsum("mc,pq->mpcq", of_components, np.eye(5)).reshape(len(of_components), 5, 25))


def _by_rows(unmix: FloatArray, field: FloatArray) -> FloatArray:
    """Return the (12K, 3, V) responses of the common field to the rows, from maps (K, 4, V) to what they act on."""
    by_reading = unmix.reshape(3, -1, 3)
    return np.asarray(np.einsum("xia,icv->iacxv", by_reading, field).reshape(12 * len(field), 3, -1))


_BoolArray = NDArray[np.bool_]

UNIFORM: FloatArray = np.array([])
"""The components of the gradient of a field that has none."""


@dataclass(frozen=True, eq=False)
class Linearization:
    """Normal equations of the whitened channels at a point.

    The parameters are the flattened (3K, 4) rows of [D Λ | o], then P components of an ambient gradient: 5, or none.

    Parameters
    ----------
    between : Normal
        Of the differential channels. Its information, as that of both, is singular along the common rotation.
    common : Normal
        Of the common mode of samples with a reference intensity; their number is its count.
    correction : (12 K + P,) array
        What was taken off the score of the common mode as the mean that noise makes of it.
    """

    between: Normal
    common: Normal
    correction: FloatArray

    @cached_property
    def both(self) -> Normal:
        """Of all channels: ``information @ step = score`` is the Gauss-Newton step."""
        return self.between + self.common

    def by(self, jacobian: FloatArray) -> "Linearization":
        """Return the normal equations over other unknowns, as ``Normal.by``."""
        return Linearization(self.between.by(jacobian), self.common.by(jacobian), jacobian.T @ self.correction)

    def weighed(self, factors: VarianceFactors) -> "Linearization":
        """Return the normal equations of channels whose variances are larger by factors."""
        between, common = self.between.over(factors.differential), self.common.over(factors.common_mode)
        return Linearization(between, common, self.correction / factors.common_mode)


class CommonMode(NamedTuple):
    """The channel of samples with a reference: field and direction (3, n) at the scalar magnetometer, residual (n,).

    ``of_direction`` and ``of_field`` (3, n) are the mean of its product with the direction, and its covariance with the
    field; ``precision`` is one over its variance. ``known`` tells which samples these are.
    """

    field: FloatArray
    direction: FloatArray
    residual: FloatArray
    of_direction: FloatArray
    of_field: FloatArray
    precision: FloatArray
    known: slice | _BoolArray


class CommonModeSums(NamedTuple):
    """Sums over the samples with a reference.

    ``moments`` (3 F + 1, 3 F + 1) are those of the ``whitened`` columns, ``score`` (3 F,) is the mean of the product of
    residual and others that noise of the stated size makes at the true errors. ``reference_count`` is their number.
    """

    moments: FloatArray
    score: FloatArray
    reference_count: int


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Readings, reference and noise; all in one unit, best of order one.

    Parameters
    ----------
    data : Normalized
        Readings and intensities.
    vector_noise : (K,) array
        Standard deviation of each sensor's axes.
    scalar_noise : float
        Standard deviation of the intensity's error that is each sample's own.
    intensity : (N,) array, optional
        Reference intensity in place of that of the data; NaN where there is none.
    interpolation_noise : InterpolationNoise, optional
        Errors of the intensity that neighbouring samples have in common.
    turning : Turning, optional
        Attitudes and positions where the field has an ambient gradient.
    """

    data: Normalized
    vector_noise: FloatArray
    scalar_noise: float
    intensity: FloatArray | None = None
    interpolation_noise: InterpolationNoise | None = None
    turning: Turning | None = None

    @property
    def channel_count(self) -> FloatArray:
        """(2, N) number of whitened channels of each sample: 3K - 3 between the sensors, and one with a reference."""
        has_reference = np.concatenate([np.isfinite(intensity) for _, _, intensity in self._blocks()])
        return np.stack([np.full(len(has_reference), 3.0 * len(self.vector_noise) - 3), has_reference])

    def linearize(
        self,
        matrix: FloatArray,
        bias: FloatArray,
        weights: FloatArray | None = None,
        ambient_gradient: FloatArray = UNIFORM,
    ) -> Linearization:
        """Return the normal equations at a point.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            D Λ of each sensor.
        bias : (K, 3) array
            Of each sensor about the origin of the data, in their unit.
        weights : (2, N) array, optional
            By how much the differential channels of each sample count, and its common mode; by default as one.
        ambient_gradient : (P,) array
            Components xx, xy, xz, yy, yz of the ambient gradient in the world, in the unit of the readings per metre;
            by default the field is uniform.
        """
        channels = ChannelMaps.at(matrix, bias, self.vector_noise, self.turning, ambient_gradient)
        moments = self._moments if weights is None else self._moments_of(weights[0])
        pieces = (
            (rows[:-1], intensity, None if weights is None else weights[1][part])
            for part, rows, intensity in self._blocks()
        )
        common = common_mode_sums(channels, pieces, self.scalar_noise, self.interpolation_noise)
        return normal_equations(channels, moments, common, self.data.source.sample_count)

    def energy(self, matrix: FloatArray, bias: FloatArray, ambient_gradient: FloatArray = UNIFORM) -> FloatArray:
        """Return the (2, N) sums of the squares of each sample's differential channels, and of its common mode.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            D Λ of each sensor.
        bias : (K, 3) array
            Of each sensor about the origin of the data, in their unit.
        ambient_gradient : (P,) array
            Components xx, xy, xz, yy, yz of the ambient gradient in the world, in the unit of the readings per metre;
            by default the field is uniform.
        """
        assert self.interpolation_noise is None, "what samples share is no sample's own"
        channels = ChannelMaps.at(matrix, bias, self.vector_noise, self.turning, ambient_gradient)
        parts = [energies(channels, rows[:-1], intensity, self.scalar_noise) for _, rows, intensity in self._blocks()]
        return np.asarray(np.nan_to_num(np.concatenate(parts, axis=1)))

    @cached_property
    def _moments(self) -> FloatArray:
        return self.data.moments if self.turning is None else self._moments_of(np.ones(self.data.source.sample_count))

    def _moments_of(self, weights: FloatArray) -> FloatArray:
        """Return the (Z, Z) sum of the outer products of the rows, each times its weight (N,)."""
        return sum((rows * weights[part] @ rows.T for part, rows, _ in self._blocks()), np.zeros(()))

    def _blocks(self) -> Iterator[tuple[slice, FloatArray, FloatArray]]:
        """Yield the place of some samples, their rows (Z, n) and their intensities (n,)."""
        first = 0
        for rows, intensity in self.data.blocks():
            part = slice(first, first + len(intensity))
            if self.turning is not None:
                rows = np.concatenate([rows[:-1], self.turning.features[part].T, rows[-1:]])
            yield part, rows, intensity if self.intensity is None else self.intensity[part]
            first = part.stop


def common_mode(channels: ChannelMaps, rows: FloatArray, intensity: FloatArray, scalar_noise: float) -> CommonMode:
    """Return the common mode of samples, of which those without a reference are left out.

    Parameters
    ----------
    channels : ChannelMaps
        Maps at the errors of the sensors.
    rows : (Z - 1, n) array
        Readings and features of n samples, without the 1 that ends a row.
    intensity : (n,) array
        Reference intensity in the unit of the readings; NaN where there is none.
    scalar_noise : float
        Standard deviation of the intensity's error.
    """
    finite = np.isfinite(intensity)
    known = slice(None) if finite.all() else finite
    field = channels.at_scalar[:, :-1] @ rows[:, known]
    field += channels.at_scalar[:, -1:]
    length = np.sqrt(np.einsum("in,in->n", field, field))
    direction = field / length
    covariance = channels.elimination.covariance
    of_field = covariance @ direction
    along = np.einsum("in,in->n", of_field, direction)
    of_direction = (of_field + direction * (np.trace(covariance) - 3 * along) / 2) / length
    precision = 1 / (scalar_noise**2 + along)
    return CommonMode(field, direction, length - intensity[known], of_direction, of_field, precision, known)


def energies(channels: ChannelMaps, rows: FloatArray, intensity: FloatArray, scalar_noise: float) -> FloatArray:
    """Return the (2, n) squared residuals of the differential channels, and of the common mode, over their variances.

    The latter is NaN where there is no reference.

    Parameters
    ----------
    channels, rows, intensity, scalar_noise
        As for ``common_mode``.
    """
    differences = channels.elimination.directions.T @ channels.unbiased
    residuals = differences[:, :-1] @ rows + differences[:, -1:]
    found = np.full((2, rows.shape[1]), np.nan)
    found[0] = np.einsum("in,in->n", residuals, residuals)
    there = common_mode(channels, rows, intensity, scalar_noise)
    found[1, there.known] = there.precision * there.residual**2
    return found


def whitened(there: CommonMode, features: FloatArray) -> FloatArray:
    """Return the whitened columns direction ⊗ [field, features, 1] and, last, the residual.

    Parameters
    ----------
    there : CommonMode
        Of the n samples with a reference.
    features : (Q, m) array
        How an ambient gradient is turned, of all m samples, also of those without a reference; Q = 0 in a uniform
        field.

    Returns
    -------
    (3 F + 1, n) array
        With F = Q + 4; each column over the standard deviation of its residual.
    """
    root = np.sqrt(there.precision)
    extended = np.concatenate([there.field, features[:, there.known], np.ones((1, len(root)))])
    extended *= root
    columns = np.empty((3 * len(extended) + 1, len(root)))
    np.multiply(there.direction[:, None], extended, out=columns[:-1].reshape(3, *extended.shape))
    np.multiply(there.residual, root, out=columns[-1])
    return columns


def expected_score(there: CommonMode, features: FloatArray) -> FloatArray:
    """Return the ``score`` of ``CommonModeSums``.

    Parameters
    ----------
    there : CommonMode
        Of the n samples with a reference.
    features : (Q, m) array
        As for ``whitened``.

    Returns
    -------
    (3 F,) array
        Of second order in the noise, in the order direction ⊗ [field, features, 1].
    """
    extended = np.concatenate([there.field, features[:, there.known], np.ones((1, len(there.precision)))])
    score = (there.precision * there.of_direction) @ extended.T
    score[:, :3] += (there.precision * there.direction) @ there.of_field.T
    return np.asarray(score.ravel())


def common_mode_sums(
    channels: ChannelMaps,
    pieces: Iterable[tuple[FloatArray, FloatArray, FloatArray | None]],
    scalar_noise: float,
    shared: InterpolationNoise | None = None,
) -> CommonModeSums:
    """Return the sums of the common mode; what samples share is taken off.

    Parameters
    ----------
    channels : ChannelMaps
        Maps at the errors of the sensors.
    pieces : iterable
        Rows (Z - 1, n) and intensities (n,) as for ``common_mode``, and by how much each sample counts, (n,) or None.
    scalar_noise : float
        Standard deviation of the intensity's error that is each sample's own.
    shared : InterpolationNoise, optional
        Errors of the intensity that neighbouring samples have in common.
    """
    size, sensor_rows = channels.response[0].size + 1, len(channels.unbiased)
    total, score, count, kept = np.zeros((size, size)), np.zeros(size - 1), 0, []
    for rows, intensity, weights in pieces:
        there, features = common_mode(channels, rows, intensity, scalar_noise), rows[sensor_rows:]
        first, count = count, count + len(there.residual)
        # A sample's own noise makes the score, whatever its weight: weights are scaled so that the weighted squares of
        # the residuals have their stated mean. With errors in common it is at least what the sample has without the
        # others, which is nearly all of it.
        alone = there.precision if shared is None else 1 / (1 / there.precision + shared.variance[first:count])
        score += expected_score(there._replace(precision=alone), features)
        if weights is not None:
            there = there._replace(precision=there.precision * weights[there.known])
        columns = whitened(there, features)
        total += gram(columns)
        if shared is not None:
            kept.append((columns.T * np.sqrt(there.precision)[:, None], there.precision))
    if shared is not None:
        total -= shared.explained(*(np.concatenate(column) for column in zip(*kept, strict=True)))
    return CommonModeSums(total, score, count)


def normal_equations(
    channels: ChannelMaps, moments: FloatArray, common: CommonModeSums, sample_count: int
) -> Linearization:
    """Return the normal equations from the sums over all samples.

    Parameters
    ----------
    channels : ChannelMaps
        Maps at the errors of the sensors.
    moments : (Z, Z) array
        Sum of the outer products of the rows.
    common : CommonModeSums
        Of the common mode.
    sample_count : int
        Number of samples, with a reference intensity or without.
    """
    size = channels.response[0].size
    response = channels.response.reshape(-1, size)
    energy = float(common.moments[size, size])
    between = _differential(channels, moments, sample_count)
    channel_count = between.count + common.reference_count
    variance_factor = min((between.energy + energy) / max(channel_count, 1), 1.0)
    correction = response @ (variance_factor * common.score)
    information = response @ common.moments[:size, :size] @ response.T
    score = response @ common.moments[:size, size] - correction
    return Linearization(between, Normal(information, score, energy, common.reference_count), correction)


def _differential(channels: ChannelMaps, moments: FloatArray, sample_count: int) -> Normal:
    """Return the normal equations of the differential channels from the second moments of the rows."""
    count, complement = len(channels.at_sensors), channels.elimination.complement
    extend = channels.at_sensors.reshape(4 * count, -1)
    products = (extend @ moments @ extend.T).reshape(count, 1, 4, count, 1, 4)
    by_rows = complement.reshape(count, 3, 1, count, 3, 1) * products
    unbiased = channels.unbiased @ moments
    white = complement @ unbiased
    score = np.einsum("iaz,icz->iac", white.reshape(count, 3, -1), channels.at_sensors).ravel()
    energy = float(np.sum(complement * (unbiased @ channels.unbiased.T)))
    information = by_rows.reshape(12 * count, 12 * count)
    channel_count = (3 * count - 3) * sample_count
    if not channels.by_gradient.shape[1]:
        return Normal(information, score, energy, channel_count)
    by_gradient = channels.by_gradient
    whitened = np.einsum("ab,bpy,yz->apz", complement, by_gradient, moments, optimize=True)
    cross = np.einsum("icz,iapz->iacp", channels.at_sensors, whitened.reshape(count, 3, *whitened.shape[1:]))
    cross = cross.reshape(12 * count, -1)
    own = np.einsum("apz,aqz->pq", whitened, by_gradient)
    downhill = np.einsum("apz,az->p", by_gradient, white)
    return Normal(np.block([[information, cross], [cross.T, own]]), np.append(score, downhill), energy, channel_count)
