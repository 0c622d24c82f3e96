"""The experiments of Li 2018a and 2018b: a cross on a platform in the field near Shijiazhuang."""

import numpy as np

from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_validation.papers.cross import SetUp, observed, site_field

BASELINE_M = 0.4
"""As both papers state it."""

_STEPS = 36
"""Samples of the turn about z."""
_TILT = np.deg2rad(40.0)
"""Largest pitch and yaw of the platform (Li 2018a section 5)."""
_DIP_DEG, _DECLINATION_DEG = -56.0, -5.0
"""Of the main field there; z of the platform points up: with z down the tensor before calibration is farther off."""


def poses(count: int, generator: np.random.Generator) -> FloatArray:
    """Return the rotations (36 + count, 3, 3) from the platform to the world: a turn about z, then poses at random.

    Parameters
    ----------
    count : int
        Poses of any turn about the platform's z axis, tilted about the two others within what the platform can.
    generator : numpy.random.Generator
        Draws them.
    """
    from scipy.spatial.transform import Rotation

    standard = Rotation.from_euler("z", 2 * np.pi * np.arange(_STEPS)[:, None] / _STEPS)
    tilt = Rotation.from_euler("yx", generator.uniform(-_TILT, _TILT, (count, 2)))
    turn = Rotation.from_euler("z", generator.uniform(0, 2 * np.pi, (count, 1)))
    return np.asarray(Rotation.concatenate([standard, tilt * turn]).as_matrix())


def field_experiment(
    errors: SensorErrors, intensity_T: float, swing_T: float, to_world: FloatArray, noise_T: float, seed: int
) -> SetUp:
    """Return the readings of an experiment; the scalar states the mean intensity, as the papers do.

    Parameters
    ----------
    errors : SensorErrors
        As printed for the experiment.
    intensity_T : float
        Mean intensity, tesla.
    swing_T : float
        By how much the intensity is higher or lower from pose to pose, uniformly drawn, tesla.
    to_world : (N, 3, 3) array
        Poses.
    noise_T : float
        Standard deviation of the noise of each axis, as in the paper's simulation, tesla.
    seed : int
        Of the noise and of the changes of the intensity.
    """
    generator = np.random.default_rng([seed, 1])
    share = 1 + generator.uniform(-swing_T, swing_T, (len(to_world), 1)) / intensity_T
    field = share * (site_field(intensity_T, _DIP_DEG, _DECLINATION_DEG) @ to_world)
    return observed(errors, field, BASELINE_M, noise_T, seed, intensity_T)
