"""The fast rotation calibration of Li 2018b: each sensor's ellipsoid, then the alignment to the mean reading.

The paper calibrates from ten samples of one turn about one axis. Such a turn determines 5 of the 9 parameters of a
sensor and 32 of the 45 of a cross; turns about z and x determine 44, about z, x and y all. What holds of the paper is
the alignment: three samples align sensors that are orthogonal already.
"""

import numpy as np
from numpy.linalg import inv

from tam_calibration.core.noise import complete_noise
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.alignment import field_products, into_frame_of_first, procrustes
from tam_calibration.fit.identifiability import require_determined
from tam_calibration.fit.moments import finish, gather
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import SKETCH, Recording, SampleSource
from tam_calibration.model.units import FloatArray

_NOISE_MARGIN = 10.0
"""Times the noise that a direction must be turned through to count: less would let noise determine a parameter."""
_ROUNDING = 1e-9
"""Least turn that counts without noise, of the field: what least squares lose to rounding."""


def fast_rotation(recording: SampleSource, array: Array) -> Calibration:
    """Fit the errors of the sensors by Li 2018b, where the turns determine them.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field, the array turned about three axes; those without a scalar reading are left out where
        others have one.
    array : Array
        Geometry and noise of the K sensors.

    Returns
    -------
    Calibration
        With the covariance of a jackknife over groups of samples.

    Raises
    ------
    InputError
        When the turns leave parameters open, as one turn about one axis does; it names them. When sensors
        are mirror images of others.
    """
    _require_turns(recording.thinned(SKETCH), array)
    moments = gather(recording, "fast rotation", with_platform=True)
    center = ellipsoid.center_of(moments.quartic)
    unmix = ellipsoid.square_root(ellipsoid.shape_about(moments.quartic, center))
    sensors = recording.sensor_count
    to_platform = field_products(moments.joint, unmix, center)[:, :sensors, sensors]
    matrix = into_frame_of_first(inv(unmix[:, :sensors]) @ procrustes(to_platform))
    return finish("fast_rotation", recording, array, moments.data, matrix, center[:, :sensors])


def count_determined(recording: Recording, array: Array) -> tuple[int, int]:
    """Return how many parameters the directions of a recording determine, and how many there are.

    The rank of the Jacobian: the differences between sensors see each row of [D Λ | o] along (b, 1), the intensity sees
    the nine parameters of an ellipsoid along the monomials of the readings. What rises above the noise is counted.

    Parameters
    ----------
    recording : Recording
        Raw readings; the directions are those of sensor 1 about the mean of its readings.
    array : Array
        Noise of the K sensors; it is estimated where it is not stated.

    Returns
    -------
    int, int
        How many are determined, and 12 K - 3 in all, less one without a scalar reference.
    """
    noisy, _ = complete_noise(array, recording)
    centered = recording.readings_T[:, 0] - recording.readings_T[:, 0].mean(axis=0)
    radius = np.sqrt(np.mean(np.sum(centered**2, axis=1)))
    points = centered / radius
    least = max(_NOISE_MARGIN * float(noisy.vector_noise_T[0]) / radius, _ROUNDING) * np.sqrt(len(points))
    linear = _rank(np.column_stack([points, np.ones(len(points))]), least)
    quadratic = min(_rank(ellipsoid.monomial_columns(points.T, np.ones(len(points)))[:10].T, least), 9)
    scale = 1 if recording.scalar_T is None else 0
    others = recording.sensor_count - 1
    return 3 * others * linear + quadratic - scale, 12 * others + 9 - scale


def _rank(rows: FloatArray, least: float) -> int:
    return int(np.sum(np.linalg.svd(rows, compute_uv=False) > least))


def _require_turns(recording: Recording, array: Array) -> None:
    try:
        require_determined(recording, array)
    except InputError as problem:
        determined, every = count_determined(recording, array)
        raise InputError(f"the turns determine {determined} of {every} parameters: {problem}") from None
