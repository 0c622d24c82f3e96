"""Least squares: normal equations, which add up over samples, and damped steps for many small problems side by side.

The readings of a sample without bias are r = A b + ε: A the stacked matrices D Λ of its R = 3K rows, b the field, ε
white noise of standard deviations σ. With W = diag(1/σ) the field that the sensors agree on is its weighted
least-squares estimate; the rest of the readings lies along the directions across the columns of W A:

    C = (Aᵀ W² A)⁻¹            covariance of the field,
    b̂ = C Aᵀ W² r              the field; the 3 × R matrix before r unmixes the readings,
    W A = [Q₁ Q₂] [T; 0]        a complete QR decomposition,
    d = Q₂ᵀ W r                 the R - 3 differential channels: white, of unit variance, free of the field.

b̂ and d are independent, and together they are all of r: rᵀ W² r = b̂ᵀ C⁻¹ b̂ + |d|². The field of each sample is a
nuisance of three numbers. So the likelihood of the sensors' errors is that of d, and of the one number of b̂ that is
known otherwise: its length |b̂|, of variance uᵀ C u along its direction u, against the scalar magnetometer.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.linalg import inv

from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Elimination:
    """The linear maps from the rows of a sample to its field and to its differential channels.

    Parameters
    ----------
    unmixing : (3, R) array
        C Aᵀ W²: from the readings without bias to the field.
    covariance : (3, 3) array
        C, of that field, in the square of its unit.
    directions : (R, R - 3) array
        W Q₂: ``readings @ directions`` are the differential channels, of unit variance.
    """

    unmixing: FloatArray
    covariance: FloatArray
    directions: FloatArray

    @classmethod
    def of(cls, response: FloatArray, weight: FloatArray) -> "Elimination":
        """Return the elimination of an unknown field.

        Parameters
        ----------
        response : (R, 3) array
            A: what each row reads of the field.
        weight : (R,) array
            Inverse standard deviation of each row's noise; zero for a row that does not count.
        """
        weighted = weight[:, None] ** 2 * response
        covariance = inv(response.T @ weighted)
        basis, _ = np.linalg.qr(weight[:, None] * response, mode="complete")
        return cls(covariance @ weighted.T, covariance, weight[:, None] * basis[:, 3:])

    @classmethod
    def of_sensors(cls, errors: SensorErrors, noise_T: FloatArray) -> "Elimination":
        """Return the elimination for the readings of an array's sensors.

        Parameters
        ----------
        errors : SensorErrors
            Of the K sensors; their matrices D Λ are the response.
        noise_T : (K,) array
            Standard deviation of the noise of each sensor's axes, tesla.
        """
        return cls.of(errors.matrix.reshape(-1, 3), 1 / np.repeat(noise_T, 3))

    @classmethod
    def of_known_field(cls, weight: FloatArray) -> "Elimination":
        """Return that of rows from which a field known otherwise is taken off: each is a channel of its own."""
        return cls(np.zeros((3, len(weight))), np.zeros((3, 3)), np.diag(weight))

    @property
    def complement(self) -> FloatArray:
        """(R, R) quadratic form W Q₂ Q₂ᵀ W of the differential channels' energy |d|² in the readings without bias."""
        return self.directions @ self.directions.T

    def variance_along(self, direction: FloatArray) -> FloatArray:
        """Return the variance (N,) of the field along directions (3, N): uᵀ C u for u of unit length."""
        return np.asarray(np.einsum("in,in->n", self.covariance @ direction, direction))


def gram(columns: FloatArray) -> FloatArray:
    """Return the (M, M) sum of the outer products of the columns (M, N)."""
    width, count = columns.shape
    total = np.zeros((width, width))
    # 900_000: multiplications up to which OpenBLAS does a product without packing: above, as for A Aᵀ, it takes thrice
    # as long.
    size = max(1, 900_000 // width**2)
    for start in range(0, count, size):
        part = columns[:, start : start + size]
        total[:-1] += part[:-1] @ part.T
    total[-1, :-1] = total[:-1, -1]
    total[-1, -1] = columns[-1] @ columns[-1]
    return total


def ridged(information: FloatArray) -> FloatArray:
    """Return information matrices (..., P, P) with a ridge, too small to be seen in directions that the data tell.

    Of matrices that are zero it makes some that are not, so that what has no score gets no value.
    """
    mean = np.asarray(np.trace(information, axis1=-2, axis2=-1) / information.shape[-1])
    size = np.where(mean > 0, mean, 1.0)
    # Part of the mean information that is added in each direction: above rounding, and below all that data tell.
    return information + 1e-9 * size[..., None, None] * np.eye(information.shape[-1])


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations: information matrix (P, P), score (P,), energy of the channels and their number."""

    information: FloatArray
    score: FloatArray
    energy: float
    count: float

    @classmethod
    def by_field(cls, response: FloatArray, moments: FloatArray, count: float) -> "Normal":
        """Return the normal equations of channels that depend on the field of the sensors, and on Q unknowns more.

        Parameters
        ----------
        response : (12 K, 12) array
            Of the field to the rows [D Λ | o], as of ``ChannelMaps``.
        moments : (13 + Q, 13 + Q) array
            Of the whitened derivatives by direction ⊗ [field, 1] and by the other unknowns, and of the residuals.
        count : float
            Number of channels.
        """
        from scipy.linalg import block_diag

        jacobian = block_diag(response, np.eye(len(moments) - 13))
        score = -jacobian @ moments[:-1, -1]
        return cls(jacobian @ moments[:-1, :-1] @ jacobian.T, score, float(moments[-1, -1]), count)

    @classmethod
    def none(cls, size: int) -> "Normal":
        """Return those of no channel over so many unknowns."""
        return cls(np.zeros((size, size)), np.zeros(size), 0.0, 0)

    def padded(self, size: int) -> "Normal":
        """Return the normal equations over so many unknowns, of which the first are the present ones."""
        more = (0, size - len(self.score))
        return replace(self, information=np.pad(self.information, more), score=np.pad(self.score, more))

    def by(self, jacobian: FloatArray) -> "Normal":
        """Return the normal equations over Q unknowns, from the derivative (P, Q) of the present ones by these."""
        return replace(self, information=jacobian.T @ self.information @ jacobian, score=jacobian.T @ self.score)

    def over(self, factor: float) -> "Normal":
        """Return the normal equations of channels whose variances are larger by a factor."""
        return Normal(self.information / factor, self.score / factor, self.energy / factor, self.count)

    def __add__(self, other: "Normal") -> "Normal":
        """Return the normal equations of both sets of samples."""
        return Normal(
            self.information + other.information,
            self.score + other.score,
            self.energy + other.energy,
            self.count + other.count,
        )

    def __sub__(self, other: "Normal") -> "Normal":
        """Return the normal equations without a part of the samples."""
        return self + replace(other.over(-1.0), count=-other.count)


ROUNDING = 1e-12
"""Part of the largest of some numbers below which another one is rounding: of an eigenvalue, its direction is open."""

Predict = Callable[[FloatArray, np.ndarray], tuple[FloatArray, FloatArray]]
"""From unknowns (m, P) of the problems at an index (m,) to their data (m, D) and these' derivatives (m, D, P)."""

IsSmall = Callable[[FloatArray, FloatArray], np.ndarray]
"""From unknowns (m, P) and the steps (m, P) to them to which (m,) of these are the last."""

MOST_STEPS = 60
"""Steps after which an iteration that has not settled ends; those that settle take fewer than half."""


def whitening(matrix: FloatArray, least: float) -> FloatArray:
    """Return W (Q, P) with Wᵀ M W = 1 over the directions in which a positive semidefinite matrix M (Q, Q) is not zero.

    Parameters
    ----------
    matrix : (Q, Q) array
        A covariance, or an information.
    least : float
        Part of the largest eigenvalue below which one counts as zero, the matrix scaled to a diagonal of ones.
    """
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    inverse = np.divide(1, size, out=np.zeros_like(size), where=size > 0)
    values, vectors = np.linalg.eigh(matrix * np.outer(inverse, inverse))
    seen = values > least * values[-1]
    return np.asarray(inverse[:, None] * vectors[:, seen] / np.sqrt(values[seen]))


def scaled(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return normal matrices (..., P, P) with a diagonal of ones, and the roots (..., P) of what it was.

    Where the diagonal is not positive it stays as it is.
    """
    diagonal = np.diagonal(normal, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    return normal / scale[..., :, None] / scale[..., None, :], scale


def root_of(covariance: FloatArray) -> FloatArray:
    """Return a square root (P, P) of a covariance (P, P), exactly zero where its diagonal is."""
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    values, vectors = np.linalg.eigh(scaled(covariance)[0])
    return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


@dataclass(frozen=True, eq=False)
class Solution:
    """The least-squares solutions of M problems.

    Parameters
    ----------
    unknowns : (M, P) array
        What is sought.
    covariance : (M, P, P) array
        For data of unit noise.
    chi_square : (M,) array
        Sum of the squared residuals.
    is_found : (M,) array of bool
        Whether the steps converged and the data determine every unknown.
    """

    unknowns: FloatArray
    covariance: FloatArray
    chi_square: FloatArray
    is_found: np.ndarray

    def take(self, at: np.ndarray) -> Self:
        """Return those of some problems."""
        return replace(self, **{name: value[at] for name, value in vars(self).items()})


def with_slopes(function: Callable[[Any], Any], unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what an analytic function makes of unknowns (n, P), and its derivatives (…, P).

    By complex steps: f(x + ih) is f(x) + ih f'(x) but for h² (Squire and Trapp 1998). Nothing is subtracted, so that
    the derivatives are as exact as the function.
    """
    step = 1e-30
    values = np.stack([function(unknowns + 1j * step * unit) for unit in np.eye(unknowns.shape[1])], axis=-1)
    return values[..., 0].real, values.imag / step


def solve_damped(predict: Predict, data: FloatArray, start: FloatArray, is_small: IsSmall) -> Solution:
    """Return the solutions of M problems by steps of Levenberg and Marquardt; none depends on its neighbours.

    Parameters
    ----------
    predict : Predict
        What makes the data.
    data : (M, D) array
        Whitened.
    start : (M, P) array
        Where to begin.
    is_small : IsSmall
        When the steps end.
    """
    unknowns = np.array(start, dtype=float)
    # 1e-3 and 1e12: added to a diagonal of one: nearly a Gauss-Newton step, and one so short that no shorter one lowers
    # χ² either.
    damping = np.full(len(data), 1e-3)
    is_open, is_found = np.full(len(data), True), np.full(len(data), False)
    chi_square, normal, slope = _linearize(predict, data, unknowns, np.arange(len(data)))
    # Part of the squares of the data by which rounding may raise χ².
    rounding = 1e-13 * np.sum(data**2, axis=1)
    for _ in range(MOST_STEPS):
        if not is_open.any():
            break
        at = np.flatnonzero(is_open)
        unit, scale = scaled(normal[at])
        damped = unit + damping[at, None, None] * np.eye(normal.shape[1])
        change = np.linalg.solve(damped, (slope[at] / scale)[..., None])[..., 0] / scale
        tried = unknowns[at] + change
        new_chi_square, new_normal, new_slope = _linearize(predict, data[at], tried, at)
        is_better = new_chi_square <= chi_square[at] + rounding[at]
        better = at[is_better]
        unknowns[better], chi_square[better] = tried[is_better], new_chi_square[is_better]
        normal[better], slope[better] = new_normal[is_better], new_slope[is_better]
        # Added to a diagonal of one: fifty times its rounding, so that equal unknowns make no singular matrix.
        # 0.03 and 10.0: by what the damping is multiplied after a step that lowers χ², and after one that does not.
        damping[at] = np.maximum(damping[at] * np.where(is_better, 0.03, 10.0), 1e-14)
        is_last = is_small(unknowns[at], change)
        is_found[at[is_last]] = True
        is_open[at[is_last | (damping[at] > 1e12)]] = False
    return _solution(unknowns, chi_square, normal, is_found)


def solution_at(predict: Predict, data: FloatArray, unknowns: FloatArray, is_found: np.ndarray) -> Solution:
    """Return the solutions of M problems whose unknowns (M, P) are known."""
    chi_square, normal, _ = _linearize(predict, data, unknowns, np.arange(len(data)))
    return _solution(unknowns, chi_square, normal, is_found)


def _solution(unknowns: FloatArray, chi_square: FloatArray, normal: FloatArray, is_found: np.ndarray) -> Solution:
    covariance, is_determined = _invert(normal)
    return Solution(unknowns, covariance, chi_square, is_found & is_determined & np.isfinite(unknowns).all(axis=1))


def _linearize(
    predict: Predict, data: FloatArray, unknowns: FloatArray, at: np.ndarray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return χ² (M,), infinite where it is not finite, normal matrix (M, P, P) and right-hand side (M, P)."""
    predicted, derivative = predict(unknowns, at)
    residual = data - predicted
    turned = np.swapaxes(derivative, 1, 2)
    chi_square = np.sum(residual**2, axis=1)
    finite = np.where(np.isfinite(chi_square), chi_square, np.inf)
    return finite, turned @ derivative, (turned @ residual[..., None])[..., 0]


def _invert(normal: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Return the inverses (M, P, P) and whether each exists; NaN where it does not."""
    unit, scale = scaled(np.where(np.isfinite(normal), normal, 0.0))
    values, vectors = np.linalg.eigh(unit)
    # Of scaled normal equations that determine every unknown.
    exists = values[:, 0] > values[:, -1] / 1e12
    inverse = vectors / np.where(exists[:, None], values, np.nan)[:, None, :] @ np.swapaxes(vectors, 1, 2)
    return inverse / scale[:, :, None] / scale[:, None, :], exists
