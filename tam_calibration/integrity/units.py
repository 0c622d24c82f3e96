"""Axes, sensors or a scalar in another unit than the others, found by the spread of the readings."""

from collections.abc import Iterator

import numpy as np

from tam_calibration.integrity.fault import Fault, between, channel, in_nanotesla
from tam_calibration.integrity.overview import SHARED, Overview
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import FieldBounds
from tam_calibration.model.units import FloatArray

APART = 30.0
"""Times another spread that is another unit: between the 10 of another range and the 100 of microtesla to gauss."""

TURNED = 0.02
"""Of the field, that readings vary along any direction at least, before axes are compared: one degree of turning."""


def in_other_units(overview: Overview, array: Array) -> Iterator[Fault]:
    """Yield what is in another unit than the rest; nothing where all is.

    Parameters
    ----------
    overview : Overview
        Of K sensors.
    array : Array
        What the intensity of the field can be.
    """
    field, scalar = array.field, overview.recording.scalar_T
    scalar_T = None if scalar is None else float(np.nanmedian(scalar))
    known_T = scalar_T if scalar_T is not None and field.hold(scalar_T) else None
    size = np.sqrt(np.sum(overview.spread_T**2, axis=1))
    wrong = _of_sensors(overview, field if known_T is None else known_T)
    if wrong.all():
        if known_T is not None and _may_be_read(overview, field):
            yield _fault(overview, None, "", float(np.median(size)), known_T)
        return
    sound = size[~wrong.any(axis=1) & (size > 0)]
    usual = float(np.median(sound)) if len(sound) else known_T or field.middle_T
    for sensor, each in enumerate(wrong):
        if each.all():
            yield _fault(overview, sensor, "", float(size[sensor]), usual)
            continue
        for axis in np.flatnonzero(each):
            yield _fault(overview, sensor, "xyz"[axis], float(overview.spread_T[sensor, axis]), usual / np.sqrt(3))
    if scalar_T is None or known_T is not None or not len(sound):
        return
    # Readings that spread so far may be those of a field within bounds, and not of what the scalar reads.
    is_apart = not usual / APART < scalar_T < usual * APART
    if is_apart and field.low_T * TURNED < usual < field.high_T * 2:
        sentence = (
            f"the scalar reads {in_nanotesla(scalar_T)} {between(overview.time_s)}, where the sensors vary by "
            f"{in_nanotesla(usual)}: it is in another unit"
        )
        yield Fault("unit", None, "", overview.time_s, sentence)


def _may_be_read(overview: Overview, field: FieldBounds) -> bool:
    """Whether all readings are of a size that agrees with the bounds of the field."""
    try:
        field.require_readings(np.median(np.linalg.norm(overview.recording.readings_T, axis=2), axis=0))
    except InputError:
        return False
    return True


def _of_sensors(overview: Overview, reference: FieldBounds | float) -> FloatArray:
    """Return (K, 3) whether each axis is too small (-1), too large (1) or neither (0)."""
    low_T, high_T = (reference, reference) if isinstance(reference, float) else (reference.low_T, reference.high_T)
    spread, principal = overview.spread_T, overview.principal_T
    size = np.sqrt(np.sum(spread**2, axis=1))
    wrong = _against_others(spread, principal, TURNED * low_T)
    large, small = (wrong.sum(axis=1) == sign * 3 for sign in (1, -1))
    if large.any() and small.any() and (large | small).all():
        off = np.abs(np.log(np.maximum(size, np.finfo(float).tiny) / np.sqrt(low_T * high_T)))
        wrong[large if off[large].min() < off[small].min() else small] = 0
    # No field spreads further than it is strong, whatever it is added to.
    wrong[spread > APART * high_T] = 1
    if overview.sensor_count == 1:
        # Times the spread of an axis that the others have, where no other sensor shows how the array was turned:
        # no turntable keeps an axis within a fifth of a degree.
        wrong[0][spread[0] * 300.0 < np.median(spread[0])] = -1
    # At rest all sensors read their noise, which is round too, and small.
    # Least over largest variance of readings whose spread is that of the complete field: those of half a sphere.
    is_round = (principal[:, 0] ** 2 > 0.25 * principal[:, 2] ** 2).all() and not wrong.any()
    if is_round and (size * APART < low_T).all() and len(size) > 1 and overview.shared_motion(0, 1) > SHARED:
        wrong[:] = -1
    return wrong


def _against_others(spread: FloatArray, principal: FloatArray, turned_T: float) -> FloatArray:
    """Return (K, 3) whether most other sensors vary more in each direction (-1), or less in every one (1), or not (0).

    Sensors that are hardly turned in some direction, by less than ``turned_T`` say, do not show what is too small.
    """
    wrong = np.zeros_like(spread)
    for sensor, own in enumerate(spread):
        least, most = np.delete(principal[:, 0], sensor), np.delete(principal[:, 2], sensor)
        small = (own[:, None] * APART < least) & (least > TURNED * most) & (least > turned_T)
        large = (own[:, None] > APART * most) & (most > 0)
        wrong[sensor] += (2 * large.sum(axis=1) > len(least)).astype(int) - (2 * small.sum(axis=1) > len(least))
    return wrong


def _fault(overview: Overview, sensor: int | None, axis: str, own_T: float, usual_T: float) -> Fault:
    ratio = np.log10(max(own_T, np.finfo(float).tiny) / usual_T)
    times = f"about {10.0 ** abs(round(ratio)):.7g} times too {'much' if ratio > 0 else 'little'}"
    subject = "every sensor" if sensor is None else channel(sensor + 1, axis)
    sentence = (
        f"{subject} varies by {in_nanotesla(own_T)} {between(overview.time_s)}, {times}: it is in another unit than "
        f"{'the scalar' if sensor is None else 'the rest'}"
    )
    return Fault("unit", None if sensor is None else sensor + 1, axis, overview.time_s, sentence)
