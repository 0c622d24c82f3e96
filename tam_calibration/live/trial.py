"""What was learned, tried on samples after it before it is published: one that predicts worse never is."""

from dataclasses import dataclass, field, replace

import numpy as np

from tam_calibration.live.moments import MomentLikelihood, SampleMoments
from tam_calibration.live.recursion import Belief
from tam_calibration.model.units import FloatArray

TRIED, MOST_TRIED = 3, 30
"""Blocks on which what was learned is tried before it is published: six seconds to a minute."""

CLEARLY_BETTER = 100.0
"""Fall of the squared residuals, in units of the noise, from which a calibration predicts better: chance makes half of
it once in ten thousand trials of four sensors."""

NOTICEABLY_BETTER = 0.01
"""Part of the squared residuals by which they fall as well: biases of all sensors were off by a tenth of the noise.
With less, errors that the mission does not turn through may become worse."""


@dataclass(frozen=True, eq=False)
class Trial:
    """What is known, tried on the blocks after it.

    Parameters
    ----------
    belief : Belief
        What was known.
    blocks : int
        Number of blocks.
    energy : (2,) array
        Squared residuals of their differential channels and of their common mode by what was published.
    fall : (2,) array
        By how much these are smaller by what was known.
    """

    belief: Belief
    blocks: int = 0
    energy: FloatArray = field(default_factory=lambda: np.zeros(2))
    fall: FloatArray = field(default_factory=lambda: np.zeros(2))

    def after(self, moments: SampleMoments, published: Belief, likelihood: MomentLikelihood) -> "Trial":
        """Return the trial after another block of samples."""
        before, tried = (
            np.array([here.between.energy, here.common.energy])
            for here in (likelihood.linearize(moments, each.errors) for each in (published, self.belief))
        )
        return replace(self, blocks=self.blocks + 1, energy=self.energy + before, fall=self.fall + before - tried)

    @property
    def is_over(self) -> bool:
        """Whether it has seen enough blocks."""
        return self.has_passed or self.blocks >= MOST_TRIED

    @property
    def has_passed(self) -> bool:
        """Whether it predicts better than what was published.

        Sensors that agree better by themselves are needed where there are several: the scalar may be slow, or feel
        metal that turns with it.
        """
        of_sensors, of_all = float(self.fall[0]), float(self.fall.sum())
        least = max(CLEARLY_BETTER, NOTICEABLY_BETTER * float(self.energy.sum()))
        fall = min(of_sensors, of_all) if self.energy[0] else of_all
        return self.blocks >= TRIED and fall >= least
