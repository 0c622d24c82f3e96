"""What a compass of uncorrected readings would make of the heading, and whether a recorded heading is one.

An AHRS levels the readings of a magnetometer by gravity and turns until they point north. Its heading is off by what
the errors of the sensor make of the direction of the field; with a gyroscope and a filter, by the low-pass of that.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm, pinv

from tam_calibration.fit.recorded_attitude import turns_between
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.tolerances import Tolerances
from tam_calibration.model.units import FloatArray, from_degrees, to_degrees

_DIMENSIONS, _CONVINCING, _LARGEST_RATIO = 2.0, float(np.log(1000.0)), 1e4
"""Errors of a compass that a hard iron makes, logarithm of the evidence from which a heading is believed to be raw, and
the largest ratio of what sensors' errors make of a heading to its noise that is counted."""

_USUAL, _DRAWS = Tolerances(0.01, from_degrees(0.5), 300e-9, from_degrees(0.5)), 9
"""Errors of a chip, by which a single sensor's heading is judged, and how many are drawn."""

_SEEN = 1e-3
"""Part of the largest singular value below which a turn of the mounting does not show in the heading."""


@dataclass(frozen=True, eq=False)
class RawHeadings:
    """Headings of the corrected field and of M raw readings in the world of the attitude, radians.

    Parameters
    ----------
    names : tuple of str
        Of the raw readings: of each sensor and of all together.
    errors : (M, N) array
        What an AHRS of them is off by: the heading of the corrected field less theirs.
    left : (M, N) array
        How their headings vary in the recorded attitude, but for what another mounting explains.
    corrected : (N,) array
        The same of the corrected field.
    level : float
        Mean cosine of the dip: an angle of heading turns the field by as much less.
    usual : float
        Sum of squares of what the usual errors of a sensor make of the heading.
    """

    names: tuple[str, ...]
    errors: FloatArray
    left: FloatArray
    corrected: FloatArray
    level: float
    usual: float

    @classmethod
    def of(
        cls, readings_T: FloatArray, field: FloatArray, turned: FloatArray, direction: FloatArray, intensity_T: float
    ) -> "RawHeadings":
        """Return the headings of a recording.

        Parameters
        ----------
        readings_T : (N, K, 3) array
            Raw readings, tesla.
        field : (N, 3) array
            Direction of the corrected field in the array frame.
        turned : (N, 3, 3) array
            From the array frame to the world, by the recorded attitude.
        direction : (3,) array
            Of the field in the world.
        intensity_T : float
            Of the field, tesla.
        """
        from scipy.spatial.transform import Rotation

        count = readings_T.shape[1]
        names = tuple(f"sensor {sensor + 1}" for sensor in range(count)) + (("all sensors",) if count > 1 else ())
        raw = np.concatenate([readings_T, readings_T.mean(axis=1, keepdims=True)], axis=1)[:, : len(names)]
        deviates = np.random.default_rng(0).normal(size=(_DRAWS, 12)) * np.sqrt(_USUAL.variances())
        deviates[:, 6:9] /= intensity_T
        usual = SensorErrors.from_vector(deviates + np.repeat([1.0, 0.0], [3, 9])).distort(field)
        world = np.einsum("nij,nj->ni", turned, field)
        # With the field where it belongs, what follows is not correlated with the errors of the attitude.
        agreeing = Rotation.from_rotvec(turns_between(world, direction)).as_matrix() @ turned
        errors = -_heading(np.einsum("nij,nkj->kni", agreeing, np.concatenate([raw, usual], axis=1)))
        columns = _by_mounting(field, agreeing, direction)
        headings = np.vstack([_heading(world), _heading(world) - errors[: len(names)], errors[len(names) :]])
        left = headings - headings @ pinv(columns, rcond=_SEEN).T @ columns.T
        return cls(
            names,
            errors[: len(names)],
            left[1 : 1 + len(names)],
            left[0],
            float(norm(world[:, :2], axis=1).mean()),
            float(np.median(np.sum(left[1 + len(names) :] ** 2, axis=1))),
        )

    @property
    def columns(self) -> FloatArray:
        """(2 M, N) errors of heading that an AHRS of each of the readings makes: without a filter, and with a slow one.

        The filter's are those whose rate is the variation of the raw heading, but for a trend.
        """
        filtered = self.left / 2 - np.cumsum(self.left, axis=1)
        trend = np.polynomial.polynomial.polyvander(np.linspace(-1, 1, filtered.shape[1]), 1)
        filtered -= filtered @ pinv(trend).T @ trend.T
        return np.stack([self.errors, filtered], axis=1).reshape(-1, filtered.shape[1])

    def size_deg(self, index: int) -> float:
        """Return the root mean square of what the errors of readings make of a heading, degrees."""
        return to_degrees(float(np.std(self.errors[index])))

    def variation_deg(self, index: int) -> float:
        """Return the root mean square variation of the heading of readings in the recorded attitude, degrees."""
        return to_degrees(float(np.std(self.left[index])))

    def is_raw(self, index: int, attitude_noise: float) -> bool:
        """Return whether the recorded heading is that of raw readings, rather than these happen to have few errors.

        The evidence is the ratio of the likelihoods, times Occam's factor for errors that would be as large as those by
        which sensors differ, and of a single sensor as usual.
        """
        precision = (self.level / attitude_noise) ** 2
        energy = np.sum((self.left - self.left[index]) ** 2, axis=1)
        # Of two sensors both differ; of all together the errors are as much smaller as there are sensors.
        shared = 2 if index < len(energy) - 1 else len(energy) - 1
        size = np.median(np.delete(energy, index)) / shared if len(energy) > 1 else self.usual
        ratio = min(precision * float(size), _LARGEST_RATIO)
        likelihood = precision * float(np.sum(self.corrected**2) - np.sum(self.left[index] ** 2)) / 2
        return bool(likelihood + _DIMENSIONS / 2 * np.log1p(ratio / _DIMENSIONS) > _CONVINCING)


def _heading(world: FloatArray) -> FloatArray:
    """Return the angles (..., N) about the vertical of vectors (..., N, 3) against their mean, radians."""
    mean = world[..., :2].mean(axis=-2, keepdims=True)
    across = mean[..., 0] * world[..., 1] - mean[..., 1] * world[..., 0]
    return np.asarray(np.arctan2(across, np.sum(world[..., :2] * mean, axis=-1)))


def _by_mounting(field: FloatArray, turned: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the (N, 4) derivatives of the heading by a turn of the mounting, and by north."""
    moved = np.einsum("nij,njk->nik", turned, np.cross(np.eye(3)[None], field[:, None]).swapaxes(1, 2))
    across = direction[0] * moved[:, 1] - direction[1] * moved[:, 0]
    return np.column_stack([across / np.sum(direction[:2] ** 2), np.ones(len(field))])
