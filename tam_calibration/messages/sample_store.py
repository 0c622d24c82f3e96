"""The samples of one run in bounded memory, as the calibrator fits them."""

from collections.abc import Sequence
from math import gcd
from threading import Lock
from typing import NamedTuple

import numpy as np

from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.timeline import Run, Timeline
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

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
    """

    def __init__(self, layout: SampleLayout, capacity: int) -> None:
        self.layout, self._capacity = layout, capacity
        self._lock, self._generation = Lock(), 0
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
