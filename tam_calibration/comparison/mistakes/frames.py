"""A simulator's frames that are not those of the recording: of its sensors, its attitude or the field of its world.

The recording is right: where its sensors lie along the array in some way, those of the simulation have to as well.
MuJoCo gives quaternions as w, x, y, z, and ROS takes x, y, z, w. Gazebo Sim had the field in NED axes (its pull request
2460 added ``use_earth_frame_ned``) and reads no ``<magnetic_field>`` of the world (issue 3270). MuJoCo's default field
is 0 -0.5 0.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from tam_calibration.comparison.result import Mistake
from tam_calibration.core.noise import fast_noise
from tam_calibration.integrity.fault import SHARED, Overview
from tam_calibration.integrity.placement import (
    FITS,
    TILT,
    Motion,
    Placement,
    allowed,
    nearest_turn,
    placements,
    turn_in_words,
)
from tam_calibration.model.exceptions import numbered, sensors_in_words
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import ORIENTATIONS, orientation_to_axes
from tam_calibration.model.units import FloatArray, to_degrees

MIRRORED_FIELDS = {
    "ned_for_enu": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    "wrong_hemisphere": np.diag([1.0, 1.0, -1.0]),
    "south_for_north": np.diag([-1.0, -1.0, 1.0]),
    "reversed_field": -np.eye(3),
}
"""What each mistake of the world makes of its field east, north, up."""


@dataclass(frozen=True, eq=False)
class Frames:
    """The axes of the simulation's sensors relative to those of the recording's, and the two fields of the world.

    Parameters
    ----------
    turns : (K, 3, 3) array
        What each sensor of the simulation reads, of what it should read: signed permutations.
    simulation_T, recording_T : (3,) array
        Field east, north, up, as the attitudes of the two have it, tesla.
    """

    turns: FloatArray
    simulation_T: FloatArray
    recording_T: FloatArray


_CONVENTIONS: tuple[tuple[Mistake, Callable[[FloatArray], FloatArray]], ...] = (
    (
        Mistake(
            "attitude_wxyz",
            "the simulation's quaternions are in the order w, x, y, z, and x, y, z, w is expected",
            "the attitude",
            "write MuJoCo's xquat or framequat q as x=q[1], y=q[2], z=q[3], w=q[0]",
        ),
        lambda attitude: attitude[:, [1, 2, 3, 0]],
    ),
    (
        Mistake(
            "attitude_inverse",
            "the simulation's attitude turns the world into the array, and the array into the world is expected",
            "the attitude",
            "write the inverse: reverse the signs of x, y and z of the quaternion",
        ),
        lambda attitude: attitude * [-1.0, -1.0, -1.0, 1.0],
    ),
)
"""How an attitude may have been written, and what makes x, y, z, w from array to world of it."""


def mistaken_frames(simulation: Recording, recording: Recording) -> list[Mistake]:
    """Return what is wrong with the axes, the attitude and the field of the world of a simulation.

    Parameters
    ----------
    simulation, recording : Recording
        The two, in tesla.
    """
    count, silent = simulation.sensor_count, _without_field(simulation, recording)
    if len(silent) == count:
        return list(_ignored_field(silent, [], count))
    own, other = Overview.of(simulation), Overview.of(recording)
    other_motion = Motion.of(other.recording.attitude)
    right = [] if other_motion is None else placements(other, other_motion)
    attitude, motion, placed = _mistaken_attitude(own, right)
    stuck = [] if motion is None else [each for each in _unturned(own, motion, placed) if each not in silent]
    mistakes = [*_ignored_field(silent, stuck, count), *attitude]
    frames = _frames_of(placed, right)
    if frames is None or motion is None or other_motion is None:
        return [*mistakes, *_turned_against_others(own, other)]
    world = _mistaken_field(frames, motion, other_motion)
    return [*mistakes, *_mistaken_axes(frames), *([] if world is None else [world])]


def _mistaken_attitude(
    overview: Overview, right: list[Placement]
) -> tuple[list[Mistake], Motion | None, list[Placement]]:
    """Return how the attitude of a simulation was written wrongly, and its motion and sensors with the right one."""
    attitude = overview.recording.attitude
    stated = Motion.of(attitude)
    if attitude is None or stated is None:
        return [], None, []
    as_stated = placements(overview, stated)
    tried = [
        (mistake, motion, placements(overview, motion))
        for mistake, correct in _CONVENTIONS
        if (motion := Motion.of(correct(attitude))) is not None
    ]
    mistake, motion, placed = max(tried, key=lambda each: _agreeing(each[2], right))
    if _unexplained(placed) > FITS or _unexplained(as_stated) <= allowed(_unexplained(placed)):
        return [], stated, as_stated
    return [mistake], motion, placed


def _unexplained(placed: list[Placement]) -> float:
    return float(np.median([each.unexplained.min() for each in placed]))


def _agreeing(placed: list[Placement], right: list[Placement]) -> int:
    """Return how many sensors may lie as those of the recording, or as the array where there are none."""
    if not right:
        return sum(bool(each.possible[0]) for each in placed)
    return sum(bool((own.possible & other.possible).any()) for own, other in zip(placed, right, strict=False))


def _frames_of(one: list[Placement], other: list[Placement]) -> Frames | None:
    """Return the simulation's frames relative to the recording's; None where attitude does not show them."""
    pairs = {
        sensor: (own, right, *_axes(own, right))
        for sensor, (own, right) in enumerate(zip(one, other, strict=False))
        if own.fits and right.fits
    }
    if not pairs:
        return None
    fields = np.array([own.fields_T[axes] for own, _, axes, _ in pairs.values()])
    rights = np.array([right.fields_T[axes] for _, right, _, axes in pairs.values()])
    turns = np.array([ORIENTATIONS[own].T @ ORIENTATIONS[right] for _, _, own, right in pairs.values()])
    signs = _signs(fields, np.median(rights, axis=0), (turns == np.eye(3)).all(axis=(1, 2)))
    of_all = np.tile(np.eye(3), (min(len(one), len(other)), 1, 1))
    of_all[list(pairs)] = signs[:, None, None] * turns
    return Frames(of_all, np.median(signs[:, None] * fields, axis=0), np.median(rights, axis=0))


def _mistaken_axes(frames: Frames) -> Iterator[Mistake]:
    """Yield the sensors whose axes are turned or mirrored against those of the recording, equal ones together."""
    count = len(frames.turns)
    names = [_name(turn) for turn in frames.turns]
    for kind, way, mend in dict.fromkeys(name for name in names if name is not None):
        sensors = [sensor for sensor, name in enumerate(names, 1) if name == (kind, way, mend)]
        where = sensors_in_words(sensors, count)
        yield Mistake(kind, f"the simulation's axes of {where} are not the recording's: {way}", where, mend)


def _turned_against_others(simulation: Overview, recording: Overview) -> Iterator[Mistake]:
    """Yield the sensors that are mirrored against others in the simulation alone, or turned against equal ones.

    Readings show it without attitude. Of sensors that lie as in the recording, most are taken to be right.
    """
    sensors = range(recording.sensor_count)
    turns = max(
        (_turns_against(simulation, recording, first) for first in sensors),
        key=lambda each: sum(_name(turn) is None for turn in each.values()),
    )
    kept = [sensor + 1 for sensor, turn in turns.items() if _name(turn) is None]
    for sensor, turn in turns.items():
        if (name := _name(turn)) is not None:
            kind, way, mend = name
            where, others = numbered([sensor + 1]), numbered(kept)
            what = f"the simulation's axes of {where} are not those of {others}, as the recording's are: {way}"
            yield Mistake(kind, what, where, mend)


def _turns_against(simulation: Overview, recording: Overview, first: int) -> dict[int, FloatArray]:
    """Return what each sensor reads of what it should, if the first is right and the readings show it.

    Axes that were all changed the same way look turned where sensors do not lie as the first: only mirrored ones count.
    """
    turns: dict[int, FloatArray] = {}
    for other in range(recording.sensor_count):
        own, right = _against(simulation, first, other), _against(recording, first, other)
        if own is None or right is None:
            continue
        turn = own @ right.T
        if _name(right) is None or _name(turn) is None or np.linalg.det(turn) < 0:
            turns[other] = turn
    return turns


def _against(overview: Overview, one: int, other: int) -> FloatArray | None:
    """Return what the other of two sensors reads of what the one reads, a signed permutation, if they show it."""
    if overview.shared_motion(one, other) < SHARED:
        return None
    return nearest_turn(overview.covariance[other, one] @ np.linalg.inv(overview.covariance[one, one]))


def _axes(own: Placement, right: Placement) -> tuple[int, int]:
    """Return the axes of a sensor in the simulation and in the recording: the same ones where these may be both's."""
    may_be = own.possible & right.possible
    if may_be.any():
        axes = int(np.argmin(np.where(may_be, own.unexplained + right.unexplained, np.inf)))
        return axes, axes
    return own.best, right.best


def _signs(fields_T: FloatArray, right_T: FloatArray, is_unturned: np.ndarray) -> FloatArray:
    """Return (K,) which sensors have a field and axes that are both to be reversed.

    Of sensors whose axes are unturned or all reversed the most are unturned, so that it is the world's field which may
    be reversed. Where all axes are turned otherwise, the field is nearest to one that points north.
    """
    signs: FloatArray = np.where(fields_T @ fields_T[0] < 0, -1.0, 1.0)
    balance = float(signs[is_unturned].sum())
    if balance == 0:
        field = np.median(signs[:, None] * fields_T, axis=0)
        north = (np.eye(3), MIRRORED_FIELDS["wrong_hemisphere"], MIRRORED_FIELDS["ned_for_enu"])
        along = [float(field @ turn @ right_T) for turn in north]
        balance = max(along) + min(along)
    return signs if balance >= 0 else -signs


def _name(turn: FloatArray) -> tuple[str, str, str] | None:
    """Return kind, words and mend of axes that read ``turn`` times what they should; None of right ones."""
    if (turn == np.eye(3)).all():
        return None
    is_mirrored = np.linalg.det(turn) < 0
    back = ", ".join(f"{axis} = {letter}" for axis, letter in zip("xyz", orientation_to_axes(turn.T), strict=True))
    mend = f"publish {back} of what the simulated sensor gives"
    mend += "" if is_mirrored else ", or turn its site (MuJoCo) or pose (Gazebo)"
    if (turn == np.diag([1, -1, -1])).all():
        return "frd_for_flu", "y and z are reversed, FRD (forward, right, down) for FLU (forward, left, up)", mend
    way = turn_in_words(turn)
    if way.endswith("exchanged"):
        return "exchanged_axes", way, mend
    if way.startswith("x, y, z"):
        way = f"they are {'mirrored' if is_mirrored else 'turned'}: {way}"
    return "mirrored_axis" if is_mirrored else "turned_axes", way, mend


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


def _without_field(simulation: Recording, recording: Recording) -> list[int]:
    """Return the sensors, numbered from 1, of the simulation that read nothing but noise."""
    usual = float(np.median(np.linalg.norm(recording.readings_T, axis=2)))
    own = np.median(np.linalg.norm(simulation.readings_T, axis=2), axis=0)
    # Less than 1 µT is no field.
    return [sensor for sensor, size in enumerate(own, 1) if size < 0.02 * usual]


def _unturned(overview: Overview, motion: Motion, placed: list[Placement]) -> list[int]:
    """Return the sensors, numbered from 1, whose readings do not turn where the attitude does."""
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


def _ignored_field(silent: list[int], stuck: list[int], count: int) -> Iterator[Mistake]:
    """Yield what is to be said of sensors that read no field, and of those that do not turn in it."""
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


def _mistaken_field(frames: Frames, one: Motion, other: Motion) -> Mistake | None:
    """Return what is wrong with the field of the simulation's world; None where nothing is."""
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
