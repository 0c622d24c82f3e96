"""What becomes of the raw values of one stream: unwrapped, in SI, in the right order and world, the missing marked."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tam_calibration.messages.missing import FAR, Range, codes_of, in_words
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import EQUATORIAL_RADIUS_M, FieldBounds, axes_at, earth_centred
from tam_calibration.model.units import (
    TESLA_PER_FIELD_UNIT,
    FloatArray,
    from_degrees,
    from_nanotesla,
    to_degrees,
    to_nanotesla,
)
from tam_calibration.recordings.channel_map import Pick

Axes = Literal["local", "altitude", "depth"]
"""Three numbers of a position: metres along three axes, or latitude and longitude in degrees with altitude or depth."""

GEOGRAPHIC_COLUMNS = ("lat_deg", "lon_deg", "depth_m")
"""Columns of a geographic position in a table."""

_POSE = tuple(f"pose.pose.position.{axis}" for axis in "xyz")

POSITION_FIELDS = {
    "nav_msgs/msg/Odometry": _POSE,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _POSE,
    "sensor_msgs/msg/NavSatFix": ("latitude", "longitude", "altitude"),
}
"""Fields of the position in the types of ROS that hold one."""


def axes_of(fields: Sequence[str]) -> Axes:
    """Return the meaning of the three numbers of a position, by the names of the first and the last."""
    if not fields[0].lower().startswith("lat"):
        return "local"
    return "depth" if fields[-1].lower().startswith("depth") else "altitude"


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
    return np.asarray((earth_centred(places) - earth_centred(origin)) @ axes_at(origin).T)


def geographic(local_m: FloatArray, origin: FloatArray) -> FloatArray:
    """Return latitude and longitude, degrees, and height, metres, of positions east, north and up of an origin.

    Parameters
    ----------
    local_m : (n, 3) array
        Metres in the tangent plane of the ellipsoid at the origin.
    origin : (3,) array
        Latitude and longitude, degrees, and height above the ellipsoid, metres.
    """
    places, turn = np.tile(origin, (len(local_m), 1)), axes_at(origin)
    off, before = local_m @ turn, np.inf
    while (size := np.abs(off).max(initial=0.0)) < before:
        before = size
        east, north, up = np.einsum("nij,nj->in", axes_at(places), off)
        radius = EQUATORIAL_RADIUS_M + places[:, 2]
        shrunk = radius * np.cos(from_degrees(places[:, 0]))
        places += np.column_stack([to_degrees(north / radius), to_degrees(east / shrunk), up])
        off = (local_m - east_north_up(places, origin)) @ turn
    return places


_JUMP = 0.75
"""Of a counter's range: a larger step between readings is an overflow; other steps are below the rest of the range."""


_ROUND = 0.03
"""Least variance of readings along any direction, in squares of their sphere's radius, that tells the field's size.

Directions that fill a cone of 66° about an axis have it. A short course, as past a dipole, has a hundredth of it, and
many spheres fit that.
"""


def is_of_field(stream: str) -> bool:
    """Return whether a stream reads a field, as the sensors and the scalar do."""
    return stream == "scalar" or stream.startswith("tam_")


@dataclass
class Intake:
    """Takes the values of one stream, batch by batch.

    Parameters
    ----------
    stream : str
        ``tam_1`` … ``tam_K``, or the channel's name.
    pick : Pick
        Its unit, or the nanotesla of a count; its world.
    bounds : FieldBounds
        What the intensity of the field can be, for a unit that is not stated.
    unwrap : bool
        Whether overflows of a counter are taken out.
    doubtful : str
        Unit that the format states, where the field may tell another; empty of none.
    axes : {"local", "altitude", "depth"}
        What the three numbers of a position are.
    origin : (3,) array, optional
        Latitude and longitude, degrees, and height, metres, from which geographic positions count; the first position
        where it is not given.
    """

    stream: str
    pick: Pick
    bounds: FieldBounds
    unwrap: bool
    doubtful: str = ""
    axes: Axes = "local"
    origin: FloatArray | None = None

    def __post_init__(self) -> None:
        """Begin before the first values."""
        self.unit: str = self.pick.unit
        self._factor = self.pick.factor if is_of_field(self.stream) else 1.0
        self._range: Range | None = None
        self._counter: Counter | None = None
        self._before: FloatArray = np.empty((0, 3))

    @property
    def is_detected(self) -> bool:
        """Whether its unit was detected by the size of the field."""
        return self.unit not in ("", self.pick.unit, self.doubtful)

    def take(self, raw: FloatArray) -> tuple[FloatArray, NDArray[np.int8]]:
        """Return values in SI, and the codes of those that are missing (``missing.REASONS``).

        Parameters
        ----------
        raw : (n, width) array
            As they stand in the file; of a scalar that is a vector its three components.

        Raises
        ------
        InputError
            When the unit is not stated and cannot be detected, a counter overflows and is not to be unwrapped, or a
            latitude or longitude is beyond what there is.
        """
        if self.stream == "scalar" and raw.shape[1] == 3:
            raw = np.sqrt(np.sum(raw**2, axis=1, keepdims=True))
        codes = codes_of(self.stream, raw)
        if self.stream == "position":
            return self._local_m(raw), codes
        is_there = (codes == 0) & ~np.isnan(raw[:, 0])  # a sensor's reading that is NaN has a code
        if not is_there.all():
            raw = np.where(is_there[:, None], raw, np.nan)
        if self.stream.startswith("tam_"):
            raw = self._unwrapped(raw, is_there)
        if self._range is None and is_there.any():
            self._range = Range.of(self.stream, raw[is_there])
        if self._range is not None:
            codes[is_there & self._range.beyond(raw)] = FAR
        if self._factor is None and is_there.any():
            self.unit = self._detected(raw[is_there & (codes == 0)])
            self._factor = TESLA_PER_FIELD_UNIT[self.unit]
        return in_si(self.stream, raw, 1.0 if self._factor is None else self._factor, self.pick.world), codes

    def _local_m(self, raw: FloatArray) -> FloatArray:
        """Return positions (n, 3) east, north and up, metres; NaN where a number is missing."""
        if self.axes == "local":
            return raw[:, [1, 0, 2]] * [1.0, 1.0, -1.0] if self.pick.world == "ned" else raw
        known = np.flatnonzero(np.isfinite(raw).all(axis=1))
        places = raw[known] * [1.0, 1.0, -1.0 if self.axes == "depth" else 1.0]
        _require_degrees(places)
        local = np.full(raw.shape, np.nan)
        if len(known):
            self.origin = places[0] if self.origin is None else self.origin
            local[known] = east_north_up(places, self.origin)
        return local

    def _detected(self, raw: FloatArray) -> str:
        """Return the unit in which the readings have the size of the field.

        Raises
        ------
        InputError
            When there is none.
        """
        size = field_size(raw)
        unit = likely_unit(size, self.doubtful, self.bounds) or self.doubtful
        if not unit:
            raise InputError(size_doubt(self.stream, size))
        return unit

    def _unwrapped(self, raw: FloatArray, is_there: NDArray[np.bool_]) -> FloatArray:
        """Return readings without overflows; the first of these may be in any batch."""
        there = raw[is_there]
        if self._counter is None or not len(self._before):
            self._counter = Counter.of(there)
        else:
            self._counter.look(self._before, there)
        self._before = there if len(there) else self._before
        if not self._counter.axes:
            return raw
        if not self.unwrap:
            raise InputError(f"{in_words(self.stream)} {self._counter.overflows(there)[0]}")
        return self._counter.unwrapped(raw, is_there)


_WORLD_TURN = np.sqrt(0.5) * np.array([[0, 0, 1, 1], [0, 0, -1, 1], [-1, 1, 0, 0], [-1, -1, 0, 0]]).T
"""Turns quaternions x, y, z, w (n, 4) from the right: the world's axes go from north-east-down to east-north-up."""


def in_si(stream: str, raw: FloatArray, factor: float, world: str) -> FloatArray:
    """Return values (…, width) of a stream in SI, an attitude in a world of east, north and up.

    Parameters
    ----------
    stream : str
        Its name.
    raw : (…, width) array
        In its own unit.
    factor : float
        Tesla in its unit; 1 of what is no field.
    world : {"enu", "ned"}
        The world of an attitude.
    """
    if stream == "attitude" and world == "ned":
        return np.asarray(raw @ _WORLD_TURN)
    if factor == 1.0:
        return raw
    # Divisions by whole numbers round decimals correctly; so microtesla and gauss go as nanotesla do.
    per_nanotesla = round(to_nanotesla(factor))
    with np.errstate(over="ignore"):
        if abs(per_nanotesla / to_nanotesla(factor) - 1) < 1e-12:
            return from_nanotesla(raw * per_nanotesla)
        return raw * factor


def field_size(raw: FloatArray) -> float:
    """Return the size of the field that readings (n, 3) or intensities (n, 1) show, in their own unit; NaN of none.

    Of vectors that were turned all round it is the radius of their sphere, which a bias does not change; else their
    median length.
    """
    if not len(raw):
        return float("nan")
    if raw.shape[1] == 1:
        return float(np.median(np.abs(raw)))
    lengths = np.linalg.norm(raw, axis=1)
    if len(raw) < 10:
        return float(np.median(lengths))
    scale = float(np.median(lengths)) or 1.0
    points = raw / scale
    matrix = np.column_stack([2 * points, np.ones(len(points))])
    *center, power = np.linalg.lstsq(matrix, np.sum(points**2, axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(power + np.square(center).sum(), 0.0)))
    # The noise of a sensor that lies still fills a ball, in which no radius prevails.
    # The distances from the centre then spread by a quarter of the radius at most.
    is_shell = np.std(np.linalg.norm(points - center, axis=1)) < 0.25 * radius
    is_sphere = is_shell and np.linalg.eigvalsh(np.cov(points.T))[0] >= _ROUND * radius**2
    return scale * radius if is_sphere else float(np.median(lengths))


def likely_unit(size: float, stated: str, bounds: FieldBounds) -> str:
    """Return the unit in which a field is the Earth's: the stated one, else the only one; empty where there is none.

    A size of 1 has none: it is that of readings that were normalised, rather than a field of 1 G.

    Parameters
    ----------
    size : float
        Of the field, as recorded; NaN of other quantities.
    stated : str
        Unit that a format or a name states, or empty.
    bounds : FieldBounds
        What the intensity of the field can be.
    """
    fitting = [unit for unit, tesla in TESLA_PER_FIELD_UNIT.items() if bounds.low_T <= size * tesla <= bounds.high_T]
    if stated in fitting:
        return stated
    return fitting[0] if len(fitting) == 1 and not _is_normalised(size) else ""


def size_doubt(stream: str, size: float) -> str:
    """Return why a field of a size without a unit cannot be read, and what to state."""
    subject = f"{in_words(stream)} reads a field of"
    if _is_normalised(size):
        return f"{subject} 1, which seems to be normalised: state scale_nT, the true field, in the map"
    return f"{subject} about {size:.3g}, in no unit the Earth's: state unit or scale_nT in the map"


def _is_normalised(size: float) -> bool:
    # No field of 1 G is the Earth's.
    return abs(size - 1) < 0.02


@dataclass
class Counter:
    """The counters of a sensor that overflow, by axis, and how often each has until now.

    Parameters
    ----------
    axes : dict of int to int
        Width of each counter that overflows, bits.
    sizes : dict of int to float
        By how much the readings of each jump where it overflows, in their unit.
    """

    axes: dict[int, int]
    sizes: dict[int, float]

    def __post_init__(self) -> None:
        """Begin before the first reading."""
        self._last: dict[int, float] = {}
        self._turns = dict.fromkeys(self.axes, 0)

    @classmethod
    def of(cls, raw: FloatArray) -> "Counter":
        """Return the counters that readings (n, 3) show: large jumps, which are gone without the overflows."""
        axes: dict[int, int] = {}
        sizes: dict[int, float] = {}
        for axis in range(3):
            jumps, span = np.abs(np.diff(raw[:, axis])), float(np.ptp(raw[:, axis])) if len(raw) else 0.0
            is_large = jumps >= _JUMP * span
            # The counter's range is between the span and, but for a step, its 1 / _JUMP: the rest is dear.
            if is_large.sum() < 2 or jumps[~is_large].max(initial=0.0) > 1.1 * (1 - _JUMP) / _JUMP * span:
                continue
            # The steps of one axis alone: another may have another converter. A few readings miss its least step.
            for step, bits in product({_step(raw[:, axis]), _step(raw)}, (8, 12, 16, 24)):
                size = step * 2.0**bits
                is_overflow = jumps > _JUMP * size
                if not (_JUMP * size < span + step <= size * (1 + 1e-9)) or is_overflow.sum() < 2:
                    continue
                # Almost all jumps must be whole counts: by chance a tenth are.
                is_count = np.abs(jumps / step - np.round(jumps / step)) < 0.05
                steps = np.where(is_overflow, np.abs(jumps - size), jumps)
                if is_count.mean() >= 0.9 and steps.max() < (1 - _JUMP) * size:
                    axes[axis], sizes[axis] = bits, size
        counter = cls(axes, sizes)
        if axes:
            counter._turns = cls(axes, sizes)._turns_before(raw)
        return counter

    def look(self, before: FloatArray, raw: FloatArray) -> None:
        """Add the counters that overflow in readings (n, 3) for the first time, and did not in those (m, 3) before.

        Raises
        ------
        InputError
            When one did, which these alone did not show.
        """
        found = Counter.of(np.vstack([before, raw]))
        for axis in found.axes.keys() - self.axes.keys():
            bits, size = found.axes[axis], found.sizes[axis]
            if (np.abs(np.diff(before[:, axis])) > _JUMP * size).any():
                raise InputError(
                    f"axis {'xyz'[axis]} of a sensor overflows by 2^{bits} counts, and too seldom at first to be seen: "
                    "read the recording from there on with --from"
                )
            self.axes[axis], self.sizes[axis] = bits, size
            self._turns[axis], self._last[axis] = 0, float(before[-1, axis])

    def _turns_before(self, raw: FloatArray) -> dict[int, int]:
        """Return the turns of each counter before the first of readings (n, 3), with which the intensity varies least.

        A bias is far smaller than a counter's range, so that any other turn would show in the intensity.
        """
        continued = self.unwrapped(raw, np.ones(len(raw), dtype=bool))

        def variation(turns: tuple[int, ...]) -> float:
            moved = continued.copy()
            moved[:, list(self.axes)] += np.array(turns) * np.array(list(self.sizes.values()))
            return float(np.std(np.linalg.norm(moved, axis=1)))

        turns = min(product((0, -1, 1), repeat=len(self.axes)), key=variation)
        return dict(zip(self.axes, turns, strict=True))

    def overflows(self, raw: FloatArray) -> list[str]:
        """Return how often the axes of readings (n, 3) jump, a clause for each."""
        return [
            f"axis {'xyz'[axis]} jumps {(np.abs(np.diff(raw[:, axis])) > _JUMP * self.sizes[axis]).sum()} times by "
            f"2^{bits} counts: its counter of {bits} bits overflows; read it with --unwrap"
            for axis, bits in self.axes.items()
        ]

    def unwrapped(self, raw: FloatArray, is_there: NDArray[np.bool_]) -> FloatArray:
        """Return readings (n, 3) without the overflows, as those before them go on."""
        raw = raw.copy()
        for axis, size in self.sizes.items():
            values = raw[is_there, axis]
            if not len(values):
                continue
            steps = np.diff(values, prepend=self._last.get(axis, values[0]))
            turns = self._turns[axis] - np.cumsum(np.round(steps / size)).astype(int)
            self._last[axis], self._turns[axis] = float(values[-1]), int(turns[-1])
            raw[is_there, axis] = values + size * turns
        return raw


def _step(raw: FloatArray) -> float:
    """Return the least step between readings; 0 where they have none."""
    values = np.unique(raw[:100_000])
    steps = np.diff(values)
    steps = steps[steps > 1e-9 * np.abs(values).max(initial=0.0)]
    return float(steps.min()) if len(steps) else 0.0
