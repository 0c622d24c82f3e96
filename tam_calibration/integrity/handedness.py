"""Sensors with left-handed axes: reversed or exchanged ones, found with the other sensors and recorded attitude.

The intensity of a field does not show them: it is the same for the mirrored one. Nor does attitude alone, as all axes
reversed are those of a field that is reversed in the world; only that fields point north does.
"""

from collections.abc import Iterator

import numpy as np

from tam_calibration.integrity.fault import Fault, between, channel
from tam_calibration.integrity.overview import SHARED, Overview
from tam_calibration.integrity.placement import Motion, nearest_turn, placements, turn_in_words
from tam_calibration.model.units import FloatArray

NORTH = 0.7
"""Part along north of the level field of a place: within 45 degrees; the reversed one points south."""

UNEXPLAINED = 0.02
"""Share of the variance of readings that attitude leaves where it is the sensor's: see ``placement.FITS``."""

LEVEL = 0.05
"""Fraction of the field that must be horizontal for a north direction."""


def left_handed(overview: Overview) -> Iterator[Fault]:
    """Yield the sensors that are left-handed, or of which one or the other is.

    Parameters
    ----------
    overview : Overview
        Of K sensors, with attitude or without.
    """
    hands = _relative_hands(overview)
    seen = [sensor for sensor, hand in enumerate(hands) if hand]
    if not seen:
        return
    one, other = ([sensor for sensor in seen if hands[sensor] == hand] for hand in (1, -1))
    few, many = sorted((one, other), key=len)
    if len(few) < len(many) and few:
        yield from (_of_consensus(overview, sensor, many) for sensor in few)
        return
    wrong = _left_handed_by_attitude(overview, [group for group in (one, other) if group])
    for sensor, turn in wrong.items():
        yield _fault(overview, sensor, turn, "the recorded attitude")
    if few and not wrong:
        yield _of_either(overview, few, many)


def _relative_hands(overview: Overview) -> list[int]:
    """Return of each sensor whether it is as the first that moves (1), mirrored (-1), or not comparable (0)."""
    sensors = range(overview.sensor_count)
    for first in sensors:
        hands = [_hand(overview, first, sensor) for sensor in sensors]
        if 2 * sum(map(abs, hands)) > len(hands):
            return hands
    return [0 for _ in sensors]


def _hand(overview: Overview, one: int, other: int) -> int:
    if one == other:
        return 1
    if overview.shared_motion(one, other) < SHARED:
        return 0
    return 1 if np.linalg.det(overview.covariance[one, other]) > 0 else -1


def _of_consensus(overview: Overview, sensor: int, many: list[int]) -> Fault:
    covariance = overview.covariance
    against = sum(covariance[sensor, other] @ np.linalg.inv(covariance[other, other]) for other in many)
    return _fault(overview, sensor, nearest_turn(np.asarray(against)), _names(many))


def _names(sensors: list[int]) -> str:
    return " and ".join(channel(sensor + 1) for sensor in sensors)


def _fault(overview: Overview, sensor: int, turn: FloatArray | None, against: str) -> Fault:
    """Return a fault whose axes lie as a left-handed ``turn`` of those that they should be, where it is known."""
    way = "its axes are mirrored" if turn is None else turn_in_words(turn)
    sentence = f"{channel(sensor + 1)} is left-handed {between(overview.time_s)}: against {against} {way}"
    axis = way.removeprefix("axis ")[0] if way.startswith("axis ") else ""
    return Fault("mirrored", sensor + 1, axis, overview.time_s, sentence)


def _of_either(overview: Overview, few: list[int], many: list[int]) -> Fault:
    verb = "is a mirror image" if len(few) == 1 else "are mirror images"
    sentence = (
        f"{_names(few)} {verb} of {_names(many)} {between(overview.time_s)}: which is left-handed can be decided only "
        "with recorded attitude, or where more sensors are right"
    )
    return Fault("mirrored", None, "", overview.time_s, sentence)


def _left_handed_by_attitude(overview: Overview, groups: list[list[int]]) -> dict[int, FloatArray]:
    """Return the sensors that attitude shows to be left-handed, and how their axes lie; none where it does not show it.

    A sensor that reads as right-handed axes P in a field h reads as left-handed axes -P in -h, too. In a group of one
    handedness, one sensor along the array's axes shows that it is the right one; a field that points north shows it of
    all together.
    """
    motion = Motion.of(overview.recording.attitude)
    if motion is None:
        return {}
    placed = placements(overview, motion)
    for sensor in (sensor for group in groups for sensor in group):
        if placed[sensor].possible.sum() != 1 or placed[sensor].unexplained.min() > UNEXPLAINED:
            return {}
    sound = [any((placed[sensor].turn == np.eye(3)).all() for sensor in group) for group in groups]
    if all(sound) or (len(groups) > 1 and not any(sound)):
        return {}
    wrong = groups[sound.index(False)]
    if not any(sound) and not all(_points_north(-placed[sensor].fields_T[placed[sensor].best]) for sensor in wrong):
        return {}
    return {sensor: -placed[sensor].turn for sensor in wrong}


def _points_north(field_T: FloatArray) -> bool:
    level = float(np.hypot(*field_T[:2]))
    return level > LEVEL * float(np.linalg.norm(field_T)) and float(field_T[1]) > NORTH * level
