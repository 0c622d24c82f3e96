"""The lossless scalar calibration of Wu 2025 in three steps, from moments of one pass over the data.

Step 1 finds each sensor's bias as the centre of an ellipsoid, step 2 its scale factors and non-orthogonality against
the scalar reference, step 3 the misalignment between sensors by Procrustes analysis.
"""

from numpy.linalg import inv

from tam_calibration.array import Array
from tam_calibration.calibration import Calibration
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.alignment import field_products, procrustes
from tam_calibration.fit.moments import Moments, finish, gather
from tam_calibration.fit.published_step import published_center
from tam_calibration.fit.result import Estimate, make_calibration
from tam_calibration.fit.sandwich import sandwich
from tam_calibration.fit.scale import free_scale
from tam_calibration.recording import SampleSource
from tam_calibration.sensor_errors import SensorErrors
from tam_calibration.units import FloatArray

_NAME = "lossless"


def lossless(recording: SampleSource, array: Array, *, as_published: bool = False) -> Calibration:
    """Fit the errors of the sensors by Wu 2025.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field; those without a scalar reading are left out where others have one.
    array : Array
        Geometry and noise.
    as_published : bool
        Step 1 as printed: a constant intensity, and sequential quadratic programming on eq. 12. Otherwise its
        right-hand side follows the scalar reading, and the linear solution, which is the same minimum, is kept.

    Returns
    -------
    Calibration
        With the covariance of ``sandwich``; as published that of a jackknife over groups of samples.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or a sensor is left-handed.
    """
    if as_published:
        moments = gather(recording, _NAME)
        center = published_center(moments)
        matrix = _matrix_about(moments, center)
        return finish("lossless (as published)", recording, array, moments.data, matrix, center)
    moments, matrix, center = _fit(recording)
    errors = _errors(moments, matrix, center)
    factor = 1.0 if moments.data.has_scalar else float(free_scale(matrix))
    covariance = sandwich(moments, errors, factor)
    estimate = Estimate(errors, covariance, covariance_from_noise=False, intensity_T=moments.data.radius_T / factor)
    return make_calibration(_NAME, recording, array, estimate)


def estimate(recording: SampleSource) -> SensorErrors:
    """Return the errors alone, without covariance and quality: the same numbers in a third of the time.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or a sensor is left-handed.
    """
    return _errors(*_fit(recording))


def _fit(recording: SampleSource) -> tuple[Moments, FloatArray, FloatArray]:
    """Return the moments, and from them matrices D Λ (K, 3, 3) and centres (K, 3)."""
    moments = gather(recording, _NAME, groups=1)
    center = ellipsoid.center_of(moments.quartic)
    return moments, _matrix_about(moments, center)[0], center[0]


def _errors(moments: Moments, matrix: FloatArray, center: FloatArray) -> SensorErrors:
    factor = 1.0 if moments.data.has_scalar else float(free_scale(matrix))
    errors = SensorErrors.from_matrix(factor * matrix, moments.data.origin_T + moments.data.radius_T * center)
    errors.misalignment[0] = 0
    return errors


def _matrix_about(moments: Moments, center: FloatArray) -> FloatArray:
    """Return the matrices D Λ (S, K, 3, 3) of steps 2 and 3, about the centres (S, K, 3) of step 1."""
    unmix = ellipsoid.square_root(ellipsoid.shape_about(moments.quartic, center))
    rotation = procrustes(field_products(moments.joint, unmix, center)[:, :, 0])
    matrix: FloatArray = inv(unmix) @ rotation
    return matrix
