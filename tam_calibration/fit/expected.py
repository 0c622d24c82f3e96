"""Standard errors that samples will have, before they are fitted: what a turn buys, planned or made so far."""

from dataclasses import replace

import numpy as np

from tam_calibration.fit.gyroscope_path import GyroscopeState, GyroscopeUse
from tam_calibration.fit.information import inverted
from tam_calibration.fit.problem import Known, Problem
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.gyroscope import Gyroscope
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray


def expected_covariance(
    recording: Recording, array: KnownNoiseArray, known: Known, gyroscope: Gyroscope | None
) -> FloatArray:
    """Return the covariance (12 K, 12 K) of the errors that a fit of samples without noise would have.

    Parameters
    ----------
    recording : Recording
        Of K sensors, as they read at the start of what is known.
    array : KnownNoiseArray
        With every noise.
    known : Known
        Everything else that is known.
    gyroscope : Gyroscope, optional
        What measured the angular velocity; it counts where its noise is stated.
    """
    if gyroscope is not None and gyroscope.noise_density is not None and recording.angular_velocity_rad_s is not None:
        interval_s, start = float(np.median(np.diff(recording.time_s))), GyroscopeState.at_rest(np.eye(3), 0.0)
        use = GyroscopeUse(gyroscope.noise_density, gyroscope.bias, interval_s, start, gyroscope.scale_error)
        known = replace(known, gyroscope=use)
    problem = Problem.of(recording, array, known)
    size, found = 12 * array.sensor_count, problem.normal_at(problem.start)
    return inverted(found.information, problem.basis_at(problem.start))[:size, :size]
