"""Robust nominal fits of real recordings: an ellipsoid for each sensor, or a constant field that attitudes turn."""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.linalg import LinAlgError, cholesky, det, inv, lstsq, norm, svd

from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray, from_nanotesla

_ROUNDS = 30
"""Iterations of fit and weights."""

_CUT = 4.685
"""Robust standard deviations beyond which Tukey's weights are zero: 95 % efficient for normal noise."""

_NORMAL_MAD = 1 / NormalDist().inv_cdf(0.75)
"""Standard deviation of a normal law over the median of its absolute values."""

_EARTH_T = tuple(from_nanotesla(bound) for bound in (15_000.0, 100_000.0))
"""Bounds of the geomagnetic field: a fit beyond them diverged."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Nominal readings = response · field + bias.

    Parameters
    ----------
    field_T : (N, 3) array
        In the frame of the array.
    response : (K, 3, 3) array
    bias_T : (K, 3) array
    """

    field_T: FloatArray
    response: FloatArray
    bias_T: FloatArray

    @property
    def readings_T(self) -> FloatArray:
        """Nominal readings (N, K, 3)."""
        return np.asarray(np.einsum("kij,nj->nki", self.response, self.field_T) + self.bias_T)


def fit_ellipsoids(readings_T: FloatArray, scalar_T: FloatArray | None) -> Fit:
    """Fit |U (reading - bias)| = intensity for each sensor, and turn all sensors into the frame of the first.

    Parameters
    ----------
    readings_T : (N, K, 3) array
    scalar_T : (N,) array, optional
        Intensity as measured; without it a constant.

    Raises
    ------
    Refused
        When the readings of a sensor lie on no ellipsoid of the size of the Earth's field.
    """
    length = np.ones(len(readings_T)) if scalar_T is None else scalar_T / scalar_T.mean()
    sensors = [_ellipsoid(readings_T[:, k], length, k + 1) for k in range(readings_T.shape[1])]
    first = _directions(readings_T[:, 0], *sensors[0])
    intensity_T = det(inv(sensors[0][0])) ** (1 / 3) if scalar_T is None else scalar_T.mean()
    matrices, field = [], np.zeros_like(first)
    for k, (upper, bias) in enumerate(sensors):
        unit = _directions(readings_T[:, k], upper, bias)
        left, _, right = svd(unit.T @ first)
        turn = left @ np.diag([1, 1, det(left @ right)]) @ right
        matrices.append(inv(upper) @ turn / intensity_T)
        field += unit @ turn
    field *= (intensity_T * length / norm(field, axis=1))[:, None]
    return Fit(field, np.array(matrices), np.array([bias for _, bias in sensors]))


def _directions(reading_T: FloatArray, upper: FloatArray, bias_T: FloatArray) -> FloatArray:
    unit = (reading_T - bias_T) @ upper.T
    return np.asarray(unit / norm(unit, axis=1, keepdims=True))


def _ellipsoid(reading_T: FloatArray, wanted: FloatArray, number: int) -> tuple[FloatArray, FloatArray]:
    """Return U, upper triangular, and the bias of |U (reading - bias)| = wanted, by Gauss–Newton with Tukey's weights.

    The wanted lengths (N,) have a mean of one.
    """
    middle, scale = reading_T.mean(axis=0), norm(reading_T - reading_T.mean(axis=0), axis=1).mean()
    point = (reading_T - middle) / scale
    upper, bias = _algebraic(point, number)
    places = np.triu_indices(3)
    for _ in range(_ROUNDS):
        turned = (point - bias) @ upper.T
        length = norm(turned, axis=1)
        unit = turned / length[:, None]
        slopes = np.column_stack([unit[:, places[0]] * (point - bias)[:, places[1]], -unit @ upper])
        weight = _tukey(length - wanted) ** 0.5
        step = lstsq(weight[:, None] * slopes, weight * (wanted - length), rcond=None)[0]
        upper[places] += step[:6]
        bias = bias + step[6:]
    size_T = scale * abs(det(upper)) ** (-1 / 3)
    if not (_EARTH_T[0] < size_T < _EARTH_T[1] and (np.diag(upper) > 0).all()):
        raise Refused(
            f"the readings of sensor {number} lie on no ellipsoid of the size of the Earth's field: the recording "
            "covers too few directions, or was disturbed"
        )
    return upper / scale, middle + scale * bias


def _algebraic(point: FloatArray, number: int) -> tuple[FloatArray, FloatArray]:
    """Return the ellipsoid x'Ax + b'x = 1 as U and bias."""
    x, y, z = point.T
    terms = np.column_stack([x**2, y**2, z**2, 2 * x * y, 2 * x * z, 2 * y * z, x, y, z])
    a, b, c, d, e, f, *linear = lstsq(terms, np.ones(len(point)), rcond=None)[0].tolist()
    square = np.array([[a, d, e], [d, b, f], [e, f, c]])
    try:
        bias = -0.5 * inv(square) @ np.array(linear)
        return cholesky(square / (1 + bias @ square @ bias)).T.copy(), bias
    except LinAlgError:
        raise Refused(f"the readings of sensor {number} lie on no ellipsoid: turn it through all directions") from None


def fit_attitude(readings_T: FloatArray, to_world: FloatArray) -> Fit:
    """Fit reading = matrix · turned constant field + bias, by turns for the matrices and the field.

    Parameters
    ----------
    readings_T : (N, K, 3) array
    to_world : (N, 3, 3) array

    Raises
    ------
    Refused
        When the attitudes show too little of the field.
    """
    samples, count = readings_T.shape[:2]
    flat = readings_T.reshape(samples, -1)
    general = np.column_stack([to_world.transpose(0, 2, 1).reshape(samples, 9), np.ones(samples)])
    # Each axis answers to (its row of the matrix) x (the field): the one pattern of rank one in nine coefficients.
    answers = lstsq(general, flat, rcond=None)[0][:9].T.reshape(-1, 3)
    field = svd(answers)[2][0]
    weight = np.ones_like(flat)
    for _ in range(_ROUNDS):
        features = np.column_stack([np.einsum("nji,j->ni", to_world, field), np.ones(samples)])
        solved = np.array([_weighted(features, one, w) for one, w in zip(flat.T, weight.T, strict=True)])
        matrix, bias = solved[:, :3], solved[:, 3]
        slopes = np.einsum("ri,nji->nrj", matrix, to_world).reshape(-1, 3)
        field = _weighted(slopes, (flat - bias).ravel(), weight.ravel())
        left = flat - np.einsum("nrj,j->nr", slopes.reshape(samples, -1, 3), field) - bias
        weight = np.stack([_tukey(one) for one in left.T], axis=1)
    response = matrix.reshape(count, 3, 3)
    size = abs(det(response[0])) ** (1 / 3)
    intensity_T = size * norm(field)
    if not _EARTH_T[0] < intensity_T < _EARTH_T[1]:
        raise Refused("the recorded attitudes and readings are those of no field of the Earth's size")
    turned = np.einsum("nji,j->ni", to_world, field)
    return Fit(turned * size, response / size, bias.reshape(count, 3))


def _weighted(features: FloatArray, values: FloatArray, weight: FloatArray) -> FloatArray:
    root = np.sqrt(weight)
    return np.asarray(lstsq(root[:, None] * features, root * values, rcond=None)[0])


def _tukey(left: FloatArray) -> FloatArray:
    """Return Tukey's weights (N,) of residuals."""
    scale = _NORMAL_MAD * np.median(np.abs(left))
    return np.asarray(np.maximum(1 - (left / (_CUT * max(scale, 1e-12 * np.abs(left).max() + 1e-30))) ** 2, 0) ** 2)
