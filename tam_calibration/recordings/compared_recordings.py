"""The two recordings of a comparison, read: what is wrong with one of them names which."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from tam_calibration.messages.samples import Progress
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import SampleSource
from tam_calibration.recordings.array_yaml import read_array
from tam_calibration.recordings.bag_transforms import transforms_in
from tam_calibration.recordings.reading import AS_IT_IS, Reading
from tam_calibration.recordings.recording_file import read_source

Role = Literal["simulation", "recording"]


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
