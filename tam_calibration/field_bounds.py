"""Between which bounds the intensity of a field lies, who says so, and what a value beyond them may come from."""

from dataclasses import dataclass
from math import sqrt

from tam_calibration.exceptions import InputError
from tam_calibration.units import FloatArray, to_nanotesla

WEAKEST_FIELD_T = 200e-9
"""In a weaker one a nanotesla of noise is more than half a per cent; and the Earth's in µT, taken for nT, is weaker."""

STRONGEST_FIELD_T = 10e-3
"""Where coils and sensors of such fields end; the Earth's in pT, taken for nT, is stronger."""

_LARGEST_BIAS = 100.0
"""Of a sensor's readings, in units of the strongest field: a bias may be many times the field."""

_UNITS = {
    "µT given as T": 1e6,
    "nT given as T": 1e9,
    "gauss given as T": 1e4,
    "nT given as µT": 1e3,
    "gauss given as µT": 1e-2,
    "µT given as nT": 1e-3,
    "T given as µT": 1e-6,
    "T given as nT": 1e-9,
}
"""Times the true value, for each mistake of units."""


@dataclass(frozen=True)
class FieldBounds:
    """Bounds of the intensity of the field in which an array is turned.

    Parameters
    ----------
    low_T, high_T : float
        Bounds, tesla.
    whose : str
        Field: who says so.

    Raises
    ------
    InputError
        When they are no bounds of a field in which sensors can be calibrated.
    """

    low_T: float
    high_T: float
    whose: str = "the array's"

    def __post_init__(self) -> None:
        """Check order and size."""
        if not WEAKEST_FIELD_T <= self.low_T < self.high_T <= STRONGEST_FIELD_T:
            least, most = (f"{to_nanotesla(bound):.0f}" for bound in (WEAKEST_FIELD_T, STRONGEST_FIELD_T))
            low, high = (f"{to_nanotesla(bound):.6g}" for bound in (self.low_T, self.high_T))
            raise InputError(
                f"the bounds of the field's intensity must be a lower and an upper one within {least} to {most} nT, "
                f"not {low} and {high} nT: check their order and unit"
            )

    def __str__(self) -> str:
        """Return the bounds in a clause."""
        return f"{self.whose} field has {self.range_uT} µT"

    @property
    def range_uT(self) -> str:
        """The bounds for people, in µT."""
        return f"{self.low_T * 1e6:.4g} to {self.high_T * 1e6:.4g}"

    @property
    def middle_T(self) -> float:
        """The geometric mean of the bounds."""
        return sqrt(self.low_T * self.high_T)

    def hold(self, intensity_T: float) -> bool:
        """Whether an intensity lies within."""
        return self.low_T <= intensity_T <= self.high_T

    def require_intensity(self, intensity_T: float) -> None:
        """Check the intensity that a scalar magnetometer reads.

        Raises
        ------
        InputError
            When it lies beyond the bounds; a mistake of units that would explain it is named.
        """
        if not self.hold(intensity_T):
            raise self._refusal("the scalar intensity is", intensity_T)

    def require_readings(self, length_T: FloatArray) -> None:
        """Check the lengths (K,) that sensors mostly read.

        Raises
        ------
        InputError
            When one cannot be that of the field with a bias, however large.
        """
        # A weak field is that of a shield, and makes no smaller bias.
        low, high = self.low_T / _LARGEST_BIAS, max(self.high_T, EARTH_FIELD.high_T) * _LARGEST_BIAS
        for sensor, value in enumerate(length_T.tolist()):
            if not low <= value <= high:
                raise self._refusal(f"sensor {sensor + 1} reads", value)

    def _hint(self, tesla: float) -> str:
        """Return which mistake of units takes a field within the bounds for another, as a question."""
        fits = [name for name, factor in _UNITS.items() if self.hold(tesla / factor)]
        return f"is this {' or '.join(fits)}?" if fits else "check the unit and the source"

    def _refusal(self, subject: str, tesla: float) -> InputError:
        return InputError(f"{subject} {tesla * 1e6:.4g} µT, but {self}: {self._hint(tesla)}")


EARTH_FIELD = FieldBounds(15e-6, 100e-6, "the Earth's")
"""Of the geomagnetic field anywhere, with what iron and magnets nearby add to it."""
