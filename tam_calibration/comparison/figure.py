"""Plain figures of two recordings, and whether they differ."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

Standing = Literal["same", "differs", "cannot tell"]


@dataclass(frozen=True)
class ReadingFigure:
    """A plain figure of one recording.

    Parameters
    ----------
    group, name : str
        Such as "stamps", "rate".
    unit : str
        SI unit; "1" for none.
    value : float
        NaN where the recording has none.
    standard_error : float
        NaN where it is not known.
    tolerance : float
        Difference that is none in practice, in the unit of the value.
    is_of_simulation : bool
        Whether a difference is one of the simulation; else it is of the path that was flown.
    """

    group: str
    name: str
    unit: str
    value: float
    standard_error: float = float("nan")
    tolerance: float = 0.0
    is_of_simulation: bool = True


CERTAIN = 4.5
"""Standard errors from which two figures differ: of some hundred by chance in one of a thousand comparisons."""


@dataclass(frozen=True)
class Figure:
    """One figure of the simulation and the same of the recording."""

    simulation: ReadingFigure
    recording: ReadingFigure

    @property
    def difference(self) -> float:
        """How far the two values are apart, in the unit of the figure."""
        return abs(self.recording.value - self.simulation.value)

    @property
    def standard_errors(self) -> float:
        """The recording's value less the simulation's, in standard errors of the difference; NaN where not known."""
        size = float(np.hypot(self.simulation.standard_error, self.recording.standard_error))
        return (self.recording.value - self.simulation.value) / size if size > 0 else float("nan")

    @property
    def standing(self) -> Standing:
        """Whether the two differ beyond tolerance and chance; what is of the path never does."""
        if not np.isfinite(self.difference):
            return "cannot tell"
        errors = np.nan_to_num([self.simulation.standard_error, self.recording.standard_error])
        chance = CERTAIN * float(np.hypot(errors[0], errors[1]))
        is_same = self.difference <= max(self.simulation.tolerance, self.recording.tolerance, chance)
        return "same" if is_same or not self.simulation.is_of_simulation else "differs"
