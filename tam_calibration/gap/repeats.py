"""Poses that the array takes up again: what is the same whenever it does, is no course in time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import Covariates, to_world
from tam_calibration.effects.grades import FEWEST, MOST, NEGLIGIBLE, SLIGHT
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Repeats:
    """Visits to poses, and the pairs of visits to the same pose.

    Parameters
    ----------
    visit : (N,) array of int
        Number of the visit that a sample is part of.
    first, second : (P,) array of int
        Visits to the same pose.
    """

    visit: NDArray[np.intp]
    first: NDArray[np.intp]
    second: NDArray[np.intp]

    def energy(self, residual: FloatArray) -> float:
        """Return the mean product of a residual (N, C) at both visits to a pose, to which noise adds nothing."""
        means = _means(self.visit, residual)
        return float((means[self.first] * means[self.second]).sum(axis=1).mean())

    def are_same(self, signal: FloatArray) -> bool:
        """Return whether a signal (N, C) is the same at both visits to a pose."""
        means = _means(self.visit, signal)
        between = means[self.first] - means[self.second]
        return float((between**2).mean()) < 2 * SLIGHT * float(means[self.first].var(axis=0).mean())


def repeats(pose: FloatArray) -> Repeats | None:
    """Return the visits to poses, where most poses are taken up again; None elsewhere.

    Parameters
    ----------
    pose : (N, p) array
        Vectors of length one that tell the pose: axes of the array in the world, or the field in the array.
    """
    from scipy.spatial import cKDTree

    moved = np.linalg.norm(np.diff(pose, axis=0), axis=1) > NEGLIGIBLE
    visit = np.append(0, np.cumsum(moved))
    if visit[-1] < FEWEST:
        return None
    poses = _means(visit, pose)
    distance, partner = (found[:, 1] for found in cKDTree(poses).query(poses, 2))
    again = np.flatnonzero(distance < NEGLIGIBLE)
    return Repeats(visit, again, partner[again]) if len(again) > MOST * len(poses) else None


def pose_of(covariates: Covariates) -> FloatArray:
    """Return the axes of the array in the world (N, 9), or without attitude the field's direction in the array."""
    if covariates.attitude is None:
        return covariates.field_T / covariates.intensity_T[:, None]
    return to_world(covariates).reshape(covariates.sample_count, 9)


def _means(visit: NDArray[np.intp], values: FloatArray) -> FloatArray:
    """Return the mean (V, C) of values (N, C) over each visit."""
    sums = np.array([np.bincount(visit, one) for one in values.T]).T
    return np.asarray(sums / np.bincount(visit)[:, None])
