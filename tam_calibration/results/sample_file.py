"""The samples of a run, in bounded memory and on disk, and what a calibrator has learned: a restart goes on with both.

The first line of a file of samples says what its samples are of, and of which node. Rows of one size follow, each with
a checksum over that line and itself: damage costs the rows that it hits, and no row is taken for one of another array
or node. What was learned is stored as arrays and a text about them, after a line with a checksum.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from io import BytesIO
from math import gcd
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from tam_calibration.files.text_files import to_json, write_whole
from tam_calibration.live.live import Change, LiveState
from tam_calibration.live.recursion import Belief, Recursion, SampleMoments
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.timeline import Run, Timeline
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.limits import is_covariance
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.results.overwriting import name_aside

LONGEST_PAUSE_NS = 3_600_000_000_000
"""Of a run that goes on in another process, nanoseconds: a robot that was switched off is back within an hour, and its
sensors have drifted no more than in a long run. Samples that come later are another run."""


class StoredSample(NamedTuple):
    """A sample that is stored.

    Parameters
    ----------
    number : int
        Its place among all samples of the run, from 0: a multiple of the store's stride.
    stamp_ns : int
        Stamp of its message, nanoseconds.
    time_ns : int
        Its time in the run, which goes on where stamps step back, nanoseconds.
    row : (columns,) array
        Its values.
    """

    number: int
    stamp_ns: int
    time_ns: int
    row: FloatArray


class SampleStore:
    """The samples since the last start over.

    When it is full every second sample is given up, and only every second new one is taken, so that the complete
    run stays covered. Its time goes on where stamps step back; a recording that is played once more starts it over. One
    thread may add while another asks for the recording.

    Parameters
    ----------
    layout : SampleLayout
        Of the samples.
    capacity : int
        Greatest number of samples.

    Attributes
    ----------
    discarded : int
        Samples of a process that ended that were forgotten, as those that came did not follow them.
    """

    def __init__(self, layout: SampleLayout, capacity: int) -> None:
        self.layout, self._capacity = layout, capacity
        self._lock, self._generation, self.discarded = Lock(), 0, 0
        self.start_over()

    def __len__(self) -> int:
        """Return the number of stored samples."""
        return len(self._samples)

    def start_over(self) -> None:
        """Forget all samples."""
        with self._lock:
            self._forget()
            self._run, self._timeline = Run(), Timeline[FloatArray](disorder_ns=0)

    def _forget(self) -> None:
        self._samples: list[StoredSample] = []
        self._generation += 1
        self._stride, self._seen = 1, 0
        self._resumed_ns: int | None = None

    def resume(self, samples: Sequence[StoredSample]) -> None:
        """Go on with the samples of a process that ended; they are forgotten if those that come do not follow them.

        Parameters
        ----------
        samples : sequence of StoredSample
            As they were saved, at least one; some may be missing.
        """
        with self._lock:
            first, last = samples[0], samples[-1]
            self._samples = list(samples)
            common = gcd(*(sample.number for sample in samples))
            self._stride = common & -common or 1
            self._seen, self._resumed_ns = last.number + self._stride, last.stamp_ns
            self._run.resume(first.stamp_ns, self._readings(first.row), last.time_ns, last.time_ns - last.stamp_ns)
            self._thin()

    def add(self, stamp_ns: int, row: FloatArray) -> None:
        """Add one sample.

        Parameters
        ----------
        stamp_ns : int
            Its stamp, nanoseconds.
        row : (columns,) array
            The values of ``layout.columns``, SI, the first of which is the time, seconds.
        """
        with self._lock:
            for believed_ns, believed in self._timeline.take(stamp_ns, row):
                self._store(believed_ns, believed)

    def _store(self, stamp_ns: int, row: FloatArray) -> None:
        if self._resumed_ns is not None and not 0 < stamp_ns - self._resumed_ns <= LONGEST_PAUSE_NS:
            self._run.start_over()
            self.discarded = len(self._samples)
            self._forget()
        self._resumed_ns = None
        if self._run.begins_again(stamp_ns, self._readings(row)):
            self._forget()
        time_ns = self._run.time_ns(stamp_ns)
        if self._seen % self._stride == 0:
            stored = row if time_ns == stamp_ns else np.append(time_ns / 1_000_000_000, row[1:])
            self._samples.append(StoredSample(self._seen, stamp_ns, time_ns, stored))
        self._seen += 1
        self._thin()

    def _thin(self) -> None:
        while len(self._samples) >= self._capacity:
            self._stride *= 2
            self._samples = [sample for sample in self._samples if sample.number % self._stride == 0]
            self._generation += 1

    def _readings(self, row: FloatArray) -> bytes:
        return row[1 : 1 + 3 * self.layout.sensor_count].tobytes()

    def samples(self) -> tuple[int, list[StoredSample]]:
        """Return the samples, and a number that grows when some of them are given up, and not when others are added."""
        with self._lock:
            return self._generation, self._samples.copy()

    def recording(self) -> Recording:
        """Return the stored samples.

        Raises
        ------
        InputError
            When there is none, or they are no recording.
        """
        with self._lock:
            rows = [sample.row for sample in self._samples]
        if not rows:
            raise InputError(
                "no samples are stored: check in /diagnostics that the collector runs and every sensor publishes"
            )
        return self.layout.recording(np.array(rows))


_BEGIN = b"tam samples"
"""What files begin with."""


*_NUMBERS, _ = StoredSample._fields
"""What precedes the values of a row."""


class SampleFile:
    """Samples on disk.

    Parameters
    ----------
    path : Path
        Of the file; it and its folder are made when samples are saved.
    node : str
        Whose the file is. One of another node is left alone: this node has its own next to it.
    about : mapping
        What the samples are of, as JSON has it, such as the array.
    columns : int
        Numbers of a sample.

    Attributes
    ----------
    path : Path
        Of the file that the node has.
    remark : str
        What was wrong with the file that was there, as a sentence; empty where nothing was.
    """

    def __init__(self, path: Path, node: str, about: Mapping[str, Any], columns: int) -> None:
        self.path, self.remark = path, ""
        self._node = node
        text = json.dumps(json.loads(to_json({"node": node, **about}))).encode()
        self._check = crc32(text)
        self._head = b"%s %08x %s\n" % (_BEGIN, self._check, text)
        self._row = np.dtype([*((name, "<i8") for name in _NUMBERS), ("row", "<f8", (columns,)), ("check", "<u4")])
        self._size = self._row.itemsize

    def read(self) -> tuple[list[StoredSample], bool]:
        """Return the complete samples in the order of their numbers, and whether the file can be gone on with.

        One that cannot is set aside: renamed, not changed.

        Raises
        ------
        InputError
            When the file cannot be read or renamed.
        """
        try:
            content = self._content()
            if _owner(content) not in (None, self._node):
                other, self.path = self.path, self.path.with_name(f"{self.path.name}.{self._node.replace('/', '.')}")
                self.remark = f"{other} is of another node: this one has {self.path}"
                return self.read()
            found = self._whole(content[len(self._head) :])
            size = len(content) - len(self._head)
            is_complete = content.startswith(self._head) and len(found) == size // self._size
            if content and not is_complete:
                self._set_aside(content, found)
        except OSError as problem:
            raise self._cannot(problem) from problem
        return found, is_complete

    def _content(self) -> bytes:
        if not self.path.exists():
            return b""
        if not self.path.is_file():
            raise OSError("it is no regular file")
        with self.path.open("rb") as file:
            head = file.read(len(self._head))
            # Of a file that begins otherwise 256 MiB are searched, six times the usual size.
            return head + file.read(-1 if head == self._head else 1 << 28)

    def _set_aside(self, content: bytes, found: list[StoredSample]) -> None:
        why = "is damaged" if found or content.startswith(self._head) else "held no samples of this array"
        aside = self.path.rename(name_aside(self.path))
        used = f", and {len(found)} samples of it are used" if found else ""
        self.remark = f"{self.path} {why}: it is now {aside}{used}"

    def _whole(self, content: bytes) -> list[StoredSample]:
        rows = np.frombuffer(content[: len(content) // self._size * self._size], self._row)
        rows = rows[rows["check"] == self._checks(content, len(rows))]
        numbers = (rows[name].tolist() for name in _NUMBERS)
        return list(map(StoredSample, *numbers, map(np.copy, rows["row"])))

    def _checks(self, content: bytes, count: int) -> list[int]:
        size = self._row["check"].itemsize
        starts = range(0, count * self._size, self._size)
        return [crc32(content[start : start + self._size - size], self._check) for start in starts]

    def save(self, samples: Sequence[StoredSample], kept: int) -> None:
        """Save samples.

        Parameters
        ----------
        samples : sequence of StoredSample
            All that shall be in the file.
        kept : int
            How many of them are there; 0 where others are.

        Raises
        ------
        InputError
            When the file cannot be written; what was there can still be read.
        """
        try:
            if kept and self._is_own():
                with self.path.open("r+b") as file:
                    file.seek(len(self._head) + kept * self._size)
                    file.write(self._packed(samples[kept:]))
                return
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if self.path.is_file() and not self._is_own():
                self.path.rename(name_aside(self.path))
            with write_whole(self.path) as temporary:
                temporary.write_bytes(self._head + self._packed(samples))
        except (OSError, InputError) as problem:
            raise self._cannot(problem) from problem

    def _is_own(self) -> bool:
        """Return whether the file is there, and begins as this one does."""
        if not self.path.is_file():
            return False
        with self.path.open("rb") as file:
            return file.read(len(self._head)) == self._head

    def _packed(self, samples: Sequence[StoredSample]) -> bytes:
        rows = np.zeros(len(samples), self._row)
        for name, values in zip(StoredSample._fields, zip(*samples, strict=True), strict=False):
            rows[name] = values
        rows["check"] = self._checks(rows.tobytes(), len(rows))
        return rows.tobytes()

    def _cannot(self, problem: Exception) -> InputError:
        why = getattr(problem, "strerror", None) or problem
        return InputError(f"samples cannot be kept in {self.path}: {why}; name another samples_file, or none")


def _owner(content: bytes) -> str | None:
    """Return the node whose file begins so; None where that is damaged, or no such file."""
    with suppress(ValueError, LookupError):
        begin, check, text = content.partition(b"\n")[0].removeprefix(_BEGIN).split(b" ", 2)
        if not begin and int(check, 16) == crc32(text):
            return str(json.loads(text)["node"])
    return None


_HEAD = b"tam live %08x\n"
"""What files begin with."""

_BELIEFS = ("begin", "now", "published")


def write_live_state(path: Path, state: LiveState, calibration: str) -> None:
    """Write a state; a file that is there is replaced once the new one is complete.

    Parameters
    ----------
    path : Path
        Of the file.
    state : LiveState
        What was learned.
    calibration : str
        Text of the calibration file that it began with.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    recursion = state.recursion
    about = {
        "calibration": calibration,
        "paused_by": state.paused_by,
        "learned": state.learned,
        "energy": state.energy,
        "freedom": state.freedom,
        "count": recursion.moments.count,
        "scalar_count": recursion.moments.scalar_count,
        "changes": [asdict(change) for change in state.changes],
    }
    arrays: dict[str, Any] = {"second": recursion.moments.second, "fourth": recursion.moments.fourth}
    for name, belief in zip(_BELIEFS, (recursion.begin, recursion.now, state.published), strict=True):
        arrays[f"{name}_errors"], arrays[f"{name}_covariance"] = belief.errors.to_vector(), belief.covariance
        arrays[f"{name}_moment"] = np.array([belief.time_s, belief.temperature_C])
    arrays["orientation"] = recursion.begin.errors.orientation
    content = BytesIO()
    np.savez(content, about=np.array(json.dumps(about)), **arrays)
    with write_whole(path) as temporary:
        temporary.write_bytes(_HEAD % crc32(content.getvalue()) + content.getvalue())


def read_live_state(path: Path, sensor_count: int) -> tuple[LiveState, str]:
    """Return a state and the text of the calibration that it began with.

    Parameters
    ----------
    path : Path
        Of the file.
    sensor_count : int
        Of the array that it should be of.

    Raises
    ------
    InputError
        When it cannot be read, is damaged, or of another number of sensors.
    """
    try:
        with np.load(BytesIO(_checked_content(path.read_bytes())), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        about = json.loads(str(arrays.pop("about")))
        state = _state(arrays, about, sensor_count)
        calibration = str(about["calibration"])
    except Exception as problem:  # an archive of something else fails in any way
        raise InputError(f"{path} contains nothing that was learned of this array, or is damaged: {problem}") from None
    return state, calibration


def _checked_content(content: bytes) -> bytes:
    """Return what follows the checksum, if it fits."""
    rest = content[len(_HEAD % 0) :]
    if not content.startswith(_HEAD % crc32(rest)):
        raise ValueError("its checksum is not that of its content")
    return rest


def _state(arrays: dict[str, Any], about: dict[str, Any], sensor_count: int) -> LiveState:
    size, rows = 12 * sensor_count, 3 * sensor_count + 1
    second, fourth = _checked(arrays["second"], (rows, rows)), _checked(arrays["fourth"], (17, 17))
    orientation = _checked(arrays["orientation"], (sensor_count, 3, 3))
    beliefs = []
    for name in _BELIEFS:
        vector = _checked(arrays[f"{name}_errors"], (sensor_count, 12))
        covariance = _checked(arrays[f"{name}_covariance"], (size, size))
        if not is_covariance(covariance):
            raise ValueError(f"the covariance {name!r} is not positive definite")
        time_s, temperature_C = arrays[f"{name}_moment"].tolist()
        beliefs.append(Belief(SensorErrors.from_vector(vector, orientation), covariance, time_s, temperature_C))
    begin, now, published = beliefs
    moments = SampleMoments(second, fourth, int(about["count"]), int(about["scalar_count"]))
    return LiveState(
        Recursion(begin, moments, now),
        published,
        str(about["paused_by"]),
        int(about["learned"]),
        float(about["energy"]),
        float(about["freedom"]),
        tuple(Change(**{**each, "parameters": tuple(each["parameters"])}) for each in about["changes"]),
    )


def _checked(values: Any, shape: tuple[int, ...]) -> Any:
    if values.shape != shape or not np.isfinite(values).all():
        raise ValueError(f"{shape} finite numbers were expected, and {values.shape} are there")
    return values
