"""The samples of a recording for a fit or a comparison: each reading once, and what became of the messages.

They are in memory, or in temporary files where the recording is large.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Literal

from tam_calibration.correction.calibration import Calibration
from tam_calibration.messages.samples import Progress
from tam_calibration.messages.usage import Usage
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording, SampleSource
from tam_calibration.recordings.array_yaml import read_array, transforms_in
from tam_calibration.recordings.reading import AS_IT_IS, Reading
from tam_calibration.recordings.recording_file import read_pieces, read_samples
from tam_calibration.recordings.recording_stream import RecordingStream

_LARGE_BYTES = 1 << 26
"""From here on, 64 MiB, a recording is read in pieces."""

Role = Literal["simulation", "recording"]


def is_large(path: Path) -> bool:
    """Return whether a file, or the files of a folder, had better be read in pieces: from 64 MiB on."""
    parts = path.iterdir() if path.is_dir() else [path]
    return sum(part.stat().st_size for part in parts if part.is_file()) >= _LARGE_BYTES


def read_stream(
    path: Path,
    array: Array | None = None,
    reading: Reading = AS_IT_IS,
    progress: Progress = lambda done, total: None,
    sensor_count: int | None = None,
) -> RecordingStream:
    """Read a recording that may be larger than memory: it is kept in temporary files as numbers.

    Parameters
    ----------
    path, array, reading, progress, sensor_count
        As of `read_samples`.

    Raises
    ------
    InputError
        When it cannot be read or kept, or contains no recording.
    """
    usage: Usage | None = None

    def recordings() -> Iterator[Recording]:
        nonlocal usage
        for samples in read_pieces(path, array, reading, progress, sensor_count=sensor_count):
            usage = samples.usage
            yield samples.recording

    stream = RecordingStream(recordings())
    stream.usage = usage
    return stream


def read_source(
    path: Path,
    array: Array | None = None,
    reading: Reading = AS_IT_IS,
    progress: Progress = lambda done, total: None,
    each_once: bool = True,
) -> tuple[SampleSource, Usage | None]:
    """Read a recording for a fit into memory, or where it is large as `read_stream` does. Return with it its usage.

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
    source: SampleSource
    if is_large(path):
        source = stream = read_stream(path, array, reading, progress)
        usage = stream.usage
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
    role: Role,
    path: Path,
    array: Array,
    how: Reading = AS_IT_IS,
    progress: Progress = lambda done, total: None,
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
    except InputError as problem:
        raise InputError(f"the {role}: {problem}") from None
    except Refused as problem:
        raise Refused(f"the {role}: {problem}") from None
