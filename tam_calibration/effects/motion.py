"""The motion of the field in the array frame: its rate of change, and whether it is continuous."""

from weakref import WeakKeyDictionary

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.grades import NOTABLE
from tam_calibration.model.recording import BLOCK
from tam_calibration.model.units import FloatArray

_NEIGHBOURS = 6
"""Samples on both sides through which a polynomial (of fifth degree) predicts one, as turns are smooth."""

_KNOWN: WeakKeyDictionary[Covariates, FloatArray] = WeakKeyDictionary()


def rates(covariates: Covariates) -> FloatArray:
    """Return the derivative (N, 3) of the field by time, per stretch between holes.

    That of the polynomial through three neighbours on both sides, at an end of a stretch through the nearest six; a
    sample's own noise is not in its derivative. Zero in stretches of less than three samples.
    """
    if covariates in _KNOWN:
        return _KNOWN[covariates]
    rate = np.zeros_like(covariates.field_T)
    for stretch in covariates.stretches:
        if stretch.stop - stretch.start < 3:
            continue
        neighbours, here = _neighbours(stretch), np.arange(stretch.start, stretch.stop)
        for first_of_piece in range(0, len(here), BLOCK):
            nodes, own = neighbours[first_of_piece:][:BLOCK], here[first_of_piece:][:BLOCK]
            _, slope = _weights(covariates.time_s[nodes] - covariates.time_s[own, None])
            # A larger weight of a neighbour, per time step, means samples that nearly coincide.
            wild = np.abs(slope).max(axis=1) * covariates.step_s > 50.0
            slope[wild] = 0
            rate[own] = _combined(slope, covariates.field_T, nodes)
    _KNOWN[covariates] = rate
    return rate


def jumps(covariates: Covariates) -> str | None:
    """Return that the field changes from sample to sample in jumps, not in continuous motion, where it does."""
    if covariates.sample_count < 2 * _NEIGHBOURS:
        return f"{covariates.sample_count} samples are too few to tell a motion"
    # Means of several samples have less noise, which a slow motion needs.
    for size in (1, 2, 4, 8, 16):
        steps, misses = [], []
        for stretch in covariates.stretches:
            count = (stretch.stop - stretch.start) // size
            if count <= _NEIGHBOURS:
                continue
            part = slice(stretch.start, stretch.start + count * size)
            time = covariates.time_s[part].reshape(count, size).mean(axis=1)
            field = covariates.field_T[part].reshape(count, size, 3).mean(axis=1)
            nodes = _neighbours(slice(0, count))
            weight, _ = _weights(time[nodes] - time[:, None])
            steps.append(norm(np.diff(field, axis=0), axis=1))
            misses.append(norm(field - _combined(weight, field, nodes), axis=1)[_NEIGHBOURS // 2 : -_NEIGHBOURS // 2])
        # Neighbours predict nothing of jumps, and nearly all of turns.
        if steps and np.quantile(np.concatenate(misses), 0.75) < NOTABLE * np.quantile(np.concatenate(steps), 0.75):
            return None
    return "the field changes from sample to sample in jumps, not in continuous motion"


def _neighbours(stretch: slice) -> NDArray[np.intp]:
    """Return the (n, m) indices of the m samples nearest in order to each sample of a stretch, without itself."""
    count = stretch.stop - stretch.start
    reach = min(_NEIGHBOURS, count - 1)
    here = np.arange(count)[:, None]
    first = np.clip(here - reach // 2, 0, count - 1 - reach)
    nodes = first + np.arange(reach)
    return np.asarray(stretch.start + nodes + (nodes >= here))


def _weights(offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the weights (n, m) of value and derivative at 0 of the polynomials through nodes (n, m)."""
    difference = offset[:, :, None] - offset[:, None, :]
    same = np.eye(offset.shape[1], dtype=bool)
    difference[:, same] = 1
    ratio = -offset[:, None, :] / difference
    ratio[:, same] = 1
    value = np.prod(ratio, axis=2)
    inverse = np.broadcast_to(-1 / offset[:, None, :], ratio.shape).copy()
    inverse[:, same] = 0
    return value, value * inverse.sum(axis=2)


def _combined(weight: FloatArray, values: FloatArray, nodes: NDArray[np.intp]) -> FloatArray:
    combined = np.zeros((len(nodes), values.shape[1]))
    for position in range(nodes.shape[1]):
        combined += weight[:, position, None] * values[nodes[:, position]]
    return combined
