"""The covariance of the lossless fit: the sandwich of its estimating equations, which needs no noise to be stated.

The fit is where 9 sums of each sensor's ellipsoid, of its monomials m times the residual e = mᵀ a - s², and 3 sums of
each further sensor's alignment, of (Λ b_1) × b, vanish. How far noise moves it is told by the spread of their terms
over the samples, and by how the sums answer to a step of the estimate. Terms that follow each other are added up
before, to about a thousand runs: what neighbouring samples share counts too.
"""

import numpy as np
from numpy.linalg import inv

from tam_calibration.fit import ellipsoid
from tam_calibration.fit.moments import Moments
from tam_calibration.fit.scale import Normalized
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_RUNS = 1000
_CROSS = np.zeros((3, 3, 3))
"""a × b is its contraction with a, then b, over the last two axes."""
_CROSS[(0, 1, 2), (1, 2, 0), (2, 0, 1)] = 1
_CROSS[(0, 1, 2), (2, 0, 1), (1, 2, 0)] = -1


def sandwich(moments: Moments, errors: SensorErrors, factor: float) -> FloatArray:
    """Return the covariance (12 K, 12 K) of the flattened parameters that ``lossless`` found.

    Parameters
    ----------
    moments : Moments
        Of all samples.
    errors : SensorErrors
        The estimate.
    factor : float
        By how much its scale exceeds that of the moments; 1 where there is a scalar reference.
    """
    data = moments.data
    measurement, center = errors.measurement / factor, (errors.bias_T - data.origin_T) / data.radius_T
    unmix = inv(measurement)
    spread = _spread(data, unmix, center, errors.rotation)
    response = _response(moments, measurement, center, errors.rotation)
    if not data.has_scalar:
        # The determinants keep their geometric mean.
        growth = np.einsum("kij,kijq->q", inv(measurement @ errors.rotation).swapaxes(1, 2), response[:, :, :3])
        matrix = measurement @ errors.rotation
        response[:, :, :3] -= matrix[..., None] * growth / (3 * len(matrix))
    response[:, :, :3] *= factor
    response[:, :, 3] *= data.radius_T
    by_parameter = errors.jacobian().reshape(len(center), 12, 12)
    steps = np.linalg.solve(by_parameter, response.reshape(len(center), 12, -1)).reshape(12 * len(center), -1)
    steps[9:12] = 0
    count = moments.quartic[0, 0, 9, 9]
    covariance: FloatArray = count / (count - 9) * steps @ spread @ steps.T
    return covariance


def _spread(data: Normalized, unmix: FloatArray, center: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return the sum over runs of the outer products of the terms: 9 K of the ellipsoids, 3 K - 3 of the alignment."""
    sensors = len(center)
    shape = (np.swapaxes(unmix, 1, 2) @ unmix)[:, ellipsoid.ROWS, ellipsoid.COLUMNS]
    size = 12 * sensors - 3
    spread = np.zeros((size, size))
    run = max(1, data.source.sample_count // _RUNS)
    for points, intensity in data.blocks():
        finite = np.isfinite(intensity)
        if not finite.all():
            points, intensity = points[:, finite], intensity[finite]
        points[:-1] -= center.reshape(-1, 1)
        terms = np.empty((size, points.shape[1]))
        square, monomials = intensity * intensity, np.empty((11, points.shape[1]))
        for sensor in range(sensors):
            own = points[3 * sensor : 3 * sensor + 3]
            ellipsoid.monomial_columns(own, intensity, monomials)
            residuals = shape[sensor] @ monomials[:6] - square
            np.multiply(monomials[:9], residuals, out=terms[9 * sensor : 9 * sensor + 9])
            field = unmix[sensor] @ own
            if sensor == 0:
                first = field
            else:
                place = 9 * sensors + 3 * (sensor - 1)
                terms[place : place + 3] = _cross(rotation[sensor] @ first, field)
        if run > 1 and terms.shape[1]:
            terms = np.add.reduceat(terms, np.arange(0, terms.shape[1], run), axis=1)
        spread += terms @ terms.T
    return spread


def _cross(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return the cross products (3, N) of vectors (3, N)."""
    return left[[1, 2, 0]] * right[[2, 0, 1]] - left[[2, 0, 1]] * right[[1, 2, 0]]


def _response(moments: Moments, measurement: FloatArray, center: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return how far a unit of each sum moves [D Λ | o]: (K, 3, 4, 12 K - 3), minus the inverse of the derivative."""
    sensors = len(center)
    unmix = inv(measurement)
    # Each ellipsoid: from its 9 sums to δa and -2 A δo, to δΩ = X Ω and δo.
    normal = ellipsoid.move_origin(moments.quartic[0], center)[:, :9, :9]
    linear = -inv(normal)
    shape = np.swapaxes(unmix, 1, 2) @ unmix
    bias = -inv(shape) @ linear[:, 6:] / 2
    change = ellipsoid.symmetric(np.swapaxes(linear[:, :6], 1, 2))
    change = np.swapaxes(measurement, 1, 2)[:, None] @ change @ measurement[:, None]
    upper = np.triu(change) - change * np.eye(3) / 2
    # The alignment answers to the fields of both sensors, δb = X b - Ω δo, and to its own 3 sums.
    response = np.zeros((sensors, 3, 4, 12 * sensors - 3))
    for sensor in range(sensors):
        own = slice(9 * sensor, 9 * sensor + 9)
        response[sensor, :, :3, own] = -np.moveaxis(measurement[sensor] @ upper[sensor] @ rotation[sensor], 0, -1)
        response[sensor, :, 3, own] = bias[sensor]
        if sensor:
            response[sensor, :, :3] += _turned(
                moments, sensor, upper, unmix @ bias, measurement, center, rotation[sensor]
            )
    return response


def _turned(
    moments: Moments,
    sensor: int,
    upper: FloatArray,
    shift: FloatArray,
    measurement: FloatArray,
    center: FloatArray,
    rotation: FloatArray,
) -> FloatArray:
    """Return how far a unit of each sum turns a sensor: (3, 3, 12 K - 3) steps of D Λ."""
    sensors = len(center)
    axis = slice(3 * sensor, 3 * sensor + 3)
    unmix, joint = inv(measurement[sensor]), moments.joint[0]
    count, total = joint[-1, -1], unmix @ (joint[axis, -1] - joint[-1, -1] * center[sensor])
    mean = joint[axis, -1] / count
    second = joint[axis, axis] - count * np.outer(mean, mean)
    products = unmix @ second @ unmix.T + np.outer(total, total) / count
    turns = np.zeros((3, 12 * sensors - 3))
    for other, sign, frame in ((sensor, 1.0, np.eye(3)), (0, -1.0, rotation)):
        own = slice(9 * other, 9 * other + 9)
        matrix = frame @ upper[other] @ frame.T
        turns[:, own] += sign * np.einsum("ijl,jm,qlm->iq", _CROSS, products, matrix)
        turns[:, own] -= sign * np.einsum("ijl,j,lq->iq", _CROSS, total, frame @ shift[other])
    place = 9 * sensors + 3 * (sensor - 1)
    turns[:, place : place + 3] += np.eye(3)
    turns = np.linalg.solve(np.trace(products) * np.eye(3) - products, turns)
    # D [ρ]× Λ
    steps: FloatArray = np.einsum("ai,ijl,jq,lb->abq", measurement[sensor], _CROSS, turns, rotation)
    return steps
