"""A steady source that a moving platform passes: the regional field removed, and the dipole from all samples together.

The regional field is uniform in the world and turns in the array frame. It is known, as from a geomagnetic model, or
fitted together with the dipole: the samples far from the source show it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.array import Array
from tam_calibration.exceptions import InputError
from tam_calibration.localization.direct_fit import SourceFit, fit_dipole
from tam_calibration.localization.finite_baseline import locate_dipole
from tam_calibration.localization.poses import Poses
from tam_calibration.localization.solutions import EulerSolutions
from tam_calibration.units import FloatArray


@dataclass(frozen=True, eq=False)
class Track:
    """A dipole that was passed.

    Parameters
    ----------
    fit : SourceFit
        The dipole in the world, from all samples.
    regional_T : (3,) array
        The uniform field of the world that was taken off, given or fitted, tesla.
    samples : EulerSolutions
        Of each sample by itself, in the array frame.
    sample_position_m : (N, 3) array
        The same in the world, metres; NaN where it was not located.
    """

    fit: SourceFit
    regional_T: FloatArray
    samples: EulerSolutions
    sample_position_m: FloatArray


def straight_track(time_s: FloatArray, start_m: FloatArray, velocity_m_per_s: FloatArray) -> FloatArray:
    """Return the positions (N, 3) at times (N,) of a platform that keeps its velocity, metres; it starts at the first.

    Raises
    ------
    InputError
        When start or velocity are not three finite numbers.
    """
    start, velocity = np.asarray(start_m, dtype=float), np.asarray(velocity_m_per_s, dtype=float)
    if start.shape != (3,) or velocity.shape != (3,) or not np.isfinite([start, velocity]).all():
        raise InputError("a straight track needs a start and a velocity of three finite numbers each")
    return start + np.outer(time_s - np.asarray(time_s)[0], velocity)


def without_regional(fields_T: FloatArray, attitude: FloatArray, regional_T: FloatArray) -> FloatArray:
    """Return fields (N, K, 3) in the array frame less a field (3,) that is uniform in the world, tesla."""
    from scipy.spatial.transform import Rotation

    regional: FloatArray = Rotation.from_quat(attitude).inv().apply(regional_T)
    return fields_T - regional[:, None]


def track_dipole(
    fields_T: FloatArray,
    array: Array,
    poses: Poses,
    regional_T: FloatArray | None = None,
) -> Track:
    """Find a dipole at rest from the samples of a platform that passes it.

    Parameters
    ----------
    fields_T : (N, K, 3) array
        Calibrated readings, array frame, tesla.
    array : Array
        Positions and noise of the sensors.
    poses : Poses
        Attitude and position of the array at each sample, and the noise of the attitude: 0.1° in 50 µT are 87 nT in
        all sensors alike, which is then no signal.
    regional_T : (3,) array, optional
        The uniform field of the world, tesla; it is fitted where it is not given.

    Returns
    -------
    Track
        The dipole of all samples, and that of each.

    Raises
    ------
    InputError
        When a shape is wrong or values are not finite.
    Refused
        When the readings do not determine the dipole.
    """
    fit = fit_dipole(fields_T, array, poses, uniform_field_T=regional_T, fit_uniform_field=regional_T is None)
    regional = np.asarray(fit.uniform_field_T if regional_T is None else regional_T, dtype=float)
    own = without_regional(fields_T, poses.attitude, regional)
    samples = locate_dipole(own.reshape(len(own), -1) @ array.operator.T, array, _covariance(array, regional, poses))
    return Track(fit, regional, samples, poses.place_in_world(samples.position_m))


def _covariance(array: Array, regional_T: FloatArray, poses: Poses) -> FloatArray | None:
    """Return the covariance (9, 9) of field and gradient.

    It is of the sensors' noise and of what an error of the attitude leaves of the regional field, the mean of its axes.
    """
    if array.vector_noise_T is None:
        return None
    covariance: FloatArray = array.operator * np.repeat(array.vector_noise_T**2, 3) @ array.operator.T
    covariance[:3, :3] += np.eye(3) * (2 / 3) * (poses.attitude_noise * norm(regional_T)) ** 2
    return covariance
