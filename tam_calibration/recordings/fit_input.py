"""What a fit or a comparison takes: a known source; samples, in memory or, if they are many, in temporary files."""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryFile, gettempdir
from typing import Annotated, Literal
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from tam_calibration.correction.calibration import Calibration
from tam_calibration.files.schema import Bounds, Document, Place, Vector, check
from tam_calibration.files.text_files import MOST_BYTES
from tam_calibration.files.yaml_document import mapping_in
from tam_calibration.messages.samples import NO_USAGE, Progress, Samples, Usage
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import BLOCK, Block, InterpolatedNoise, Recording, SampleSource
from tam_calibration.model.units import FloatArray
from tam_calibration.recordings.array_yaml import read_array, transforms_in
from tam_calibration.recordings.channel_map import AS_IT_IS, Reading
from tam_calibration.recordings.recording_file import read_pieces, read_samples
from tam_calibration.sources.dipole import Dipole, Loop, Source, area_of


class _Column:
    """Values (N, ...) in a file of their own, which has no name and vanishes with its last use."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape, self.count = shape, 0
        self._size = 8 * int(np.prod(shape, dtype=int))
        self._file = TemporaryFile()  # noqa: SIM115
        finalize(self, self._file.close)

    def append(self, values: FloatArray) -> None:
        self._file.write(np.asarray(values, dtype=float).tobytes())
        self._file.flush()
        self.count += len(values)

    def read(self, start: int, count: int) -> FloatArray:
        values = np.empty((count, *self.shape))
        values[max(self.count - start, 0) :] = np.nan  # a channel that later pieces lack ends before the others
        os.preadv(self._file.fileno(), [values.view(np.uint8).reshape(-1).data], start * self._size)
        return values


class RecordingStream:
    """The samples of a recording on disk, a ``SampleSource``.

    No more than a block of them is in memory at once, except in `whole`. The temporary files take 8 bytes a number, in
    the folder that the environment variable TMPDIR names.

    Parameters
    ----------
    pieces : iterable of Samples
        The recording, piece by piece; a channel may be None in some pieces.

    Raises
    ------
    InputError
        When the pieces do not follow each other in time, or there is no room for them.
    """

    usage: Usage = NO_USAGE
    """How many of sensor 1's messages are in it, as its last piece says."""

    interpolated_noise: InterpolatedNoise | None = None
    """What interpolation made of the sensors' noise."""

    def __init__(self, pieces: Iterable[Samples]) -> None:
        self._columns: dict[str, _Column] = {}
        self._chosen: NDArray[np.bool_] | None = None
        self._thinned: dict[int, Recording] = {}
        try:
            for piece in pieces:
                self._append(piece.recording)
                self.usage = piece.usage
        except OSError as problem:
            raise InputError(
                f"the recording cannot be kept in {gettempdir()} while it is read: {problem.strerror}; "
                "name a folder with more room by the environment variable TMPDIR"
            ) from None
        if not self._columns:
            raise InputError("the recording contains no sample")

    def _append(self, piece: Recording) -> None:
        count = self._columns["time_s"].count if self._columns else 0
        if count and not piece.time_s[0] > self._columns["time_s"].read(count - 1, 1)[0]:
            raise InputError(
                f"time repeats or goes backwards at sample {count + 1}, {piece.time_s[0]:.6f} s: "
                "read one run with --from and --until"
            )
        for name, values in piece.values().items():
            column = self._columns.setdefault(name, _Column(values.shape[1:]))
            column.append(np.full((count - column.count, *column.shape), np.nan))
            column.append(values)

    @property
    def sample_count(self) -> int:
        """Number of samples N."""
        return self._columns["time_s"].count if self._chosen is None else int(self._chosen.sum())

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""
        return self._columns["readings_T"].shape[0]

    @cached_property
    def scalar_count(self) -> int | None:
        """Number of samples with a scalar reading; None for a run without scalar magnetometer."""
        if "scalar_T" not in self._columns:
            return None
        return sum(int(np.isfinite(values).sum()) for (values,) in self._read(["scalar_T"]))

    @cached_property
    def time_span_s(self) -> tuple[float, float]:
        """First and last time stamp, seconds."""
        places = np.arange(self._columns["time_s"].count) if self._chosen is None else np.flatnonzero(self._chosen)
        first, last = (float(self._columns["time_s"].read(place, 1)[0]) for place in (places[0], places[-1]))
        return first, last

    def blocks(self) -> Iterator[Block]:
        """Yield all samples in the order of time, at most ``BLOCK`` at once."""
        names = [name for name in Block._fields if name in self._columns]
        for time_s, readings_T, *scalar_T in self._read(names):
            yield Block(time_s, readings_T, scalar_T[0] if scalar_T else None)

    def thinned(self, most: int) -> Recording:
        """Return every n-th sample, so that there are at most so many; they are kept for the next time."""
        if most not in self._thinned:
            every = np.arange(self.sample_count) % -(-self.sample_count // most) == 0
            self._thinned[most] = self.take(every).whole()
        return self._thinned[most]

    def with_noise(self, noise: InterpolatedNoise) -> "RecordingStream":
        """Return the same samples with what interpolation made of their noise."""
        other = self.take(np.ones(self.sample_count, dtype=bool))
        other.interpolated_noise = noise
        return other

    def take(self, index: NDArray[np.bool_]) -> "RecordingStream":
        """Return the samples that a mask (N,) selects; they stay where they are."""
        taken = RecordingStream.__new__(RecordingStream)
        taken._columns, taken._thinned, taken.interpolated_noise = self._columns, {}, self.interpolated_noise
        total = self._columns["time_s"].count
        taken._chosen = np.ones(total, dtype=bool) if self._chosen is None else self._chosen.copy()
        taken._chosen[taken._chosen] = index
        return taken

    def whole(self) -> Recording:
        """Return all samples in memory, with all channels."""
        names = list(self._columns)
        parts = zip(*self._read(names), strict=True)
        recording = Recording.of_values({name: np.concatenate(part) for name, part in zip(names, parts, strict=True)})
        return recording if self.interpolated_noise is None else recording.with_noise(self.interpolated_noise)

    def _read(self, names: list[str]) -> Iterator[list[FloatArray]]:
        """Yield values of some columns, block by block."""
        total = self._columns["time_s"].count
        for start in range(0, total, BLOCK):
            count = min(BLOCK, total - start)
            chosen = slice(None) if self._chosen is None else self._chosen[start : start + count]
            if self._chosen is None or self._chosen[start : start + count].any():
                yield [self._columns[name].read(start, count)[chosen] for name in names]


Role = Literal["simulation", "recording"]


def is_large(path: Path) -> bool:
    """Return whether a file, or the files of a folder, had better be read in pieces: from 64 MiB on."""
    parts = path.iterdir() if path.is_dir() else [path]
    return sum(part.stat().st_size for part in parts if part.is_file()) >= MOST_BYTES


def read_source(
    path: Path,
    array: Array | None = None,
    reading: Reading = AS_IT_IS,
    progress: Progress = lambda done, total: None,
    each_once: bool = True,
) -> tuple[SampleSource, Usage]:
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
    usage : Usage
        How many samples were used, and what is missing.

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
    return (usage.with_each_reading_once(source) if each_once else source), usage


def fit_with_usage(samples: SampleSource, usage: Usage, fit: Callable[[SampleSource], Calibration]) -> Calibration:
    """Return the calibration of samples, with what became of the messages that they come from.

    Parameters
    ----------
    samples : SampleSource
        With each reading once.
    usage : Usage
        Of the messages.
    fit : callable
        From samples to a calibration.

    Raises
    ------
    InputError, Refused
        Where less than half of the messages were used, before the fit, and as the fit.
    """
    usage.require_enough()
    calibration = fit(samples)
    interpolated = usage.interpolation_warnings(samples, calibration.array.vector_noise_T)
    warnings = (*calibration.warnings, *usage.warnings(), *interpolated)
    return replace(calibration, warnings=warnings, notes=(*usage.missing, *calibration.notes))


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
        return source, tuple(f"The {role}: {remark}" for remark in usage.remarks())


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
