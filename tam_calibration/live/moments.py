"""Samples as sums, from which the normal equations follow at any errors of the sensors.

The likelihood follows from sums alone: moments of the readings up to fourth order. The differential channels are
bilinear in readings and parameters, so that the second moments of the readings serve them at every point. Of the common
mode the length of the field is not; but its residual |b| - s is (|b|² - s²) / 2s but for a part e / 2s of itself, and
|b|² is a polynomial of second degree in the field that the sensors agree on. Fourth moments of that field therefore
serve every point too. With C the covariance of b and σ the noise of s, what is taken off |b|² is tr C + 3 σ², after
which the score (b / s) ⊗ [b, 1] (|b|² - s²) / 2s is in the mean, to second order, C S + S C for the b and C t for the
1; S and t are the means of u uᵀ and u / |b|. That is taken off too, as in ``likelihood``.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import inv

from tam_calibration.core.normal_equations import Elimination, gram
from tam_calibration.core.variance_factors import WHITE, VarianceFactors
from tam_calibration.fit.channel_maps import ChannelMaps
from tam_calibration.fit.information import rows_by_unknowns
from tam_calibration.fit.likelihood import UNIFORM, CommonModeSums, Linearization, normal_equations
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_SQUARES = (0, 5, 10)
"""Places of the squares of the field's components among its products with itself and 1."""

_DIRECTION = (3, 7, 11, 15)
"""Places there of the field's components by themselves, and of the 1."""


@dataclass(frozen=True, eq=False)
class SampleMoments:
    """Sums over samples; those of two sets of samples are the sums of both.

    Parameters
    ----------
    second : (3K + 1, 3K + 1) array
        Outer products of the readings of all sensors, and 1.
    fourth : (17, 17) array
        Weighted outer products of [b, 1] ⊗ [b, 1] and the square of the intensity; b is the field.
    count, scalar_count : int
        Number of samples, and of those with an intensity.
    """

    second: FloatArray
    fourth: FloatArray
    count: int
    scalar_count: int

    @classmethod
    def none(cls, sensor_count: int) -> "SampleMoments":
        """Return the moments of no sample."""
        return cls(np.zeros((3 * sensor_count + 1, 3 * sensor_count + 1)), np.zeros((17, 17)), 0, 0)

    def __add__(self, other: "SampleMoments") -> "SampleMoments":
        """Return the moments of both sets of samples."""
        return SampleMoments(
            self.second + other.second,
            self.fourth + other.fourth,
            self.count + other.count,
            self.scalar_count + other.scalar_count,
        )


@dataclass(frozen=True, eq=False)
class MomentLikelihood:
    """What makes moments of samples, and of moments the normal equations of the errors of the sensors.

    Parameters
    ----------
    origin : SensorErrors
        Near the truth: the field that the sensors agree on, and with it the weights of the intensities, are worked out
        with these errors.
    array : KnownNoiseArray
        With every noise.
    unit_T : float
        About the intensity of the field, tesla.
    factors : VarianceFactors
        By how much what the samples tell varies more than by white noise of that size.
    """

    origin: SensorErrors
    array: KnownNoiseArray
    unit_T: float
    factors: VarianceFactors = WHITE

    def moments(self, readings_T: FloatArray, scalar_T: FloatArray) -> SampleMoments:
        """Return the moments of samples.

        Parameters
        ----------
        readings_T : (N, K, 3) array
            Raw readings, tesla.
        scalar_T : (N,) array
            Reference intensity, tesla; NaN where there is none.
        """
        points = ((readings_T - self.origin.bias_T) / self.unit_T).reshape(len(readings_T), -1).T
        rows = np.concatenate([points, np.ones((1, len(readings_T)))])
        known = np.isfinite(scalar_T)
        field, intensity = self._elimination.unmixing @ points[:, known], scalar_T[known] / self.unit_T
        variance = self._scalar_noise**2 + self._elimination.variance_along(field / intensity)
        beyond = np.trace(self._elimination.covariance) + 3 * self._scalar_noise**2
        extended = np.concatenate([field, np.ones((1, len(intensity)))])
        columns = np.empty((17, len(intensity)))
        np.multiply(extended[:, None], extended[None], out=columns[:-1].reshape(4, 4, -1))
        columns[-1] = intensity**2 + beyond
        columns /= intensity * np.sqrt(variance)
        return SampleMoments(gram(rows), gram(columns), len(readings_T), int(known.sum()))

    def linearize(self, moments: SampleMoments, errors: SensorErrors) -> Linearization:
        """Return the normal equations of the (12 K,) errors, SI, in the order of ``SensorErrors.to_vector``.

        Parameters
        ----------
        moments : SampleMoments
            Of the samples.
        errors : SensorErrors
            Where they are linearised.
        """
        offset = (errors.bias_T - self.origin.bias_T) / self.unit_T
        channels = ChannelMaps.at(errors.matrix, offset, UNIFORM, self._vector_noise, None)
        common = self._common_mode(moments, errors, offset)
        rows = normal_equations(channels, moments.second, common, moments.count)
        return rows.by(rows_by_unknowns(errors, self.unit_T, None)).weighed(self.factors)

    def _common_mode(self, moments: SampleMoments, errors: SensorErrors, offset: FloatArray) -> CommonModeSums:
        """Return the sums of the common mode at given errors."""
        unmixing = self._elimination.unmixing
        # The field at the errors of the origin is affine in that at others, but for noise that these do not see.
        back = inv(unmixing @ errors.matrix.reshape(-1, 3))
        affine = np.eye(4)
        affine[:3, :3], affine[:3, 3] = back, -back @ unmixing @ offset.ravel()
        turn = np.eye(17)
        turn[:16, :16] = np.kron(affine, affine)
        choose = np.zeros((13, 17))
        choose[:12, :12] = np.eye(12)
        choose[12, _SQUARES], choose[12, 16] = 0.5, -0.5
        turned = turn @ moments.fourth @ turn.T
        covariance = back @ self._elimination.covariance @ back.T
        by_direction = turned[np.ix_(_DIRECTION, _DIRECTION)]
        by_field = covariance @ by_direction[:3, :3]
        score = np.column_stack([by_field + by_field.T, covariance @ by_direction[:3, 3]])
        return CommonModeSums(choose @ turned @ choose.T, score.ravel(), moments.scalar_count)

    @cached_property
    def _elimination(self) -> Elimination:
        return Elimination.of(self.origin.matrix.reshape(-1, 3), 1 / np.repeat(self._vector_noise, 3))

    @cached_property
    def _vector_noise(self) -> FloatArray:
        return self.array.vector_noise_T / self.unit_T

    @cached_property
    def _scalar_noise(self) -> float:
        return self.array.scalar_noise_T / self.unit_T
