"""How sensors lie in the array, but for small angles, and what field there is in the world, as attitude shows it.

A sensor whose axes lie along those of the array but for a signed permutation P reads b = Pᵀ Rᵀ h + o, with R the
attitude, h the field of the world and o a bias. About their means P b = C h, with C = Rᵀ less its mean: for each P a
linear least-squares problem in h with one and the same matrix A = ⟨Cᵀ C⟩ (Wahba, A least squares estimate of satellite
attitude, SIAM Review 7, 1965, with the unknown rotation among few). P with h reads as -P with -h: rotations suffice.

Sensors with left-handed axes are found with the other sensors and with recorded attitude. The intensity of a field does
not show them: it is the same for the mirrored one. Nor does attitude alone, as all axes reversed are those of a field
that is reversed in the world; only that fields point north does.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.integrity.fault import SHARED, Fault, Overview, channel
from tam_calibration.model.sensor_errors import ORIENTATIONS, orientation_to_axes
from tam_calibration.model.units import FloatArray

FITS = 0.1
"""Share of the readings' variance that attitude may leave: scale errors of 5 %, 3° of misalignment and 5° in attitude
leave some 0.02, axes that are turned wrongly more than half of what turns."""


ROUNDING = 0.005
"""Share of variance that separates no axes: sensors that are otherwise exact have errors of 4°."""

TILT = 0.1
"""Root mean square by which the world must turn about the array in every direction before all of the field is known: 6°
of roll or pitch."""

FEWEST = 30
"""Samples with attitude: five for each of the six unknowns."""

NEAR = 0.8
"""Part of an axis along another for which it is named: within 37 degrees, nearer than to any other."""

_SIGNED_PERMUTATIONS = np.concatenate([ORIENTATIONS, -ORIENTATIONS])
"""The 48 ways in which axes can lie along others, the 24 left-handed ones last."""


def nearest_turn(axes: FloatArray) -> FloatArray | None:
    """Return the signed permutation (3, 3) that is nearest to some axes (3, 3); None where one of them is far off."""
    rows = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    along = np.sum(_SIGNED_PERMUTATIONS * rows, axis=2).min(axis=1)
    return np.asarray(_SIGNED_PERMUTATIONS[along.argmax()]) if along.max() > NEAR else None


def turn_in_words(turn: FloatArray) -> str:
    """Return how axes lie that read ``turn`` (3, 3), a signed permutation, times what they should."""
    letters = orientation_to_axes(turn)
    changed = " and ".join(axis for axis, letter in zip("xyz", letters, strict=True) if letter != axis)
    if (np.diagonal(turn) != 0).all():
        if len(changed) == 1:
            return f"axis {changed} is reversed"
        return "all axes are reversed" if turn.max() == 0 else f"axes {changed} are reversed"
    if np.trace(turn) == 1 and turn.min() == 0:
        return f"axes {changed} are exchanged"
    return f"x, y, z read {', '.join(letters)}"


def allowed(least: float) -> float:
    """Return the share of the variance that other axes may leave where the best ones leave the least."""
    # Times the unexplained variance of the best axes that other axes may leave.
    return min(5.0 * least + ROUNDING, FITS)


@dataclass(frozen=True, eq=False)
class Motion:
    """The attitudes of some samples, as matrices.

    Parameters
    ----------
    known : (n,) array
        Which samples of the overview have one.
    turns : (n, 3, 3) array
        What turns vectors of the world into the array, less the mean.
    """

    known: np.ndarray
    turns: FloatArray

    @classmethod
    def of(cls, attitude: FloatArray | None) -> "Motion | None":
        """Return that of quaternions (n, 4), if any; None where too few are known."""
        if attitude is None:
            return None
        known = np.flatnonzero(np.isfinite(attitude).all(axis=1))
        if len(known) < FEWEST:
            return None
        from scipy.spatial.transform import Rotation

        turns = Rotation.from_quat(attitude[known]).inv().as_matrix()
        return cls(known, turns - turns.mean(axis=0))

    @property
    def gram(self) -> FloatArray:
        """(3, 3) ⟨Cᵀ C⟩: how much each direction of the world turns."""
        return np.asarray(np.einsum("nij,nik->jk", self.turns, self.turns) / len(self.turns))

    @property
    def extent(self) -> FloatArray:
        """(3,) root mean squares by which directions of the world turn, increasing; 1 where through all directions."""
        return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(self.gram), 0)))


@dataclass(frozen=True, eq=False)
class Placement:
    """How well each of the 24 axes explains what a sensor reads.

    Parameters
    ----------
    unexplained : (24,) array
        Share of the variance that ``ORIENTATIONS`` leave.
    fields_T : (24, 3) array
        Field of the world with each of them, tesla.
    explained_T : float
        Root mean square of the readings that the best of them explains, tesla.
    """

    unexplained: FloatArray
    fields_T: FloatArray
    explained_T: float

    @property
    def fits(self) -> bool:
        """Whether some axes explain what the sensor reads."""
        return bool(self.unexplained.min() <= FITS)

    @property
    def best(self) -> int:
        """Which axes explain most."""
        return int(np.argmin(self.unexplained))

    @property
    def turn(self) -> FloatArray:
        """(3, 3) what the sensor reads, of the field along the axes of the array."""
        return np.asarray(ORIENTATIONS[self.best].T)

    @property
    def possible(self) -> np.ndarray:
        """(24,) which axes may be those of the sensor."""
        return self.unexplained <= allowed(float(self.unexplained.min()))


def placements(overview: Overview, motion: Motion) -> list[Placement]:
    """Return the placements of all sensors against attitudes.

    Parameters
    ----------
    overview : Overview
        Of K sensors.
    motion : Motion
        Of its samples.
    """
    inverse = np.linalg.pinv(motion.gram, rcond=TILT**4)
    return [
        _placement(overview.without_spikes_T[3 * sensor : 3 * sensor + 3, motion.known].T, motion, inverse)
        for sensor in range(overview.sensor_count)
    ]


def _placement(readings_T: FloatArray, motion: Motion, inverse: FloatArray) -> Placement:
    readings_T = readings_T - readings_T.mean(axis=0)
    variance = max(float(np.mean(np.sum(readings_T**2, axis=1))), np.finfo(float).tiny)
    products = np.einsum("nij,nk->ijk", motion.turns, readings_T) / len(readings_T)
    projected = np.einsum("pik,ijk->pj", ORIENTATIONS, products)
    fields = projected @ inverse
    explained = np.sum(projected * fields, axis=1)
    return Placement(1 - explained / variance, fields, float(np.sqrt(max(explained.max(), 0.0))))


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
        hands = [1 if first == other else _hand(overview, first, other) for other in sensors]
        if 2 * sum(map(abs, hands)) > len(hands):
            return hands
    return [0 for _ in sensors]


def _hand(overview: Overview, one: int, other: int) -> int:
    if overview.shared_motion(one, other) < SHARED:
        return 0
    return 1 if np.linalg.det(overview.covariance[one, other]) > 0 else -1


def _of_consensus(overview: Overview, sensor: int, many: list[int]) -> Fault:
    covariance = overview.covariance
    against = sum(covariance[sensor, other] @ np.linalg.inv(covariance[other, other]) for other in many)
    return replace(_fault(overview, sensor, nearest_turn(np.asarray(against)), _names(many)), is_acceptable=False)


def _names(sensors: list[int]) -> str:
    return " and ".join(channel(sensor + 1) for sensor in sensors)


def _fault(overview: Overview, sensor: int, turn: FloatArray | None, against: str) -> Fault:
    """Return a fault whose axes lie as a left-handed ``turn`` of those that they should be, where it is known."""
    way = "its axes are mirrored" if turn is None else turn_in_words(turn)
    sentence = f"{channel(sensor + 1)} is left-handed throughout: against {against} {way}"
    axis = way.removeprefix("axis ")[0] if way.startswith("axis ") else ""
    return Fault("mirrored", sensor + 1, axis, overview.time_s, sentence)


def _of_either(overview: Overview, few: list[int], many: list[int]) -> Fault:
    verb = "is a mirror image" if len(few) == 1 else "are mirror images"
    sentence = (
        f"{_names(few)} {verb} of {_names(many)} throughout: which is left-handed can be decided only "
        "with recorded attitude, or where more sensors are right"
    )
    return Fault("mirrored", None, "", overview.time_s, sentence, is_acceptable=False)


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
    if not any(sound) and not all(_points_south(placed[sensor].fields_T[placed[sensor].best]) for sensor in wrong):
        return {}
    return {sensor: -placed[sensor].turn for sensor in wrong}


def _points_south(field_T: FloatArray) -> bool:
    """Return whether a field is level enough, and nearer to south than to east and west: fields point north."""
    is_level = np.hypot(*field_T[:2]) > LEVEL * np.linalg.norm(field_T)
    return bool(is_level and field_T[1] < -abs(field_T[0]))
