"""A recording that is larger than memory: kept as numbers in temporary files, and read again for every pass."""

import os
from collections.abc import Iterable, Iterator
from functools import cached_property
from tempfile import TemporaryFile, gettempdir
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from tam_calibration.messages.samples import Samples
from tam_calibration.messages.usage import Usage
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import BLOCK, Block, InterpolatedNoise, Recording
from tam_calibration.model.units import FloatArray


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
        values = np.full((count, *self.shape), np.nan)  # a channel that later pieces lack ends before the others
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

    usage: Usage | None = None
    """How many of sensor 1's messages are in it, as its last piece says; None where they were no messages."""

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
        places = self._places([0, self.sample_count - 1])
        first, last = (float(self._columns["time_s"].read(place, 1)[0]) for place in places)
        return first, last

    def blocks(self) -> Iterator[Block]:
        """Yield all samples in the order of time, at most ``BLOCK`` at once."""
        names = [name for name in Block._fields if name in self._columns]
        for time_s, readings_T, *scalar_T in self._read(names):
            yield Block(time_s, readings_T, scalar_T[0] if scalar_T else None)

    def thinned(self, most: int) -> Recording:
        """Return every n-th sample, so that there are at most so many; they are kept for the next time."""
        if most not in self._thinned:
            self._thinned[most] = self._every(-(-self.sample_count // most))
        return self._thinned[most]

    def _every(self, stride: int) -> Recording:
        if stride == 1:
            return self.whole()
        places = self._places(np.arange(0, self.sample_count, stride))
        columns = self._columns.items()
        values = {name: np.concatenate([each.read(place, 1) for place in places]) for name, each in columns}
        return Recording.of_values(values)

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

    def _places(self, index: "NDArray[np.integer] | list[int]") -> "NDArray[np.integer]":
        """Return where in the files some samples lie."""
        return np.asarray(index) if self._chosen is None else np.flatnonzero(self._chosen)[index]

    def _read(self, names: list[str]) -> Iterator[list[FloatArray]]:
        """Yield values of some columns, block by block."""
        total = self._columns["time_s"].count
        for start in range(0, total, BLOCK):
            count = min(BLOCK, total - start)
            chosen = slice(None) if self._chosen is None else self._chosen[start : start + count]
            if self._chosen is None or self._chosen[start : start + count].any():
                yield [self._columns[name].read(start, count)[chosen] for name in names]
