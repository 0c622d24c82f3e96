"""The main geomagnetic field of a place and date, from the International Geomagnetic Reference Field."""

from datetime import date, datetime

import numpy as np

from tam_calibration.exceptions import InputError
from tam_calibration.field_bounds import FieldBounds
from tam_calibration.units import FloatArray, from_nanotesla

MODEL_YEARS = (1900, 2030)
"""First year of IGRF-14, and the year at whose beginning it ends."""

FARTHEST_FROM_IGRF = 1.5
"""Times the model's intensity, or its inverse: twice the 10 µT of 48 that were measured in 55 homes (Swanson 1994,
static magnetic fields in homes in the UK), for buildings with more steel. Crust away from ore makes some hundred nT."""


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
    """
    import ppigrf  # late, as it brings pandas with it

    if not -90 <= latitude_deg <= 90:
        raise InputError(f"the latitude must lie between -90 and 90 degrees, not at {latitude_deg}")
    if not -180 <= longitude_deg <= 360:
        raise InputError(f"the longitude must lie between -180 and 360 degrees east, not at {longitude_deg}")
    if not -10e3 <= height_m <= 600e3:
        raise InputError(f"the height must lie between -10 and 600 km, not at {height_m} m")
    if not MODEL_YEARS[0] <= day.year < MODEL_YEARS[1]:
        raise InputError(
            f"the geomagnetic model IGRF-14 holds from {MODEL_YEARS[0]} to {MODEL_YEARS[1] - 1}, not in {day.year}"
        )
    components = ppigrf.igrf(longitude_deg, latitude_deg, height_m / 1e3, datetime(day.year, day.month, day.day))
    return from_nanotesla(np.ravel(components).astype(float))


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
        raise InputError(f"a place must be LAT,LON,DATE such as 47.37,8.54,2025-06-30, not {place!r}") from None
    return site_field_T(*where, 0.0, when)


def bounds_at(place: str) -> FieldBounds:
    """Return what the intensity of the field can be at LAT,LON,DATE, with iron nearby.

    Raises
    ------
    InputError
        When that is no place and date of the model.
    """
    intensity_T = float(np.linalg.norm(field_at(place)))
    return FieldBounds(intensity_T / FARTHEST_FROM_IGRF, intensity_T * FARTHEST_FROM_IGRF, "the place's")
