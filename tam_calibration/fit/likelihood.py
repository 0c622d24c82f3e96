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

What turns a sample's row [readings, 1] into its channels at given parameters: all of it linear but for one length.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.least_squares import Elimination, Normal, gram
from tam_calibration.core.noise import VarianceFactors
from tam_calibration.fit.ellipsoid import Normalized
from tam_calibration.fit.reference import InterpolationNoise, interpolate, is_worth_interpolating
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class ChannelMaps:
    """Linear maps from rows [readings, 1] to the channels, and their derivatives by the rows of [D Λ | o].

    Parameters
    ----------
    elimination : Elimination
        Of the field that the sensors agree on from the unbiased readings.
    unbiased : (3K, 3K + 1) array
        To the readings without bias.
    field : (3, 3K + 1) array
        To the field that the sensors agree on.
    response : (12K, 12) array
        Minus the derivative of the length of that field by the flattened rows (3K, 4), in direction ⊗ [field, 1].
    """

    elimination: Elimination
    unbiased: FloatArray
    field: FloatArray
    response: FloatArray

    @classmethod
    def at(cls, matrix: FloatArray, bias: FloatArray, vector_noise: FloatArray) -> "ChannelMaps":
        """Return the maps at given errors of the sensors.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            D Λ of each sensor.
        bias : (K, 3) array
            Of each sensor, in the unit of the readings.
        vector_noise : (K,) array
            Standard deviation of the noise of each sensor's axes, in the unit of the readings.
        """
        elimination = Elimination.of(matrix.reshape(-1, 3), 1 / np.repeat(vector_noise, 3))
        unbiased = np.column_stack([np.eye(bias.size), -bias.ravel()])
        unmixing = elimination.unmixing
        return cls(elimination, unbiased, unmixing @ unbiased, np.kron(unmixing.T, np.eye(4)))


_BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Linearization:
    """Normal equations of the whitened channels at a point.

    The parameters are the flattened (3K, 4) rows of [D Λ | o].

    Parameters
    ----------
    between : Normal
        Of the differential channels. Its information, as that of both, is singular along the common rotation.
    common : Normal
        Of the common mode of samples with a reference intensity; their number is its count.
    correction : (12 K,) array
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
    """The channel of samples with a reference: common field and its direction (3, n), residual (n,).

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

    ``moments`` (13, 13) are those of the ``whitened`` columns, ``score`` (12,) is the mean of the product of
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
    """

    data: Normalized
    vector_noise: FloatArray
    scalar_noise: float
    intensity: FloatArray | None = None
    interpolation_noise: InterpolationNoise | None = None

    def linearize(self, matrix: FloatArray, bias: FloatArray, weights: FloatArray | None = None) -> Linearization:
        """Return the normal equations at a point.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            D Λ of each sensor.
        bias : (K, 3) array
            Of each sensor about the origin of the data, in their unit.
        weights : (2, N) array, optional
            By how much the differential channels of each sample count, and its common mode; by default as one.
        """
        channels = ChannelMaps.at(matrix, bias, self.vector_noise)
        moments = self.data.moments if weights is None else self._moments_of(weights[0])
        pieces = (
            (rows[:-1], intensity, None if weights is None else weights[1][part])
            for part, rows, intensity in self._blocks()
        )
        common = common_mode_sums(channels, pieces, self.scalar_noise, self.interpolation_noise)
        return normal_equations(channels, moments, common, self.data.source.sample_count)

    def energy(self, matrix: FloatArray, bias: FloatArray) -> FloatArray:
        """Return the (2, N) sums of the squares of each sample's differential channels, and of its common mode.

        The latter is NaN where there is no reference.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            D Λ of each sensor.
        bias : (K, 3) array
            Of each sensor about the origin of the data, in their unit.
        """
        assert self.interpolation_noise is None, "what samples share is no sample's own"
        channels = ChannelMaps.at(matrix, bias, self.vector_noise)
        parts = [energies(channels, rows[:-1], intensity, self.scalar_noise) for _, rows, intensity in self._blocks()]
        return np.concatenate(parts, axis=1)

    def _moments_of(self, weights: FloatArray) -> FloatArray:
        """Return the (3K + 1, 3K + 1) sum of the outer products of the rows, each times its weight (N,)."""
        return sum((rows * weights[part] @ rows.T for part, rows, _ in self._blocks()), np.zeros(()))

    def _blocks(self) -> Iterator[tuple[slice, FloatArray, FloatArray]]:
        """Yield the place of some samples, their rows (3K + 1, n) and their intensities (n,)."""
        first = 0
        for rows, intensity in self.data.blocks():
            part = slice(first, first + len(intensity))
            yield part, rows, intensity if self.intensity is None else self.intensity[part]
            first = part.stop


def likelihood_of(
    recording: SampleSource, array: KnownNoiseArray, data: Normalized, may_interpolate: bool = True
) -> Likelihood:
    """Return the likelihood of samples in a uniform field, the intensity interpolated where it is slow.

    Parameters
    ----------
    recording : SampleSource
        The samples.
    array : KnownNoiseArray
        Of their sensors.
    data : Normalized
        The same samples.
    may_interpolate : bool
        Whether the intensity between two readings lies on a line.
    """
    vector_noise, scalar_noise = data.noise_of(array)
    if not (may_interpolate and is_worth_interpolating(recording)):
        return Likelihood(data, vector_noise, scalar_noise)
    whole = recording.whole()
    intensity, shared_noise = interpolate(whole.time_s, data.intensity, scalar_noise)
    return Likelihood(replace(data, source=whole), vector_noise, 0.0, intensity, shared_noise)


def common_mode(channels: ChannelMaps, rows: FloatArray, intensity: FloatArray, scalar_noise: float) -> CommonMode:
    """Return the common mode of samples, of which those without a reference are left out.

    Parameters
    ----------
    channels : ChannelMaps
        Maps at the errors of the sensors.
    rows : (3K, n) array
        Readings of n samples, without the 1 that ends a row.
    intensity : (n,) array
        Reference intensity in the unit of the readings; NaN where there is none.
    scalar_noise : float
        Standard deviation of the intensity's error.
    """
    finite = np.isfinite(intensity)
    known = slice(None) if finite.all() else finite
    field = channels.field[:, :-1] @ rows[:, known]
    field += channels.field[:, -1:]
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


def whitened(there: CommonMode) -> FloatArray:
    """Return the whitened columns direction ⊗ [field, 1] and, last, the residual.

    Parameters
    ----------
    there : CommonMode
        Of the n samples with a reference.

    Returns
    -------
    (13, n) array
        Each column over the standard deviation of its residual.
    """
    root = np.sqrt(there.precision)
    extended = np.concatenate([there.field, np.ones((1, len(root)))])
    extended *= root
    columns = np.empty((13, len(root)))
    np.multiply(there.direction[:, None], extended, out=columns[:-1].reshape(3, 4, -1))
    np.multiply(there.residual, root, out=columns[-1])
    return columns


def expected_score(there: CommonMode) -> FloatArray:
    """Return the ``score`` of ``CommonModeSums``.

    Parameters
    ----------
    there : CommonMode
        Of the n samples with a reference.

    Returns
    -------
    (12,) array
        Of second order in the noise, in the order direction ⊗ [field, 1].
    """
    extended = np.concatenate([there.field, np.ones((1, len(there.precision)))])
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
        Rows (3K, n) and intensities (n,) as for ``common_mode``, and by how much each sample counts, (n,) or None.
    scalar_noise : float
        Standard deviation of the intensity's error that is each sample's own.
    shared : InterpolationNoise, optional
        Errors of the intensity that neighbouring samples have in common.
    """
    total, score, count, kept = np.zeros((13, 13)), np.zeros(12), 0, []
    for rows, intensity, weights in pieces:
        there = common_mode(channels, rows, intensity, scalar_noise)
        first, count = count, count + len(there.residual)
        # A sample's own noise makes the score, whatever its weight: weights are scaled so that the weighted squares of
        # the residuals have their stated mean. With errors in common it is at least what the sample has without the
        # others, which is nearly all of it.
        alone = there.precision if shared is None else 1 / (1 / there.precision + shared.variance[first:count])
        score += expected_score(there._replace(precision=alone))
        if weights is not None:
            there = there._replace(precision=there.precision * weights[there.known])
        columns = whitened(there)
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
    moments : (3K + 1, 3K + 1) array
        Sum of the outer products of the rows.
    common : CommonModeSums
        Of the common mode.
    sample_count : int
        Number of samples, with a reference intensity or without.
    """
    response = channels.response
    energy = float(common.moments[-1, -1])
    between = _differential(channels, moments, sample_count)
    channel_count = between.count + common.reference_count
    variance_factor = min((between.energy + energy) / max(channel_count, 1), 1.0)
    correction = response @ (variance_factor * common.score)
    information = response @ common.moments[:-1, :-1] @ response.T
    score = response @ common.moments[:-1, -1] - correction
    return Linearization(between, Normal(information, score, energy, common.reference_count), correction)


def _differential(channels: ChannelMaps, moments: FloatArray, sample_count: int) -> Normal:
    """Return the normal equations of the differential channels from the second moments of the rows."""
    complement, unbiased = channels.elimination.complement, channels.unbiased
    extended = np.vstack([channels.field, np.eye(len(moments))[-1]])
    white = complement @ unbiased @ moments
    information = np.kron(complement, extended @ moments @ extended.T)
    score = (white @ extended.T).ravel()
    return Normal(information, score, float(np.sum(white * unbiased)), (len(complement) - 3) * sample_count)
