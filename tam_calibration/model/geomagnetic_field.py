"""The geomagnetic field: bounds of its intensity, and its value at a place and date from the IGRF.

The potential of the International Geomagnetic Reference Field, 14th generation (IAGA, doi:10.5281/zenodo.14012302), is
a sum of solid harmonics, summed here with the recursions of Cunningham (Celestial Mechanics 2, 1970), which hold at the
poles as well. ``IGRF14.shc`` is IAGA's file: Gauss coefficients, nT, of every fifth year.
"""

from dataclasses import dataclass
from datetime import date
from functools import cache
from math import factorial, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla, to_nanotesla

_Coefficients = NDArray[np.complex128]

_FILE = Path(__file__).with_name("IGRF14.shc")


EQUATORIAL_RADIUS_M, _ECCENTRICITY_SQUARED = 6378137.0, 0.00669437999014
"""Of the ellipsoid WGS 84 (NIMA TR8350.2)."""


def _field(position_m: FloatArray, coefficients: _Coefficients) -> FloatArray:
    """Return the (3,) field, minus the gradient of the potential, along the axes of the Earth."""
    solid = _solid_harmonics(position_m, len(coefficients))
    field = np.zeros(3)
    for degree in range(1, len(coefficients)):
        for order in range(degree + 1):
            above = solid[degree + 1]
            rising = -above[order + 1]  # the derivatives along x + iy, x - iy and z, times the reference radius
            falling = (degree - order + 2) * (degree - order + 1) * above[order - 1] if order else rising.conjugate()
            along_z = -(degree - order + 1) * above[order]
            gradient = np.array([(rising + falling) / 2, (rising - falling) / 2j, along_z])
            field -= (coefficients[degree, order] * gradient).real
    return field


def _solid_harmonics(position_m: FloatArray, highest: int) -> _Coefficients:
    """Return (a/r)ⁿ⁺¹ Pₙₘ(sin φ) exp(imλ), a the reference radius, by degree n up to the highest and order m."""
    # Of the sphere to which the coefficients refer.
    reference_radius_m = 6371.2e3
    squared = reference_radius_m**2 / float(position_m @ position_m)
    x, y, z = (squared * position_m / reference_radius_m).tolist()
    solid = np.zeros((highest + 1, highest + 1), dtype=complex)
    solid[0, 0] = np.sqrt(squared)
    for order in range(highest + 1):
        if order:
            solid[order, order] = (2 * order - 1) * complex(x, y) * solid[order - 1, order - 1]
        for degree in range(order + 1, highest + 1):
            one, two = solid[degree - 1, order], solid[degree - 2, order] if degree > order + 1 else 0.0
            raised = (2 * degree - 1) * z * one - (degree + order - 1) * squared * two
            solid[degree, order] = raised / (degree - order)
    return solid


def _coefficients(day: date) -> _Coefficients:
    """Return g - ih in nT by degree and order, without the normalisation of Schmidt."""
    days, sets = _published()
    later = int(np.searchsorted(days, day.toordinal(), side="right"))
    passed = (day.toordinal() - days[later - 1]) / (days[later] - days[later - 1])
    interpolated: _Coefficients = (1 - passed) * sets[later - 1] + passed * sets[later]
    return interpolated


@cache
def _published() -> tuple[list[int], _Coefficients]:
    """Return the days of the T sets of coefficients and their values (T, degrees, orders)."""
    lines = [line.split() for line in _FILE.read_text(encoding="ascii").splitlines() if not line.startswith("#")]
    days = [date(int(float(year)), 1, 1).toordinal() for year in lines[1]]
    sizes = int(lines[-1][0]) + 1  # the highest degree comes last
    sets = np.zeros((len(days), sizes, sizes), dtype=complex)
    for line in lines[2:]:
        degree, order, values = int(line[0]), int(line[1]), np.array([float(value) for value in line[2:]])
        size = abs(order)
        schmidt = np.sqrt((2 if order else 1) * factorial(degree - size) / factorial(degree + size))
        sets[:, degree, size] += (1 if order >= 0 else -1j) * schmidt * values
    return days, sets


WEAKEST_FIELD_T = 200e-9
"""In a weaker one a nanotesla of noise is more than half a per cent; and the Earth's in µT, taken for nT, is weaker."""

STRONGEST_FIELD_T = 10e-3
"""Where coils and sensors of such fields end; the Earth's in pT, taken for nT, is stronger."""


LOCAL_STANDARD_ERROR_T = 140e-9
"""Of each component of a model of the main field: crust and currents, as the World Magnetic Model states."""

OF_IGRF = f"IGRF at the place, ± {to_nanotesla(LOCAL_STANDARD_ERROR_T):.0f} nT"
"""Such a field for people."""

LOCAL_VARIANCE_T2 = LOCAL_STANDARD_ERROR_T**2 * np.eye(3)
"""(3, 3) covariance of such a field."""

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

    def hold_each(self, intensity_T: FloatArray) -> np.ndarray:
        """Return the (N,) mask of the intensities that lie within."""
        return (self.low_T <= intensity_T) & (intensity_T <= self.high_T)

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
        # Of a sensor's readings, in units of the strongest field: a bias may be many times the field.
        largest_bias = 100.0
        low, high = self.low_T / largest_bias, max(self.high_T, EARTH_FIELD.high_T) * largest_bias
        for sensor, value in enumerate(length_T.tolist()):
            if not low <= value <= high:
                raise self._refusal(f"sensor {sensor + 1} reads", value)

    def _refusal(self, subject: str, tesla: float) -> InputError:
        """Say what is wrong, and ask which mistake of units takes a field within the bounds for another."""
        fits = [name for name, factor in _UNITS.items() if self.hold(tesla / factor)]
        hint = f"is this {' or '.join(fits)}?" if fits else "check the unit and the source"
        return InputError(f"{subject} {tesla * 1e6:.4g} µT, but {self}: {hint}")


EARTH_FIELD = FieldBounds(15e-6, 100e-6, "the Earth's")
"""Of the geomagnetic field anywhere, with what iron and magnets nearby add to it."""


def site_field_T(latitude_deg: float, longitude_deg: float, height_m: float, day: date) -> FloatArray:
    """Return the field of IGRF-14 at a place: the Earth's core only, without crust, ionosphere and buildings.

    Parameters
    ----------
    latitude_deg : float
        Geodetic latitude, -90 to 90 degrees.
    longitude_deg : float
        Longitude, degrees east, -180 to 360.
    height_m : float
        Height above the WGS84 ellipsoid, metres.
    day : date
        Day of the field, 1900 to 2029.

    Returns
    -------
    (3,) array
        Components east, north, up, tesla.

    Raises
    ------
    InputError
        When a coordinate or the day lies outside its bounds.

    Examples
    --------
    >>> from datetime import date
    >>> from tam_calibration import site_field_T
    >>> (site_field_T(48.1, 11.6, 520.0, date(2026, 7, 1)) * 1e6).round(1)  # east, north, up, µT
    array([  1.6,  21.1, -44. ])
    """
    if not -90 <= latitude_deg <= 90:
        raise InputError(f"the latitude must lie between -90 and 90 degrees, not at {latitude_deg}")
    if not -180 <= longitude_deg <= 360:
        raise InputError(f"the longitude must lie between -180 and 360 degrees east, not at {longitude_deg}")
    if not -10e3 <= height_m <= 600e3:
        raise InputError(f"the height must lie between -10 and 600 km, not at {height_m} m")
    first, *_, last = (date.fromordinal(each).year for each in _published()[0])
    if not first <= day.year < last:
        raise InputError(f"the geomagnetic model IGRF-14 is valid from {first} to {last - 1}, not in {day.year}")
    place = np.array([latitude_deg, longitude_deg, height_m])
    return from_nanotesla(axes_at(place) @ _field(earth_centred(place), _coefficients(day)))


def axes_at(place: FloatArray) -> FloatArray:
    """Return the unit vectors (…, 3, 3) east, north and up at places (…, 3), from the Earth's centre."""
    latitude, longitude = from_degrees(np.moveaxis(place[..., :2], -1, 0))
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    east = np.stack([-sin_lon, cos_lon, np.zeros_like(latitude)], axis=-1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=-1)
    return np.stack([east, north, np.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat], axis=-1)], axis=-2)


def earth_centred(place: FloatArray) -> FloatArray:
    """Return geographic positions (…, 3), degrees and metres above the ellipsoid, in metres from the Earth's centre."""
    up = axes_at(place)[..., 2, :]
    across_m = EQUATORIAL_RADIUS_M / np.sqrt(1 - _ECCENTRICITY_SQUARED * up[..., 2:] ** 2)
    return np.asarray(up * (across_m + place[..., 2:] - np.array([0.0, 0.0, _ECCENTRICITY_SQUARED]) * across_m))


def field_at(place: str) -> FloatArray:
    """Return the (3,) field east, north, up at LAT,LON,DATE at sea level, tesla.

    Raises
    ------
    InputError
        When that is no place and date of the model.
    """
    try:
        latitude, longitude, day = place.split(",")
        where = float(latitude), float(longitude)
        when = date.fromisoformat(day.strip())
    except ValueError:
        raise InputError(f"a place must be LAT,LON,DATE such as 47.37,8.54,2025-06-30, not {quoted(place)}") from None
    return site_field_T(*where, 0.0, when)


def bounds_at(place: str) -> FieldBounds:
    """Return what the intensity of the field can be at LAT,LON,DATE, with iron nearby.

    Raises
    ------
    InputError
        When that is no place and date of the model.
    """
    intensity_T = float(np.linalg.norm(field_at(place)))
    # Times the model's intensity, or its inverse: twice the 10 µT of 48 that were measured in 55 homes (Swanson 1994,
    # static magnetic fields in homes in the UK), for buildings with more steel. Crust away from ore makes some hundred
    # nT.
    farthest_from_igrf = 1.5
    return FieldBounds(intensity_T / farthest_from_igrf, intensity_T * farthest_from_igrf, "the place's")
