"""What was learned, tried on samples after it before it is published: one that predicts worse never is."""

from dataclasses import dataclass, field, replace

import numpy as np

from tam_calibration.live.recursion import Belief, MomentLikelihood, SampleMoments
from tam_calibration.model.units import FloatArray

TRIED, MOST_TRIED = 3, 30
"""Blocks on which what was learned is tried before it is published: six seconds where they are clear, else a minute."""

CLEAR = 9.0
"""Energy from which blocks are clear: three standard deviations of one direction."""

CLEARLY_BETTER = 100.0
"""Fall of the energy from which a calibration that is less certain is published: chance makes half of it once in ten
thousand trials of four sensors."""


@dataclass(frozen=True, eq=False)
class Trial:
    """What is known, tried on the blocks after it.

    Parameters
    ----------
    belief : Belief
        What was known.
    is_less_certain : bool
        Whether its standard errors are larger than those that were published.
    blocks : int
        Number of blocks.
    gained : (2,) array
        By how much the energy of their differential channels and of their common mode falls from the published errors
        to these.
    """

    belief: Belief
    is_less_certain: bool
    blocks: int = 0
    gained: FloatArray = field(default_factory=lambda: np.zeros(2))

    def after(self, moments: SampleMoments, published: Belief, likelihood: MomentLikelihood) -> "Trial":
        """Return the trial after another block of samples."""
        told, tried = (likelihood.linearize(moments, each.errors) for each in (published, self.belief))
        gained = np.array([told.differential - tried.differential, told.common_mode - tried.common_mode])
        return replace(self, blocks=self.blocks + 1, gained=self.gained + gained)

    @property
    def is_over(self) -> bool:
        """Whether it has seen enough blocks."""
        is_clear = bool((np.abs(self.gained) > CLEAR).all())
        return self.blocks >= (TRIED if is_clear else MOST_TRIED)

    @property
    def has_passed(self) -> bool:
        """Whether it predicts no worse than what was published, and much better where it is less certain."""
        least = CLEARLY_BETTER if self.is_less_certain else 0.0
        return self.is_over and self.gained[0] >= least and self.gained.sum() >= 0
