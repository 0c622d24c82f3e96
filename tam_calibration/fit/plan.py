"""Which attitudes to record next, so that the worst standard error becomes as small as it can."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tam_calibration.exceptions import InputError, Refused
from tam_calibration.fit.design import Information, Model, Rows
from tam_calibration.fit.identifiability import refuse_open
from tam_calibration.fit.start import Start
from tam_calibration.units import FloatArray

_IGNORANCE = 1e-9
"""Information that is there before any sample, as part of that of a planned pose, so that nothing is infinite."""

_SMALLEST_GAIN = 1e-3


@dataclass(frozen=True, eq=False)
class Plan:
    """Poses to record, and what they promise.

    Parameters
    ----------
    poses : (P,) array of int
        Numbers of the chosen candidates, the one that helps most first; one may be chosen more than once.
    worst : (P,) array
        Largest standard error after each pose: of bias, and of scale factor and angle times the field, in units of the
        noise of the parameter's sensor; infinite as long as a parameter is open.
    standard_errors : (K, 12) array
        After all poses, SI, in the order of ``errors.PARAMETER_NAMES``.
    """

    poses: np.ndarray
    worst: FloatArray
    standard_errors: FloatArray


def make_plan(
    start: Start,
    field_T: FloatArray,
    pose_count: int,
    samples_per_pose: int,
    progress: Callable[[int], None] = lambda done: None,
) -> Plan:
    """Choose poses among candidates.

    They are taken one by one so that the sum of the squared standard errors falls most, then exchanged one by one as
    long as that sum, and after it the largest of them, falls (Fedorov's exchange); all in units of the noise.

    Parameters
    ----------
    start : Start
        What is known before.
    field_T : (C, 3) array
        Fields in the array frame at the attitudes that can be reached, tesla.
    pose_count, samples_per_pose : int
        How many poses, and samples at each.
    progress : callable
        Called with the number of poses found.

    Raises
    ------
    Refused
        When parameters stay open; it names them.
    """
    search = _Search(start.model, start.information, start.model.rows(field_T), samples_per_pose)
    chosen: list[int] = []
    for _ in range(pose_count):
        chosen.append(search.best(chosen, _sum))
        progress(len(chosen))
    chosen = search.exchange(search.exchange(chosen, _sum), _largest)
    poses = search.order(chosen)
    variances = [start.model.variances(search.with_poses(poses[: count + 1])) for count in range(pose_count)]
    standard_errors = np.sqrt(variances[-1])
    try:
        refuse_open(standard_errors, start.model.intensity_T)
    except InputError as problem:
        words = f"even with the best {pose_count} poses within reach {problem}"
        raise Refused(f"{words}; allow more pitch and roll, or plan more poses") from None
    worst = np.sqrt([_largest(variance * start.model.noise_units**2) for variance in variances])
    return Plan(np.array(poses), worst, standard_errors.reshape(-1, 12))


def _sum(squares: FloatArray) -> FloatArray:
    total: FloatArray = squares.sum(axis=-1)
    return total


def _largest(squares: FloatArray) -> FloatArray:
    largest: FloatArray = squares.max(axis=-1)
    return largest


@dataclass(frozen=True, eq=False)
class _Search:
    """The candidates, and what is known before."""

    model: Model
    start: Information
    candidates: Rows
    samples: int

    @cached_property
    def _poses(self) -> Rows:
        factor = np.sqrt(self.samples)
        return Rows(factor * self.candidates.ellipsoid, factor * self.candidates.affine)

    @cached_property
    def _ignorance(self) -> Information:
        poses = self._poses
        sizes = (np.mean(poses.ellipsoid**2) * np.eye(9), np.mean(poses.affine**2) * np.eye(4))
        return Information(*sizes) * _IGNORANCE

    def with_poses(self, chosen: list[int]) -> Information:
        """Return the information of what is known before and of poses."""
        return self.start + self._poses[np.array(chosen, dtype=int)].information

    def scores(self, chosen: list[int], criterion: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """Return the criterion of the squared standard errors with each candidate beside the chosen ones."""
        variances = self.model.variances_with(self.with_poses(chosen) + self._ignorance, self._poses)
        return criterion(variances * self.model.noise_units**2)

    def best(self, chosen: list[int], criterion: Callable[[FloatArray], FloatArray]) -> int:
        """Return the candidate that helps most beside the chosen ones."""
        return int(np.argmin(self.scores(chosen, criterion)))

    def exchange(self, chosen: list[int], criterion: Callable[[FloatArray], FloatArray]) -> list[int]:
        """Return the poses with each exchanged for a better one until that gains nothing."""
        chosen, gained = list(chosen), True
        while gained:
            gained = False
            for place, old in enumerate(chosen):
                scores = self.scores(chosen[:place] + chosen[place + 1 :], criterion)
                chosen[place] = int(np.argmin(scores))
                if scores[chosen[place]] < (1 - _SMALLEST_GAIN) * scores[old]:
                    gained = True
                else:
                    chosen[place] = old
        return chosen

    def order(self, chosen: list[int]) -> list[int]:
        """Return the poses in the order in which they help most."""
        left = list(chosen)
        ordered: list[int] = []
        while left:
            scores = self.scores(ordered, _sum)[left]
            ordered.append(left.pop(int(np.argmin(scores))))
        return ordered
