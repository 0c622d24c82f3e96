"""How a model does on samples that it did not see."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from tam_calibration.gap.channels import Channels
from tam_calibration.gap.design import Design
from tam_calibration.gap.normal import Normal
from tam_calibration.gap.regression import VISIBLE, pseudo_inverse
from tam_calibration.units import FloatArray

FOLDS = 5
"""Parts of a recording of which each is left out once: four fifths tell nearly as much as all."""

_BLOCKS_PER_FOLD = 12
"""Blocks of time over which a fold is spread, so that none leaves out all of an attitude."""


def folds_of(sample_count: int, interleaved: bool) -> list[list[slice]]:
    """Return the samples of each fold: blocks of time, or every fifth sample for free functions of time."""
    if interleaved:
        return [[slice(fold, sample_count, FOLDS)] for fold in range(FOLDS)]
    bounds = np.linspace(0, sample_count, FOLDS * _BLOCKS_PER_FOLD + 1).astype(int).tolist()
    blocks = [slice(low, high) for low, high in pairwise(bounds)]
    return [blocks[fold::FOLDS] for fold in range(FOLDS)]


def held_out_energy(
    channels: Channels, designs: Sequence[Design], widths: Sequence[int], interleaved: bool
) -> FloatArray:
    """Return the energy (F, M) of each fold under fits to the other folds of growing models.

    Parameters
    ----------
    channels : Channels
        Whitened channels.
    designs : sequence of Design
        Of the calibration, then of effects.
    widths : sequence of int
        How many of the designs each of M models has.
    interleaved : bool
        See ``folds_of``.
    """
    joined = Design.joined(designs)
    ends = np.cumsum([design.width for design in designs])
    parts = []
    for fold in folds_of(len(channels.misfit_T), interleaved):
        blocks = [channels.normal(joined, block) for block in fold]
        parts.append(sum(blocks[1:], start=blocks[0]))
    whole = sum(parts[1:], start=parts[0])
    energy = np.empty((len(parts), len(widths)))
    for row, part in enumerate(parts):
        train = whole - part
        for column, width in enumerate(widths):
            energy[row, column] = _energy(train, part, int(ends[width - 1]))
    return energy


def _energy(train: Normal, test: Normal, width: int) -> float:
    """Return the energy of the test samples under the fit of the first columns to the training samples."""
    first = slice(0, width)
    step = pseudo_inverse(train.information[first, first], VISIBLE) @ train.score[first]
    return float(test.energy - 2 * step @ test.score[first] + step @ test.information[first, first] @ step)
