"""The evidence of a law: log marginal likelihoods over that of no law, the nominal parameters marginalised.

A law adds A_n c to the whitened residual of sample n. Either c is the same throughout, with independent normal elements
(``Normal``), or it goes with an index such as time as p independent Ornstein-Uhlenbeck processes (``course``), whose
precision is tridiagonal (Rue and Held 2005, section 2.4), so that the cost is proportional to the number of bins.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.least_squares import ROUNDING
from tam_calibration.gap.laws.decisions import SIZES
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Products:
    """Products of the responses of N samples to r rows, with each other and with what else the samples see.

    Parameters
    ----------
    information : (N, r, r) array
        On shifts of the rows.
    score : (N, r, 1) array
        With the residual.
    cross : (N, r, m) array
        With changes by nuisance parameters.
    turn : (m, s) array
        To combinations of these changes that are orthonormal.
    """

    information: FloatArray
    score: FloatArray
    cross: FloatArray
    turn: FloatArray

    def part(self, rows: slice) -> "Products":
        """Return the products of some rows."""
        return Products(self.information[:, rows, rows], self.score[:, rows], self.cross[:, rows], self.turn)

    def arranged(self, of_samples: Callable[[FloatArray], FloatArray]) -> "Products":
        """Return them with what a function makes of their arrays (N, ...)."""
        return Products(of_samples(self.information), of_samples(self.score), of_samples(self.cross), self.turn)


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums over samples in B bins, for p columns and q nuisance directions.

    Parameters
    ----------
    information : (B, p, p) array
    products : (B, p, 1 + q) array
        Of the columns with the residual, and with those combinations of the nuisance directions that they see.
    place : (B,) array
        Mean of the index in each bin, increasing within a branch.
    is_first : (B,) array of bool
        Whether a bin begins a branch, which is independent of the previous.
    """

    information: FloatArray
    products: FloatArray
    place: FloatArray
    is_first: NDArray[np.bool_]

    @property
    def score(self) -> FloatArray:
        """(B, p) products with the residual."""
        return self.products[:, :, 0]

    @property
    def cross(self) -> FloatArray:
        """(B, p, q) information between the columns and the nuisance directions."""
        return self.products[:, :, 1:]

    @cached_property
    def band(self) -> FloatArray:
        """(p + 1, B p) information as LAPACK takes a band: the main diagonal is the last row, those above it follow."""
        bins, width = self.score.shape
        band = np.zeros((width + 1, bins, width))
        for i in range(width):
            for j in range(i, width):
                band[width - (j - i), :, j] = self.information[:, i, j]
        return band.reshape(width + 1, -1)

    @classmethod
    def of(cls, shifts: FloatArray, of_rows: Products, bins: "Bins", is_apart: bool = False) -> "Sums":
        """Return the sums of shifts of r rows in N samples.

        Parameters
        ----------
        shifts : (N, r, f) or (N, r, p) array
        of_rows : Products
        bins : Bins
        is_apart : bool
            As of ``normal_equations``.
        """
        # Some bins after the other: the arranged products of all sensors are large.
        sums = [
            normal_equations(part.arranged(shifts), of_rows.arranged(part.arranged), is_apart) for part in bins.parts()
        ]
        information, products = (np.concatenate(one) for one in zip(*sums, strict=True))
        return cls(information, products, bins.place, bins.is_first)

    def part(self, columns: NDArray[np.intp], factor: float) -> "Sums":
        """Return the sums of some columns, multiplied by a factor."""
        own, right = self.information[:, columns[:, None], columns], self.products[:, columns]
        return Sums(factor**2 * own, factor * right, self.place, self.is_first)

    def merged(self, bin_count: int) -> "Sums":
        """Return the sums over runs of neighbouring bins, about so many."""
        step = len(self.place) // bin_count
        if step < 2:
            return self
        starts = np.flatnonzero((np.arange(len(self.place)) % step == 0) | self.is_first)
        information, products = (np.add.reduceat(one, starts, axis=0) for one in (self.information, self.products))
        size = np.diff(np.append(starts, len(self.place)))
        return Sums(information, products, np.add.reduceat(self.place, starts) / size, self.is_first[starts])


@dataclass(frozen=True, eq=False)
class Bins:
    """Bins of an index: the order of the samples, padded with -1 to B rows of equal length."""

    order: NDArray[np.intp]
    place: FloatArray
    is_first: NDArray[np.bool_]

    @classmethod
    def of(cls, index: FloatArray, bin_count: int, branch: FloatArray | None = None) -> "Bins":
        """Return bins of about equal counts over an index (N,), separate in each branch (N,)."""
        branches = np.zeros(len(index)) if branch is None else branch
        size = max(-(-len(index) // bin_count), 1)
        rows, places, firsts = [], [], []
        for value in np.unique(branches):
            own = np.flatnonzero(branches == value)
            own = own[np.argsort(index[own], kind="stable")]
            parts = -(-len(own) // size)
            padded = np.append(own, np.full(parts * size - len(own), -1)).reshape(parts, size)
            rows.append(padded)
            places.append(np.where(padded >= 0, index[padded], 0).sum(axis=1) / (padded >= 0).sum(axis=1))
            firsts.append(np.arange(parts) == 0)
        return cls(np.vstack(rows), np.concatenate(places), np.concatenate(firsts))

    @classmethod
    def of_time(cls, time_s: FloatArray) -> "Bins":
        """Return bins of a course in time: an eighth of a second in a minute, at least."""
        return cls.of(time_s, max(min(512, len(time_s) // 2), 4))

    def parts(self) -> Iterator["Bins"]:
        """Yield runs of bins, an eighth of them each."""
        size = -(-len(self.place) // 8)
        for first in range(0, len(self.place), size):
            taken = slice(first, first + size)
            yield Bins(self.order[taken], self.place[taken], self.is_first[taken])

    def arranged(self, values: FloatArray) -> FloatArray:
        """Return values (N, ...) by bins, (B, m, ...), zero where a bin has fewer samples."""
        taken: FloatArray = values[self.order]
        if (self.order < 0).any():
            taken[self.order < 0] = 0
        return taken

    def spread(self, by_bin: NDArray[Any], count: int) -> NDArray[Any]:
        """Return values by bin (B, ...) at the samples (N, ...)."""
        result = np.empty((count, *by_bin.shape[1:]))
        bins, places = np.nonzero(self.order >= 0)
        result[self.order[bins, places]] = by_bin[bins]
        return result


@dataclass(frozen=True, eq=False)
class Fit:
    """The evidence of a law, mean and standard deviation (B, p) of its coefficients, and the variance of a course."""

    evidence: float
    mean: FloatArray
    deviation: FloatArray | None = None
    variance: float = 1.0


def course(sums: Sums, length: float, variances: FloatArray, with_errors: bool = False) -> Fit:
    """Return the best fit of p processes of one correlation length, at the best of some variances.

    Parameters
    ----------
    sums : Sums
        Of B bins.
    length : float
        Correlation length, in units of the index; 0 for independent bins.
    variances : (V,) array
        Variances of the processes that are tried, from the smallest on as long as the evidence rises.
    with_errors : bool
        Whether the standard deviations are wanted.
    """
    diagonal, beside, log_determinant = _precision(sums, length)
    evidence, half, factor, variance = _at(sums, diagonal, beside, log_determinant, variances[0])
    for larger in variances[1:]:
        tried = _at(sums, diagonal, beside, log_determinant, larger)
        if tried[0] < evidence:
            break
        evidence, half, factor, variance = tried
    mean = _substituted(factor, half, "N").reshape(sums.score.shape)
    deviation = _deviations(factor, mean.shape) if with_errors else None
    return Fit(evidence, mean, deviation, variance)


def _precision(sums: Sums, length: float) -> tuple[FloatArray, FloatArray, float]:
    """Return the tridiagonal precision of a process of unit variance, and the log determinant of its covariance."""
    step = np.diff(sums.place)
    kept = np.exp(-np.maximum(step, 0) / length) if length > 0 else np.zeros(len(step))
    kept = np.where(sums.is_first[1:], 0.0, np.minimum(kept, 1 - 1e-9))
    inverse = 1 / (1 - kept**2)
    diagonal = np.ones(len(sums.place))
    diagonal[:-1] += kept**2 * inverse
    diagonal[1:] += kept**2 * inverse
    return diagonal, -kept * inverse, float(-np.log(inverse).sum())


def _at(
    sums: Sums, diagonal: FloatArray, beside: FloatArray, log_determinant: float, variance: float
) -> tuple[float, FloatArray, FloatArray, float]:
    """Return the evidence, the mean before the last substitution by the factor, the factor, and the variance."""
    from scipy.linalg.lapack import dpbtrf

    bins, width = sums.score.shape
    band = sums.band.copy()
    band[-1] += np.repeat(diagonal, width) / variance
    band[0, width:] = np.repeat(beside, width) / variance
    factor = dpbtrf(band)[0]
    half = _substituted(factor, sums.products.reshape(bins * width, -1), "T")
    products = half.T @ half
    left = (1 + 1e-9) * np.eye(len(products) - 1) - products[1:, 1:]
    beta = -np.linalg.solve(left, products[1:, 0])
    determinants = width * (log_determinant + bins * np.log(variance)) + 2 * np.log(factor[-1]).sum()
    determinants += 2 * np.log(np.diag(np.linalg.cholesky(left))).sum()
    evidence = float(0.5 * (products[0, 0] - products[1:, 0] @ beta - determinants))
    return evidence, half[:, 0] - half[:, 1:] @ beta, factor, float(variance)


def _substituted(factor: FloatArray, right: FloatArray, trans: str) -> FloatArray:
    """Return the solution of equations with an upper triangular band, or with its transpose."""
    from scipy.linalg.lapack import dtbtrs

    return np.asarray(dtbtrs(factor, right, uplo="U", trans=trans)[0])


def _deviations(factor: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Return standard deviations from the diagonal of the inverse, by probing with random signs (Hutchinson)."""
    from scipy.linalg import cho_solve_banded

    signs = np.random.default_rng(0).choice([-1.0, 1.0], (factor.shape[1], 64))
    inverse = np.mean(signs * cho_solve_banded((factor, False), signs, check_finite=False), axis=1)
    return np.asarray(np.sqrt(np.maximum(inverse, 0)).reshape(shape))


def normal_equations(shifts: FloatArray, of_rows: Products, is_apart: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return the information (B, P, P) on coefficients, and their products (B, P, 1 + s), in bins of n samples.

    Parameters
    ----------
    shifts : (B, n, r, f) or (B, n, r, P) array
        What a coefficient of one shifts each of r rows by: f values of each row, which has coefficients of its own,
        P = r f; or what each of P coefficients does to all rows.
    of_rows : Products
        With samples (B, n) in place of (N,).
    is_apart : bool
        Whether each row has coefficients of its own.
    """
    information, right = of_rows.information, (of_rows.score, of_rows.cross)
    bins, count, rows, _ = information.shape
    width = shifts.shape[3]
    if not is_apart:
        flat = shifts.reshape(bins, -1, width)
        own = np.swapaxes(flat, 1, 2) @ (information @ shifts).reshape(flat.shape)
        score, cross = (np.swapaxes(flat, 1, 2) @ one.reshape(bins, count * rows, -1) for one in right)
        return own, np.concatenate([score, cross @ of_rows.turn], axis=2)
    turned = shifts.transpose(2, 0, 3, 1)
    weighed = ((information[:, :, one, :, None] * shifts).reshape(bins, count, -1) for one in range(rows))
    own = np.stack([values @ each for values, each in zip(turned, weighed, strict=True)], axis=1)
    score, cross = (np.stack([values @ one[:, :, row] for row, values in enumerate(turned)], axis=1) for one in right)
    products = np.concatenate([score, cross @ of_rows.turn], axis=3)
    return own.reshape(bins, rows * width, -1), products.reshape(bins, rows * width, -1)


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations of constant coefficients.

    Parameters
    ----------
    information : (P, P) array
    products : (P, 1 + q) array
        Of the columns with the residual, and with the nuisance directions.
    most : (P,) array
        Information if every shift were seen.
    count : int
        Of samples.
    """

    information: FloatArray
    products: FloatArray
    most: FloatArray
    count: int

    @classmethod
    def of(cls, shifts: FloatArray, of_rows: Products, is_apart: bool = False) -> "Normal":
        """Return the equations of shifts (N, r, f) or (N, r, P), as of ``normal_equations`` in one bin."""
        own, right = normal_equations(shifts[None], of_rows.arranged(lambda one: one[None]), is_apart)
        most = np.tensordot(np.trace(of_rows.information, axis1=1, axis2=2), shifts**2, 1)
        return cls(own[0], right[0], most.ravel() if is_apart else most.sum(axis=0), len(shifts))

    def part(self, columns: NDArray[np.intp]) -> "Normal":
        """Return the equations of some columns."""
        own = self.information[np.ix_(columns, columns)]
        return Normal(own, self.products[columns], self.most[columns], self.count)

    def fit(self) -> Fit:
        """Return the fit of the best common variance of the coefficients."""
        own = np.diag(self.information)
        seen = own > ROUNDING * self.most
        size = np.where(seen, np.sqrt(np.maximum(own, 0) / self.count), np.inf)
        score, cross = self.products[:, 0], self.products[:, 1:]
        return of_normal((self.information - cross @ cross.T) / np.outer(size, size), score / size, size, self.count)


def of_normal(information: FloatArray, score: FloatArray, size: FloatArray, whole: float = 0.0) -> Fit:
    """Return the fit from normal equations (P, P) and (P,), the coefficients divided by the columns' sizes (P,).

    Parameters
    ----------
    information : (P, P) array
        Beside the nominal parameters.
    score, size : (P,) array
        Products of the columns with the residual, and what the coefficients are divided by.
    whole : float
        Information of a column of size one with no nominal parameters.
    """
    values, vectors = np.linalg.eigh(information)
    # What the nominal parameters can do as well is not counted: its rest is made of the errors of the field.
    seen = values > 1e-4 * max(float(values[-1]), whole)
    values, vectors = values[seen], vectors[:, seen]
    along = vectors.T @ score
    weighed = 1 + SIZES[:, None] * values
    evidence = 0.5 * (SIZES[:, None] * along**2 / weighed - np.log(weighed)).sum(axis=1)
    best = int(evidence.argmax())
    mean = vectors @ (SIZES[best] * along / weighed[best]) / size
    return Fit(float(evidence[best]), mean[None])
