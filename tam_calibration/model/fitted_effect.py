"""An effect with numbers: what a diagnosis finds, a calibration keeps and a simulation adds."""

from collections.abc import Mapping
from dataclasses import dataclass, field

SCALAR = -1
"""In place of a sensor's index: the scalar magnetometer."""

ALL = -2
"""In place of a sensor's index: all sensors."""

Shape = Mapping[str, float]
"""Parameters on which an effect depends otherwise than linearly, by name, SI: a time constant, a frequency."""


@dataclass(frozen=True)
class Contribution:
    """The values of a term: which sensor (index, ``SCALAR`` or ``ALL``), axis and term, and its coefficients in SI.

    ``standard_errors`` has an entry for each coefficient whose error is known.
    """

    sensor: int
    axis: int | None
    term: str
    values: Mapping[str, float]
    standard_errors: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FittedEffect:
    """An effect with numbers: what a diagnosis finds, a calibration keeps and a simulation adds.

    Parameters
    ----------
    effect : str
        Name of the effect.
    shape : mapping
        Parameters on which it depends otherwise than linearly, SI; empty where there are none.
    contributions : tuple of Contribution
        What it does, and to which sensors and axes.
    shape_errors : mapping
        Standard errors of the parameters of the shape, where they are known.
    """

    effect: str
    shape: Shape
    contributions: tuple[Contribution, ...]
    shape_errors: Mapping[str, float] = field(default_factory=dict)
