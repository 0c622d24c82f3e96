"""Sensors with left-handed axes: reversed or exchanged ones, found with the other sensors and recorded attitude.

The intensity of a field does not tell them: it is the same for the mirrored one. Nor does attitude alone, as all axes
reversed are those of a field that is reversed in the world; only that fields point north does.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from tam_calibration.integrity.fault import Fault, between, channel
from tam_calibration.integrity.overview import SHARED, Overview
from tam_calibration.model.units import FloatArray

NEAR = 0.8
"""Part of an axis along another for which it is named: within 37 degrees, nearer than to any other."""

NORTH = 0.7
"""Part along north of the level field of a place: within 45 degrees; the reversed one points south."""

ENOUGH = 300
"""Attitudes that tell how a sensor is placed: thirty for each product of an axis and a component of the field."""

LEVEL = 0.05
"""Fraction of the field that must be horizontal for a north direction."""

ONE_FIELD = 0.1
"""Of the singular values of what sensor and field make together, the second to the first: of one field it is 0."""

UNEXPLAINED = 0.01
"""Share of the variance of readings that attitude leaves where it is that of the sensor: an error of six degrees."""

_LEFT_HANDED = [
    turn
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
    if np.linalg.det(turn := np.eye(3)[list(order)] * np.array(signs)[:, None]) < 0
]
"""The 24 ways in which left-handed axes can lie along right-handed ones."""


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
    placements = {sensor: placed for sensor in seen if (placed := _placed(overview, sensor)) is not None}
    wrong = _against_attitude(placements, [group for group in (one, other) if group])
    if wrong:
        for sensor in wrong:
            yield _fault(overview, sensor, _way(placements[sensor].axes), "the recorded attitude")
    elif few:
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
    return _fault(overview, sensor, _way(np.asarray(against)), _names(many))


def _names(sensors: list[int]) -> str:
    return " and ".join(channel(sensor + 1) for sensor in sensors)


def _fault(overview: Overview, sensor: int, way: str, against: str) -> Fault:
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


def _way(against: FloatArray) -> str:
    """Return in words how axes (3, 3) lie that are left-handed."""
    rows = against / np.linalg.norm(against, axis=1, keepdims=True)
    best = max(_LEFT_HANDED, key=lambda turn: float(np.sum(turn * rows)))
    if (np.sum(best * rows, axis=1) < NEAR).any():
        return "its axes are mirrored"
    reversed_ = ["xyz"[axis] for axis in range(3) if best[axis].min() < 0]
    moved = ["xyz"[axis] for axis in range(3) if best[axis, axis] == 0]
    if not moved:
        return "all axes are reversed" if len(reversed_) == 3 else f"axis {reversed_[0]} is reversed"
    words = f"axes {' and '.join(moved)} are exchanged"
    return f"{words} and {' and '.join(reversed_)} reversed" if reversed_ else words


@dataclass(frozen=True, eq=False)
class _Placed:
    """Axes (3, 3) of a sensor in the array, of unit length, and the field (3,) in the world; or both reversed."""

    axes: FloatArray
    field: FloatArray

    def left_handed(self) -> "_Placed":
        """Return it as that of left-handed axes."""
        return self if np.linalg.det(self.axes) < 0 else _Placed(-self.axes, -self.field)

    @property
    def is_along_array(self) -> bool:
        """Whether it is right-handed, with its axes along those of the array."""
        return bool((np.diagonal(self.left_handed().axes) < -NEAR).all())

    @property
    def points_north(self) -> bool:
        level = float(np.hypot(*self.field[:2]))
        return level > LEVEL * float(np.linalg.norm(self.field)) and float(self.field[1]) > NORTH * level


def _placed(overview: Overview, sensor: int) -> _Placed | None:
    """Return how a sensor is placed, from readings M Qᵀ h + o: products of M and h by regression on the attitude Q."""
    attitude = overview.recording.attitude
    if attitude is None:
        return None
    from scipy.spatial.transform import Rotation

    known = np.flatnonzero(np.isfinite(attitude).all(axis=1))
    known = known[:: max(1, len(known) // ENOUGH)]
    if len(known) < 3 * 9:
        return None
    turns = Rotation.from_quat(attitude[known]).as_matrix().reshape(-1, 9)
    readings = overview.without_spikes_T[3 * sensor : 3 * sensor + 3, known].T
    turns, readings = turns - turns.mean(axis=0), readings - readings.mean(axis=0)
    products, _, rank, _ = np.linalg.lstsq(turns, readings, rcond=1e-3)
    left = readings - turns @ products
    if rank < 9 or np.sum(left**2) > UNEXPLAINED * np.sum(readings**2):
        return None
    # Of row a of M and component c of h: products[(c, b), a] = M[a, b] h[c].
    stacked = products.reshape(3, 3, 3).transpose(2, 1, 0).reshape(9, 3)
    one, size, world = np.linalg.svd(stacked, full_matrices=False)
    if size[1] > ONE_FIELD * size[0]:
        return None
    axes = one[:, 0].reshape(3, 3)
    return _Placed(axes / np.linalg.norm(axes, axis=1, keepdims=True), world[0])


def _against_attitude(placements: dict[int, _Placed], groups: list[list[int]]) -> list[int]:
    """Return the sensors that attitude shows to be left-handed; none where it does not tell.

    In a group of one handedness, one sensor along the array's axes shows that it is the right one.
    """
    if not placements or any(sensor not in placements for group in groups for sensor in group):
        return []
    sound = [any(placements[sensor].is_along_array for sensor in group) for group in groups]
    if all(sound) or (len(groups) > 1 and not any(sound)):
        return []
    wrong = groups[sound.index(False)]
    for sensor in wrong:
        placements[sensor] = placements[sensor].left_handed()
    return wrong if any(sound) or all(placements[sensor].points_north for sensor in wrong) else []
