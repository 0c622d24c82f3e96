"""Normal equations of least squares, which add up over samples."""

from dataclasses import dataclass

from tam_calibration.units import FloatArray


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations: information matrix (P, P), score (P,), energy of the channels and their number."""

    information: FloatArray
    score: FloatArray
    energy: float
    count: float

    def __add__(self, other: "Normal") -> "Normal":
        """Return the normal equations of both sets of samples."""
        return Normal(
            self.information + other.information,
            self.score + other.score,
            self.energy + other.energy,
            self.count + other.count,
        )

    def __sub__(self, other: "Normal") -> "Normal":
        """Return the normal equations without a part of the samples."""
        return Normal(
            self.information - other.information,
            self.score - other.score,
            self.energy - other.energy,
            self.count - other.count,
        )
