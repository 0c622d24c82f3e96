"""The file of a known source: what it is, where it is, and the recording of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from tam_calibration.files.quantities import Place, Vector
from tam_calibration.files.schema import Bounds, Document, check
from tam_calibration.files.yaml_document import mapping_in
from tam_calibration.model.exceptions import InputError
from tam_calibration.sources.dipole import Dipole, Loop, Source, area_of

_Positive = Annotated[float, Bounds(above=0, least=1e-12, most=1e12, unit="in SI")]
"""A moment, ampere turns, a radius or a frequency: from atoms to the largest machines."""


@dataclass(frozen=True, eq=False)
class StatedSource:
    """A source of known place, axis and strength.

    Parameters
    ----------
    source : Dipole or Loop
        In the world of the recorded attitude, from the array's centre.
    frequency_hz : float
        Of its field.
    recording : Path
        Of the array that was turned before it.
    """

    source: Source
    frequency_hz: float
    recording: Path


class _SourceFile(Document):
    """What the file may hold.

    Parameters
    ----------
    recording : str
        File next to this one: CSV or bag.
    position_m : [x, y, z]
        Of the centre of the source, in the world of the recorded attitude, from the array's centre.
    axis : [x, y, z]
        Direction of its magnetic moment, of any length.
    moment_Am2 : float, optional
        Size of the moment; either this, or the ampere turns of a loop.
    ampere_turns : float, optional
        Peak current times turns of a loop.
    radius_m : float, optional
        Of a circular loop; without it the source is a dipole.
    frequency_Hz : float
        Of its field.
    """

    recording: str
    position_m: Place
    axis: Vector
    moment_Am2: _Positive | None = None
    ampere_turns: _Positive | None = None
    radius_m: _Positive | None = None
    frequency_Hz: _Positive

    def to_source(self) -> Source:
        """Return the source."""
        longest = max(map(abs, self.axis))
        if longest == 0:
            raise InputError("axis: a direction must not be zero")
        if (self.moment_Am2 is None) == (self.ampere_turns is None):
            raise InputError("give either moment_Am2, or ampere_turns and radius_m of a loop")
        if self.moment_Am2 is not None:
            size = self.moment_Am2
        elif self.radius_m is None or self.ampere_turns is None:
            raise InputError("ampere_turns are those of a loop: give its radius_m too")
        else:
            size = self.ampere_turns * area_of(self.radius_m)
        axis = np.array(self.axis) / longest  # its length is then a number, however large the axis is
        position, moment = np.array(self.position_m), size * axis / np.linalg.norm(axis)
        return Dipole(position, moment) if self.radius_m is None else Loop(position, moment, self.radius_m)


def read_known_source(path: Path) -> StatedSource:
    """Read the file of a known source.

    Raises
    ------
    InputError
        When it cannot be read, a key is not known, or the values make no source.
    """
    with mapping_in(Path(path)) as content:
        stored = check(content, _SourceFile)
        return StatedSource(stored.to_source(), stored.frequency_Hz, Path(path).parent / stored.recording)
