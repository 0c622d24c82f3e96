"""Fields of sensors that an ellipsoid has made orthogonal, and of their mean: the first step of all four papers."""

import numpy as np
from numpy.linalg import inv

from tam_calibration.fit import ellipsoid
from tam_calibration.fit.moments import Moments, gather
from tam_calibration.fit.published import first_order
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


def with_mean(values: FloatArray) -> FloatArray:
    """Return values (..., K, 3) of sensors with their mean as one sensor more, which Li's papers call the platform."""
    return np.concatenate([values, values.mean(axis=-2, keepdims=True)], axis=-2)


def orthogonal_fields(recording: Recording) -> FloatArray:
    """Return the fields (N, K + 1, 3) by the ellipsoids of the sensors and of their mean, each in its own frame."""
    moments = gather(recording, "ellipsoid", with_platform=True, groups=1)
    center = ellipsoid.center_of(moments.quartic)
    return _fields(moments, ellipsoid.square_root(ellipsoid.shape_about(moments.quartic, center))[0], center[0])


def first_order_fields(recording: Recording) -> FloatArray:
    """Return the same to first order in the errors, as ``simplified_linear`` does."""
    moments = gather(recording, "first order", with_platform=True, groups=1)
    zero = with_mean(-moments.data.origin_T / moments.data.radius_T)
    unmix, bias = first_order(ellipsoid.move_origin(moments.quartic, zero[None]))
    return _fields(moments, unmix[0], bias[0] + zero)


def _fields(moments: Moments, unmix: FloatArray, center: FloatArray) -> FloatArray:
    points = with_mean(moments.data.points) - center
    return np.asarray(moments.data.radius_T * np.einsum("kij,nkj->nki", unmix, points))


def own_errors(recording: Recording) -> SensorErrors:
    """Return the errors of the K sensors that these ellipsoids show: no misalignment."""
    moments = gather(recording, "ellipsoid", groups=1)
    center = ellipsoid.center_of(moments.quartic)
    unmix = ellipsoid.square_root(ellipsoid.shape_about(moments.quartic, center))
    return moments.data.errors_at(inv(unmix)[0], center[0])[0]
