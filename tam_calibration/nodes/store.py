"""Samples that arrive one by one, kept as the recording of one run within a bounded memory."""

from threading import Lock

import numpy as np

from tam_calibration.exceptions import InputError
from tam_calibration.pointcloud_layout import SampleLayout
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray


class SampleStore:
    """The samples since the last start over.

    When it is full every second sample is given up, and only every second new one is taken, so that the whole
    run stays covered. Time that goes backwards (a bag that loops) or other columns start it over. One thread may add
    while another asks for the recording.

    Parameters
    ----------
    capacity : int
        Greatest number of samples.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._columns: tuple[str, ...] = ()
        self._lock = Lock()
        self.start_over()

    def __len__(self) -> int:
        """Return the number of stored samples."""
        return len(self._rows)

    def start_over(self) -> None:
        """Forget all samples."""
        self._rows: list[FloatArray] = []
        self._stride, self._seen = 1, 0
        self._newest_s = -np.inf

    def add(self, columns: tuple[str, ...], row: FloatArray) -> None:
        """Add one sample, whose first column is its time."""
        with self._lock:
            if columns != self._columns or row[0] <= self._newest_s:
                self._columns = columns
                self.start_over()
            if self._seen % self._stride == 0:
                self._rows.append(row)
            self._seen += 1
            self._newest_s = row[0]
            if len(self._rows) == self._capacity:
                self._rows, self._stride = self._rows[::2], 2 * self._stride

    def recording(self) -> Recording:
        """Return the stored samples.

        Raises
        ------
        InputError
            When there is none, or they are no recording.
        """
        with self._lock:
            columns, rows = self._columns, self._rows.copy()
        if not rows:
            raise InputError(
                "no samples are stored: check in /diagnostics that the collector runs and every sensor publishes"
            )
        return SampleLayout.from_columns(columns).recording(np.array(rows))
