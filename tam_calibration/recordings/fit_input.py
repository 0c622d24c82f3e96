"""What a fit or a comparison takes: samples, each reading once, with what became of the messages; a known source.

Samples are in memory, or in temporary files where the recording is large.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.files.quantities import Place, Vector
from tam_calibration.files.schema import Bounds, Document, check
from tam_calibration.files.yaml_document import mapping_in
from tam_calibration.messages.samples import Progress
from tam_calibration.messages.usage import Usage
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording, SampleSource
from tam_calibration.recordings.array_yaml import read_array, transforms_in
from tam_calibration.recordings.reading import AS_IT_IS, Reading
from tam_calibration.recordings.recording_file import read_pieces, read_samples
from tam_calibration.recordings.recording_stream import RecordingStream
from tam_calibration.sources.dipole import Dipole, Loop, Source, area_of

_LARGE_BYTES = 1 << 26
"""From here on, 64 MiB, a recording is read in pieces."""

Role = Literal["simulation", "recording"]


def is_large(path: Path) -> bool:
    """Return whether a file, or the files of a folder, had better be read in pieces: from 64 MiB on."""
    parts = path.iterdir() if path.is_dir() else [path]
    return sum(part.stat().st_size for part in parts if part.is_file()) >= _LARGE_BYTES


def read_source(
    path: Path,
    array: Array | None = None,
    reading: Reading = AS_IT_IS,
    progress: Progress = lambda done, total: None,
    each_once: bool = True,
) -> tuple[SampleSource, Usage | None]:
    """Read a recording for a fit into memory, or where it is large into temporary files. Return with it its usage.

    Parameters
    ----------
    path, array, reading, progress
        As of `read_samples`.
    each_once : bool
        Whether each reading of the slowest sensor counts once; otherwise all samples are returned.

    Returns
    -------
    source : SampleSource
        The samples.
    usage : Usage or None
        How many samples were used, and what is missing; None where nothing was joined and nothing is missing.

    Raises
    ------
    InputError
        When it cannot be read or kept, or contains no recording.
    """
    source: Recording | RecordingStream
    if is_large(path):
        source = RecordingStream(read_pieces(path, array, reading, progress))
        usage = source.usage
    else:
        samples = read_samples(path, array, reading, progress)
        source, usage = samples.recording, samples.usage
    return (usage.with_each_reading_once(source) if usage is not None and each_once else source), usage


def fit_with_usage(
    samples: SampleSource, usage: Usage | None, fit: Callable[[SampleSource], Calibration]
) -> Calibration:
    """Return the calibration of samples, with what became of the messages that they come from.

    Parameters
    ----------
    samples : SampleSource
        With each reading once.
    usage : Usage or None
        Of the messages; None where nothing was joined and nothing is missing.
    fit : callable
        From samples to a calibration.

    Raises
    ------
    InputError, Refused
        Where less than half of the messages were used, before the fit, and as the fit.
    """
    if usage is None:
        return fit(samples)
    usage.require_enough()
    calibration = fit(samples)
    warnings = (*usage.warnings(), *usage.interpolation_warnings(samples, calibration.array.vector_noise_T))
    notes = (*usage.missing, *calibration.notes)
    return replace(calibration, warnings=(*warnings, *calibration.warnings), notes=notes)


def read_compared(
    role: Role, path: Path, array: Array, how: Reading = AS_IT_IS, progress: Progress = lambda done, total: None
) -> tuple[SampleSource, tuple[str, ...]]:
    """Read one of two recordings that are compared.

    Parameters
    ----------
    role : str
        Which of the two it is: "simulation" or "recording".
    path : Path
        The bag or CSV file.
    array : Array
        Of its sensors.
    how : Reading
        How it is read.
    progress : callable
        Called now and then with the bytes read of a bag, and how many there are; not of a CSV file.

    Returns
    -------
    source : SampleSource
        The samples, with each reading once.
    remarks : tuple of str
        What to know of how they were joined, one sentence each.

    Raises
    ------
    InputError
        When it cannot be read, or has another number of sensors than the array.
    Refused
        When more than half of its samples cannot be used.
    """
    with _said_of(role):
        source, usage = read_source(path, array, how, progress)
        return source, () if usage is None else remarks_on(role, usage.remarks())


def remarks_on(role: Role, remarks: tuple[str, ...]) -> tuple[str, ...]:
    """Return sentences that say which of the two recordings they are about."""
    return tuple(f"The {role}: {remark}" for remark in remarks)


def read_array_of(role: Role, path: Path, recording: Path) -> Array:
    """Read the array of one of two recordings, its positions from ``/tf_static`` of the bag where they stand there.

    Parameters
    ----------
    role : str
        Which of the two it is: "simulation" or "recording".
    path : Path
        The array file.
    recording : Path
        The bag or CSV file.

    Raises
    ------
    InputError
        When one of the files cannot be read.
    """
    with _said_of(role):
        return read_array(path, transforms_in(recording))


@contextmanager
def _said_of(role: Role) -> Iterator[None]:
    """Put the name of the side before what is wrong with it."""
    try:
        yield
    except (InputError, Refused) as problem:
        raise type(problem)(f"the {role}: {problem}") from None


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
