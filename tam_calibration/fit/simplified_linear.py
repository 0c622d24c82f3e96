"""The simplified linear calibration of Zhang 2015: the errors to first order, then the alignment.

Li 2018a and Li 2018b compare themselves with it. It leaves what is of second order in the errors, about a thousand
nanotesla for scale factors that are a quarter off: no noise-free data and no number of samples mends that.
"""

import numpy as np
from numpy.linalg import LinAlgError, inv

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.alignment import field_products, regression_on_first, rotation_by_regression
from tam_calibration.fit.moments import finish, gather
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.units import FloatArray


def simplified_linear(recording: SampleSource, array: Array) -> Calibration:
    """Fit the errors of the sensors to first order.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field; those without a scalar reading are left out where others have one. Without any, the
        intensity is taken from the mean radius of the readings.
    array : Array
        Geometry and noise.

    Returns
    -------
    Calibration
        With the covariance of a jackknife over groups of samples, which does not know what the first order leaves.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or a sensor cannot be aligned.
    """
    moments = gather(recording, "simplified linear")
    # The expansion is about error-free sensors: it needs readings from zero, not from their centre.
    zero = -moments.data.origin_T / moments.data.radius_T
    from_zero = ellipsoid.move_origin(moments.quartic, np.broadcast_to(zero, (len(moments.quartic), *zero.shape)))
    unmix, bias = first_order(from_zero)
    center = bias + zero
    products = field_products(moments.joint, unmix, center)
    matrix = inv(unmix) @ rotation_by_regression(regression_on_first(products))
    return finish("simplified_linear", recording, array, moments.data, matrix, center)


def first_order(moments: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return M and i of the field M (z - i) that meets s² - |z|² = 2 Σ δ z² + 2 (m xy + g xz + n yz) - 2 zᵀi.

    Parameters
    ----------
    moments : (..., 11, 11) array
        Of ``ellipsoid.monomials`` of readings z from zero and intensities s, in one unit.

    Returns
    -------
    (..., 3, 3) array, (..., 3) array
        M = [[1 + δx, m, g], [0, 1 + δy, n], [0, 0, 1 + δz]] and i.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid.
    """
    right = moments[..., :9, 10] - moments[..., :9, :3].sum(axis=-1)
    try:
        unknowns = np.linalg.solve(moments[..., :9, :9], right[..., None])[..., 0]
    except LinAlgError:
        raise InputError(ellipsoid.NO_ELLIPSOID) from None
    unmix = np.zeros((*unknowns.shape[:-1], 3, 3))
    for axis in range(3):
        unmix[..., axis, axis] = 1 + unknowns[..., axis] / 2
    unmix[..., 0, 1], unmix[..., 0, 2], unmix[..., 1, 2] = np.moveaxis(unknowns[..., 3:6], -1, 0)
    return unmix, -unknowns[..., 6:] / 2
