"""What the papers' crosses have in common: the set-up, alignments, and the figures by which they are judged."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.fit.moments import procrustes, rotation_by_regression
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees


@dataclass(frozen=True, eq=False)
class SetUp:
    """A simulated cross in a uniform field.

    Parameters
    ----------
    array : Array
        Geometry and noise.
    baseline_m : float
        Distance of opposite sensors, metres.
    errors : SensorErrors
        The truth, in the frame of the platform.
    field_T : (N, 3) array
        True field in the frame of the platform, tesla.
    recording : Recording
        What is read.
    """

    array: Array
    baseline_m: float
    errors: SensorErrors
    field_T: FloatArray
    recording: Recording

    @property
    def intensity_T(self) -> float:
        """The constant intensity, tesla."""
        return float(norm(self.field_T[0]))


def intensity_rms_T(fields_T: FloatArray, intensity_T: FloatArray | float) -> FloatArray:
    """Return the (K,) root mean square errors of the intensity of fields (N, K, 3) against (N,) or one, tesla."""
    error = norm(fields_T, axis=2) - np.reshape(intensity_T, (-1, 1))
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def tensor_rms_T_per_m(fields_T: FloatArray, baseline_m: float) -> FloatArray:
    """Return the (6,) root mean square components xx, xy, xz, yx, yy, yz of fields (N, 4, 3) in a uniform field, T/m.

    Li 2018a and 2018b print xy, along the y axis, and yx apart.
    """
    along_x, along_y = fields_T[:, 0] - fields_T[:, 2], fields_T[:, 1] - fields_T[:, 3]
    difference = np.stack(
        [along_x[:, 0], along_y[:, 0], along_x[:, 2], along_x[:, 1], along_y[:, 1], along_y[:, 2]], axis=1
    )
    return np.asarray(np.sqrt(np.mean(difference**2, axis=0)) / baseline_m)


def aligned(fields_T: FloatArray, reference_T: FloatArray, chosen: slice = slice(None)) -> FloatArray:
    """Return fields (N, K, 3), each turned onto the reference (N, 3) by the rotation that fits the chosen samples."""
    rotation = procrustes(np.einsum("nki,nj->kij", fields_T[chosen], reference_T[chosen]))
    return np.asarray(np.einsum("kji,nkj->nki", rotation, fields_T))


def aligned_by_regression(fields_T: FloatArray, reference_T: FloatArray, chosen: slice = slice(None)) -> FloatArray:
    """Return fields (N, K, 3), each turned onto the reference (N, 3) as Yin does, angle by angle."""
    count = fields_T.shape[1]
    fitted = [np.linalg.lstsq(fields_T[chosen, k], reference_T[chosen], rcond=None)[0].T for k in range(count)]
    return np.asarray(np.einsum("kji,nkj->nki", rotation_by_regression(np.array(fitted)), fields_T))


def site_field(intensity_T: float, inclination_deg: float, declination_deg: float) -> FloatArray:
    """Return the field (3,) north, east, down of a site, tesla.

    Parameters
    ----------
    intensity_T : float
        Of the field, tesla.
    inclination_deg : float
        Degrees, positive downwards.
    declination_deg : float
        Degrees, positive to the east.
    """
    inclination, declination = from_degrees(inclination_deg), from_degrees(declination_deg)
    level = np.cos(inclination)
    direction = [level * np.cos(declination), level * np.sin(declination), np.sin(inclination)]
    return intensity_T * np.array(direction)


def grid_of_turns(order: str, turns: int, field_T: FloatArray) -> FloatArray:
    """Return the fields (turns³, 3) in a frame turned about three axes in equal steps, the last axis fastest.

    Parameters
    ----------
    order : str
        The axes from left to right in the product of passive rotations, such as "ZYX".
    turns : int
        Steps in a full turn about each axis.
    field_T : (3,) array
        The field before.
    """
    from scipy.spatial.transform import Rotation

    steps = 2 * np.pi * np.arange(turns) / turns
    angles = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(Rotation.from_euler(order, -angles).apply(field_T))


def observed(
    errors: SensorErrors,
    field_T: FloatArray,
    baseline_m: float,
    noise_T: float,
    seed: int,
    intensity_T: float | None = None,
) -> SetUp:
    """Return a cross in a uniform field, with noise before the distortion, one sample a second.

    Parameters
    ----------
    errors : SensorErrors
        The truth, in the frame of the platform.
    field_T : (N, 3) array
        True field in the frame of the platform, tesla.
    baseline_m : float
        Distance of opposite sensors, metres.
    noise_T : float
        Standard deviation of the noise of each axis of each sensor, tesla.
    seed : int
        Of the noise.
    intensity_T : float, optional
        What the scalar states, tesla; without it the intensity of the first sample.
    """
    count = len(field_T)
    noise = noise_T * np.random.default_rng(seed).normal(size=(count, 4, 3))
    readings = errors.distort(field_T[:, None] + noise)
    stated = norm(field_T[0]) if intensity_T is None else intensity_T
    recording = Recording(np.arange(count, dtype=float), readings, np.full(count, stated))
    return SetUp(Array.cross(baseline_m, noise_T, 0.0), baseline_m, errors, field_T, recording)
