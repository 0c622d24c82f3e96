"""The field of a place and date that is given on the command line."""

from datetime import date

from tam_calibration.geomagnetic import site_field_T
from tam_calibration.problems import InputError
from tam_calibration.units import FloatArray


def field_at(place: str) -> FloatArray:
    """Return the (3,) field east, north, up of IGRF at LAT,LON,DATE, tesla.

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
        raise InputError(f"--place must be LAT,LON,DATE such as 47.37,8.54,2025-06-30, not {place!r}") from None
    return site_field_T(*where, 0.0, when)
