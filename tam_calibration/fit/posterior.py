"""What is known of the errors of the sensors after a recording: the most probable ones, and their covariance."""

from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.fit.information import inverted
from tam_calibration.fit.motion import MotionState
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.problem import Known, Problem
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Posterior:
    """What all of it tells together.

    Parameters
    ----------
    errors : SensorErrors
        The most probable ones.
    covariance : (12 K, 12 K) array
        Of the flattened errors, SI; zero for what is held.
    intensity_T : float
        Of the field: fitted where no scalar reference tells it; else that of the start, tesla.
    motion : MotionState, optional
        What else was fitted where attitude or angular velocity is data.
    mount : (3, 3) array, optional
        X: rotation from the frame of the sensors to the one whose attitude or angular velocity is data.
    with_mount : (12 K + 3, 12 K + 3) array, optional
        Covariance of the errors and of the turn of X, radians.
    """

    errors: SensorErrors
    covariance: FloatArray
    intensity_T: float
    motion: MotionState | None = None
    mount: FloatArray | None = None
    with_mount: FloatArray | None = None


def posterior_of(recording: SampleSource, array: KnownNoiseArray, known: Known | Prior) -> Posterior:
    """Return what is known of the errors of an array's sensors after a recording in a uniform field.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors; without any scalar reading the intensity is an unknown constant. Attitude counts
        where the array states its standard deviation.
    array : KnownNoiseArray
        With every noise.
    known : Known or Prior
        What is known before.

    Raises
    ------
    InputError
        When nothing is known before, and the readings determine no ellipsoid to start from.
    Refused
        When the iteration does not settle, or leads to sensors that cannot be.
    """
    problem = Problem.of(recording, array, known if isinstance(known, Known) else Known(known))
    end, kept = problem.most_probable()
    if problem.known.curvature is not None:
        kept = problem.information_with(problem.known.curvature, end), problem.basis_at(end)
    covariance, size = inverted(*kept), 12 * array.sensor_count
    found = Posterior(end.errors, covariance[:size, :size], end.intensity_T, end.motion)
    if end.motion is None:
        return found
    mount, sign = end.motion.mounting
    chosen = np.r_[:size, len(covariance) - end.motion.size + np.arange(end.motion.size)[end.motion.turn]]
    signs = np.append(np.ones(size), np.full(3, sign))
    return replace(found, mount=mount, with_mount=covariance[np.ix_(chosen, chosen)] * np.outer(signs, signs))
