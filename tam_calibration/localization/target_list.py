"""One list of the targets that several survey lines show: the same object from several lines is one target."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.localization.target import Target, by_evidence
from tam_calibration.model.units import FloatArray

_SAME = 21.11
"""Square of the distance between two sightings over their covariance, below which they are of one object: χ² of three
degrees of freedom exceeds it with a probability of 1e-4."""

_FARTHEST = 0.5
"""Distance between sightings of one object over its distance from the line: targets are found to less than that."""


def merged(lines: Sequence[Sequence[Target]]) -> list[Target]:
    """Return the targets of several lines as one list, the strongest evidence first.

    The sightings of an object are averaged by their precision. Where they differ by more than their standard errors
    explain, its covariance is widened to the differences.

    Parameters
    ----------
    lines : sequence of sequences of Target
        Of each line, positions in one world.
    """
    objects: list[list[Target]] = []
    for targets in lines:
        own = list(objects)
        for target in by_evidence(targets):
            same = min(own, key=lambda seen: _distance(seen, target), default=None)
            if same is None or _distance(same, target) > _SAME:
                objects.append([target])
            else:
                same.append(target)
                own.remove(same)
    return by_evidence([_of_sightings(each) for each in objects])


def _distance(seen: Sequence[Target], target: Target) -> float:
    """Return the square of the distance from the nearest sighting over both covariances; infinite where it is far."""
    nearest = np.inf
    for other in seen:
        off = other.position_m - target.position_m
        if norm(off) < _FARTHEST * max(other.distance_m, target.distance_m):
            spread = other.position_covariance_m2 + target.position_covariance_m2
            nearest = min(nearest, float(off @ np.linalg.solve(spread, off)))
    return nearest


def _of_sightings(seen: Sequence[Target]) -> Target:
    strongest = by_evidence(seen)[0]
    if len(seen) == 1:
        return strongest
    position, spread = _mean([each.position_m for each in seen], [each.position_covariance_m2 for each in seen])
    moment, of_moment = _mean([each.moment_Am2 for each in seen], [each.moment_covariance_A2m4 for each in seen])
    return replace(
        strongest,
        position_m=position,
        position_covariance_m2=spread,
        moment_Am2=moment,
        moment_covariance_A2m4=of_moment,
        evidence=sum(each.evidence for each in seen),
        distance_m=min(each.distance_m for each in seen),
        extent_m=max(each.extent_m for each in seen),
        is_extended=any(each.is_extended for each in seen),
        lines=len(seen),
        repeat_m=float(np.sqrt(np.mean([norm(each.position_m - position) ** 2 for each in seen]))),
    )


def _mean(values: Sequence[FloatArray], covariances: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return the mean (3,) of vectors by their precision, and its covariance, widened to the differences (Birge)."""
    precisions = [inv(each) for each in covariances]
    covariance = inv(np.sum(precisions, axis=0))
    mean = covariance @ sum(each @ value for each, value in zip(precisions, values, strict=True))
    square = sum((value - mean) @ each @ (value - mean) for each, value in zip(precisions, values, strict=True))
    return mean, covariance * max(1.0, float(square) / (3 * len(values) - 3))
