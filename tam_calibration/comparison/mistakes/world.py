"""A simulator's field of the world that is none of the recording's: ignored, in NED, of the wrong hemisphere.

Gazebo Sim had the field in NED axes (its pull request 2460 added ``use_earth_frame_ned``) and reads no
``<magnetic_field>`` of the world (issue 3270). MuJoCo's default field is 0 -0.5 0.
"""

from collections.abc import Iterator

import numpy as np

from tam_calibration.comparison.mistakes.frames import MIRRORED_FIELDS, Frames
from tam_calibration.comparison.result import Mistake
from tam_calibration.core.noise import fast_noise
from tam_calibration.integrity.fault import Overview
from tam_calibration.integrity.placement import TILT, Motion, Placement
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, to_degrees

_EAST_NORTH_UP = "write the field of the world east, north, up"

_WORDS = {
    "default_field": (
        "is MuJoCo's default, half a gauss that points south",
        "write the field of the place, east, north, up",
    ),
    "vertical_field": ("is vertical", "give the field its level part too"),
    "ned_for_enu": (
        "is in NED (north, east, down), and ENU (east, north, up) is expected",
        "set <use_earth_frame_ned>false</use_earth_frame_ned> in Gazebo Sim's magnetometer system, or "
        + _EAST_NORTH_UP,
    ),
    "wrong_hemisphere": (
        "has its vertical part reversed: it is of the wrong hemisphere, or of another site",
        _EAST_NORTH_UP,
    ),
    "south_for_north": ("points south where the recording's points north", _EAST_NORTH_UP),
    "reversed_field": ("is reversed, or all axes of all sensors are", _EAST_NORTH_UP),
}
"""What each mistake is, and what to change."""


def without_field(simulation: Recording, recording: Recording) -> list[int]:
    """Return the sensors, numbered from 1, of the simulation that read nothing but noise.

    Parameters
    ----------
    simulation, recording : Recording
        The two, in tesla.
    """
    usual = float(np.median(np.linalg.norm(recording.readings_T, axis=2)))
    own = np.median(np.linalg.norm(simulation.readings_T, axis=2), axis=0)
    # Less than 1 µT is no field.
    return [sensor for sensor, size in enumerate(own, 1) if size < 0.02 * usual]


def unturned(overview: Overview, motion: Motion, placed: list[Placement]) -> list[int]:
    """Return the sensors, numbered from 1, whose readings do not turn where the attitude does.

    Parameters
    ----------
    overview : Overview
        Of the simulation, in tesla.
    motion : Motion
        Of its samples.
    placed : list of Placement
        Of its sensors.
    """
    turning = float(motion.extent[1])
    if turning < TILT:
        return []
    length = np.median(np.linalg.norm(overview.recording.readings_T, axis=2), axis=0)
    fast = fast_noise(overview.values_T.T).reshape(-1, 3)
    spread = np.sqrt(np.sum(np.maximum(overview.spread_T**2 - fast**2, 0), axis=1))
    return [
        sensor
        for sensor, each in enumerate(placed, 1)
        # Within 2° of a pole the level field is less; a magnet that comes near may change the readings otherwise.
        if each.explained_T < 0.03 * turning * length[sensor - 1]
        and spread[sensor - 1] < 0.1 * turning * length[sensor - 1]
    ]


def ignored_field(silent: list[int], stuck: list[int], count: int) -> Iterator[Mistake]:
    """Yield what is to be said of sensors that read no field, and of those that do not turn in it.

    Parameters
    ----------
    silent, stuck : list of int
        Numbers of these sensors.
    count : int
        Number of all sensors of the simulation.
    """
    for sensors, way in ((silent, "reads nothing but noise about zero"), (stuck, "does not turn with the attitude")):
        if sensors:
            where = sensors_in_words(sensors, count)
            yield Mistake(
                "no_world_field",
                f"the simulation ignores the world's field: what is read by {where} {way}",
                where,
                "give the world a field and turn it into the axes of the sensor: MuJoCo's <magnetometer site=…/> with "
                '<option magnetic="0 2.1e-05 -4.3e-05"/>; in Gazebo Sim <spherical_coordinates> in the world and the '
                "magnetometer system, which reads no <magnetic_field>",
            )


def mistaken_field(frames: Frames, one: Motion, other: Motion) -> Mistake | None:
    """Return what is wrong with the field of the simulation's world, compared with the recording's; None for nothing.

    Parameters
    ----------
    frames : Frames
        Of the two.
    one, other : Motion
        Of the simulation and of the recording.
    """
    if min(one.extent[0], other.extent[0]) < TILT:
        return None
    own, right = frames.simulation_T, frames.recording_T
    kind = _kind(own, right, len(frames.turns))
    if kind is None:
        return None
    what, mend = _WORDS[kind]
    theirs, ours = (", ".join(f"{component * 1e6:.3g}" for component in field) for field in (own, right))
    fields = f"({theirs}) µT, where the recording has ({ours}) µT east, north, up"
    written = " ".join(f"{component:.2e}" for component in right)
    return Mistake(
        kind,
        f"the simulation's field of the world {what}: {fields}",
        "the world",
        f'{mend}, as by <option magnetic="{written}"/> in MuJoCo',
    )


def _kind(own: FloatArray, right: FloatArray, count: int) -> str | None:
    """Return what is wrong with a field that so many sensors read, compared with the right one."""
    # Misalignment of 3° about each axis and 5 % of scale factor on both sides.
    near_deg = 12.0 / np.sqrt(count)
    # Only the poles have a vertical field.
    if _from_vertical(own) < 7.0 / np.sqrt(count) and _from_vertical(right) > 20.0:
        return "vertical_field"
    # Sites that are some thousand kilometres apart differ by more.
    if _angle(own, right) < 30.0:
        return None
    # MuJoCo points south by default, half a gauss.
    if _angle(own, np.array([0.0, -1.0, 0.0])) < near_deg and _is_size(own, 0.5e-4, count):
        return "default_field"
    # The world is ENU where the recording points about north: attitude without a compass has any heading.
    if abs(to_degrees(float(np.arctan2(right[0], right[1])))) > 45.0:
        return None
    angles = {kind: _angle(own, turn @ right) for kind, turn in MIRRORED_FIELDS.items()}
    kind = min(angles, key=lambda each: angles[each])
    if kind == "wrong_hemisphere":
        return kind if angles[kind] < near_deg and _is_size(own, float(np.linalg.norm(right)), count) else None
    # Fields that point south are none of the Earth anywhere: the simulation may be of another site.
    return kind if angles[kind] < 30.0 else None


def _is_size(field_T: FloatArray, intensity_T: float, count: int) -> bool:
    return bool(abs(np.linalg.norm(field_T) / intensity_T - 1) < 0.12 / np.sqrt(count))


def _angle(one: FloatArray, other: FloatArray) -> float:
    """Return the angle between two vectors, degrees."""
    cosine = float(one @ other) / float(np.linalg.norm(one) * np.linalg.norm(other))
    return to_degrees(float(np.arccos(np.clip(cosine, -1, 1))))


def _from_vertical(field_T: FloatArray) -> float:
    return to_degrees(float(np.arctan2(np.hypot(*field_T[:2]), abs(field_T[2]))))
