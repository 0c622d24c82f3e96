"""The lossless scalar calibration of Wu 2025 in three steps, from moments of one pass over the data."""

from numpy.linalg import inv

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.moments import Moments, field_products, finish, gather, procrustes
from tam_calibration.model.array import Array
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


def lossless(recording: SampleSource, array: Array, *, as_published: bool = False) -> Calibration:
    """Fit the errors of the sensors by Wu 2025.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field; those without a scalar reading are left out where others have one.
    array : Array
        Geometry and noise.
    as_published : bool
        Step 1 as printed: a constant intensity. Otherwise its right-hand side follows the scalar reading. Either way
        the linear solution is kept, at which the sequential quadratic programming on eq. 12 ends too.

    Returns
    -------
    Calibration
        With the covariance of a jackknife over groups of samples.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    """
    moments = gather(recording, "lossless")
    center = ellipsoid.center_of((moments.with_constant_intensity() if as_published else moments).quartic)
    name = "lossless (as published)" if as_published else "lossless"
    return finish(name, recording, array, moments.data, _matrix_about(moments, center), center)


def estimate(recording: SampleSource) -> SensorErrors:
    """Return the errors alone, without covariance and quality: the same numbers in a third of the time.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    """
    moments = gather(recording, "lossless", groups=1)
    center = ellipsoid.center_of(moments.quartic)
    return moments.data.errors_at(_matrix_about(moments, center)[0], center[0])[0]


def _matrix_about(moments: Moments, center: FloatArray) -> FloatArray:
    """Return the matrices D Λ (S, K, 3, 3) of steps 2 and 3, about the centres (S, K, 3) of step 1."""
    unmix = ellipsoid.square_root(ellipsoid.shape_about(moments.quartic, center))
    rotation = procrustes(field_products(moments.joint, unmix, center)[:, :, 0])
    return inv(unmix) @ rotation
