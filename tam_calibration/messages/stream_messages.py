"""Many messages of one stream as arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.model.mounting import Turn
from tam_calibration.model.units import FloatArray, IntArray

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class StreamMessages:
    """Messages of one stream.

    Parameters
    ----------
    order : (n,) array of int
        When each arrived among the batch's messages of all streams, increasing from 0.
    stamps_ns : (n,) array of int, optional
        Their stamps; None for a held channel without stamps.
    values : (n, width) array
        The values of the stream's columns.
    arrived_ns : (n,) array of int, optional
        When they arrived, by the clock of the recorder.
    """

    order: IntArray
    stamps_ns: IntArray | None
    values: FloatArray
    arrived_ns: IntArray | None = None

    @property
    def arrivals_ns(self) -> IntArray:
        """When each arrived, (n,); zeros where that is not known."""
        return np.zeros_like(self.order) if self.arrived_ns is None else self.arrived_ns

    def earlier(self, delay_ns: int) -> "StreamMessages":
        """Return the messages with stamps that are set back by a delay."""
        return self if self.stamps_ns is None else replace(self, stamps_ns=self.stamps_ns - delay_ns)

    def take(self, index: BoolArray) -> "StreamMessages":
        """Return the messages that a mask (n,) selects."""
        stamps_ns = None if self.stamps_ns is None else self.stamps_ns[index]
        return StreamMessages(self.order[index], stamps_ns, self.values[index], self.arrivals_ns[index])

    def turned(self, turn: Turn) -> "StreamMessages":
        """Return the messages with values that are turned."""
        return replace(self, values=np.column_stack(turn(*self.values.T)))

    @classmethod
    def concatenate(cls, parts: Sequence["StreamMessages"]) -> "StreamMessages":
        """Return messages that follow each other as one."""
        stamps = [part.stamps_ns for part in parts if part.stamps_ns is not None]
        return cls(
            np.concatenate([part.order for part in parts]),
            np.concatenate(stamps) if stamps else None,
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.arrivals_ns for part in parts]),
        )
