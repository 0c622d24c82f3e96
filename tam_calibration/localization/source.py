"""What a dipole and a loop have in common: a place, a magnetic moment, and a field that follows from both."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from tam_calibration.units import FloatArray


@dataclass(frozen=True, eq=False)
class Source(ABC):
    """A magnetic source at rest.

    Parameters
    ----------
    position_m : (3,) array
        Its centre, metres, in the frame of the points at which its field is asked for.
    moment_Am2 : (3,) array
        Magnetic moment in the same frame, A m².
    """

    position_m: FloatArray
    moment_Am2: FloatArray

    @abstractmethod
    def from_offset(self, offset_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return field, gradient and the field's derivative by the moment at offsets (…, 3) from the source, SI."""

    def field_T(self, points_m: FloatArray) -> FloatArray:
        """Return the field (…, 3) at points (…, 3), tesla."""
        return self.from_offset(points_m - self.position_m)[0]

    def gradient_T_per_m(self, points_m: FloatArray) -> FloatArray:
        """Return the symmetric, trace-free gradient tensor (…, 3, 3) at points (…, 3), T/m."""
        return self.from_offset(points_m - self.position_m)[1]
