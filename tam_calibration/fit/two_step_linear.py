"""The two-step linear calibration of Yin 2014: each sensor's ellipsoid by least squares, then a linear alignment.

Built from what Li 2018a and Wu 2025 say of it: no simplification of the ellipsoid, a constant intensity, and the
misalignment from linear regression, angle by angle. That alignment reaches the Cramér-Rao bound, as Procrustes analysis
does not: it regresses what the errors of the ellipsoids, upper triangular, do not touch.
"""

from numpy.linalg import inv

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.alignment import field_products, regression_on_first, rotation_by_regression
from tam_calibration.fit.moments import finish, gather
from tam_calibration.model.array import Array
from tam_calibration.model.recording import SampleSource


def two_step_linear(recording: SampleSource, array: Array) -> Calibration:
    """Fit the errors of the sensors by Yin 2014.

    The intensity is taken as constant: the mean square of the scalar readings.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field; those without a scalar reading are left out where others have one.
    array : Array
        Geometry and noise of the K sensors.

    Returns
    -------
    Calibration
        With the covariance of a jackknife over groups of samples.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or a sensor cannot be aligned.
    """
    moments = gather(recording, "two-step linear").with_constant_intensity()
    center = ellipsoid.center_of(moments.quartic)
    unmix = ellipsoid.square_root(ellipsoid.shape_about(moments.quartic, center))
    products = field_products(moments.joint, unmix, center)
    matrix = inv(unmix) @ rotation_by_regression(regression_on_first(products))
    return finish("two_step_linear", recording, array, moments.data, matrix, center)
