"""Positions of a platform as navigation writes them, in metres east, north and up."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, from_degrees, to_degrees

Axes = Literal["local", "altitude", "depth"]
"""Three numbers of a position: metres along three axes, or latitude and longitude in degrees with altitude or depth."""

LOCAL: Axes = "local"

GEOGRAPHIC_COLUMNS = ("lat_deg", "lon_deg", "depth_m")
"""Columns of a geographic position in a table."""

_POSE = tuple(f"pose.pose.position.{axis}" for axis in "xyz")

POSITION_FIELDS = {
    "nav_msgs/msg/Odometry": _POSE,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _POSE,
    "sensor_msgs/msg/NavSatFix": ("latitude", "longitude", "altitude"),
}
"""Fields of the position in the types of ROS that hold one."""

_RADIUS_M, _FLATTENING = 6_378_137.0, 1 / 298.257223563
"""Equatorial radius and flattening of the ellipsoid WGS 84 (NIMA TR8350.2)."""


def axes_of(fields: Sequence[str]) -> Axes:
    """Return the meaning of the three numbers of a position, by the names of the first and the last."""
    if not fields[0].lower().startswith("lat"):
        return "local"
    return "depth" if fields[-1].lower().startswith("depth") else "altitude"


class Navigation:
    """Turns positions into metres east, north and up; geographic ones count from an origin.

    Parameters
    ----------
    axes : {"local", "altitude", "depth"}
        What the three numbers of a position are.
    world : {"enu", "ned"}
        Of local positions: the order of their axes.
    origin : (3,) array, optional
        Latitude and longitude, degrees, and height, metres; the first position where it is not given.
    """

    def __init__(self, axes: Axes, world: str, origin: FloatArray | None = None) -> None:
        self._axes, self._is_ned = axes, world == "ned"
        self._origin = origin

    def local_m(self, raw: FloatArray) -> FloatArray:
        """Return positions (n, 3) east, north and up, metres; NaN where a number is missing.

        Parameters
        ----------
        raw : (n, 3) array
            As recorded.

        Raises
        ------
        InputError
            When a latitude or longitude is beyond what there is.
        """
        if self._axes == "local":
            return raw[:, [1, 0, 2]] * [1.0, 1.0, -1.0] if self._is_ned else raw
        known = np.flatnonzero(np.isfinite(raw).all(axis=1))
        places = raw[known] * [1.0, 1.0, -1.0 if self._axes == "depth" else 1.0]
        _require_degrees(places)
        local = np.full(raw.shape, np.nan)
        if len(known):
            self._origin = places[0] if self._origin is None else self._origin
            local[known] = east_north_up(places, self._origin)
        return local


def _require_degrees(places: FloatArray) -> None:
    for number, name, most in ((0, "latitude", 90.0), (1, "longitude", 360.0)):
        beyond = places[np.abs(places[:, number]) > most, number]
        if len(beyond):
            raise InputError(
                f"the position has a {name} of {beyond[0]:g}°, and {most:g}° is the most: give degrees, or name "
                "x_m, y_m, z_m for metres"
            )


def east_north_up(places: FloatArray, origin: FloatArray) -> FloatArray:
    """Return positions (n, 3) in the tangent plane of the ellipsoid at an origin: east, north and up, metres.

    Parameters
    ----------
    places : (n, 3) array
        Latitude and longitude, degrees, and height above the ellipsoid, metres.
    origin : (3,) array
        The same of the origin.
    """
    return np.asarray((_earth_centred(places) - _earth_centred(origin[None])) @ _axes_at(origin).T)


def geographic(local_m: FloatArray, origin: FloatArray) -> FloatArray:
    """Return latitude and longitude, degrees, and height, metres, of positions east, north and up of an origin.

    Parameters
    ----------
    local_m : (n, 3) array
        Metres in the tangent plane of the ellipsoid at the origin.
    origin : (3,) array
        Latitude and longitude, degrees, and height above the ellipsoid, metres.
    """
    places, turn = np.tile(origin, (len(local_m), 1)), _axes_at(origin)
    off, before = local_m @ turn, np.inf
    while (size := np.abs(off).max(initial=0.0)) < before:
        before = size
        for place, step in zip(places, off, strict=True):
            east, north, up = _axes_at(place) @ step
            radius = _RADIUS_M + place[2]
            shrunk = radius * np.cos(from_degrees(place[0]))
            place += [to_degrees(north / radius), to_degrees(east / shrunk), up]
        off = (local_m - east_north_up(places, origin)) @ turn
    return places


def _axes_at(origin: FloatArray) -> FloatArray:
    """Return the unit vectors (3, 3) east, north and up at a place, from the Earth's centre."""
    latitude, longitude = from_degrees(origin[:2])
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    east, north = (-sin_lon, cos_lon, 0.0), (-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat)
    return np.array([east, north, (cos_lat * cos_lon, cos_lat * sin_lon, sin_lat)])


def _earth_centred(places: FloatArray) -> FloatArray:
    """Return geographic positions (n, 3) in metres from the Earth's centre."""
    latitude, longitude = from_degrees(places[:, :2].T)
    squeeze = 1 - _FLATTENING * (2 - _FLATTENING)
    curvature = _RADIUS_M / np.sqrt(1 - (1 - squeeze) * np.sin(latitude) ** 2)
    across = (curvature + places[:, 2]) * np.cos(latitude)
    up = (squeeze * curvature + places[:, 2]) * np.sin(latitude)
    return np.column_stack([across * np.cos(longitude), across * np.sin(longitude), up])
