"""The values that an axis takes: those of another unit, an end of its range, coarse steps, or what a stuck bit leaves.

Another unit shows in the spread of the readings. A stuck bit leaves out every second band of equal width, where the
other sensors have values.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tam_calibration.integrity.fault import SHARED, Fault, Overview, between, channel, fault_of_axis, in_nanotesla
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
            f"the scalar reads {in_nanotesla(scalar_T)} throughout, where the sensors vary by "
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
    varies = f"varies by {in_nanotesla(own_T)} throughout, {times}: it is"
    if sensor is None:
        sentence = f"every sensor {varies} in another unit than the scalar"
        return Fault("unit", None, axis, overview.time_s, sentence)
    why = "in another unit than the rest" if ratio > 0 else "dead, disconnected, or in another unit than the rest"
    sentence = f"{channel(sensor + 1, axis)} {varies} {why}"
    return Fault("unit", sensor + 1, axis, overview.time_s, sentence, is_acceptable=bool(axis))


FEWEST_AT_END = 6
"""Samples at the end of a range that are no coincidence."""


MANY_AT_END = 0.01
"""Share of the samples at an end that spoils a fit: a sphere is cut off by 2 % of the field, and scale errs by 1e-3."""

COARSE = 10.0
"""Of the error of rounding to the stated noise: standard errors would be ten times too small."""


def at_ends(overview: Overview) -> Iterator[Fault]:
    """Yield the axes that stay at an end of their range, each with the share of the samples there."""
    values = overview.values_T
    for column, row in enumerate(overview.sorted_T):
        for name, outward in (("largest", row[::-1]), ("smallest", row)):
            end = outward[0]
            if outward[FEWEST_AT_END - 1] != end:
                continue
            inner = outward[outward != end]
            # Steps in the range of an axis at least, before one value is its end: a few steps may fill unevenly.
            if not len(inner) or 20.0 * abs(end - inner[0]) > abs(end - inner[-1]):
                continue
            there = values[column] == end
            own = 3 * (column // 3)
            different = len(np.unique(values[own : own + 3, there], axis=1).T)
            # Of samples at the end to those one step further in: where a sine turns, coarse steps make 2.4.
            if different >= max(FEWEST_AT_END, 5.0 * int((inner == inner[0]).sum())):
                yield _at_end(overview, column, name, float(end), there)


def _at_end(overview: Overview, column: int, name: str, end_T: float, there: np.ndarray) -> Fault:
    share, time_s = float(there.mean()), overview.recording.time_s[there]
    span = float(time_s[0]), float(time_s[-1])
    words = (
        f"stays at its {name} reading, {in_nanotesla(end_T)}, in {share:.2g} of the samples "
        f"{between(span, overview.time_s)}: it is saturated"
    )
    return fault_of_axis("saturated", column, words, span, "refusal" if share >= MANY_AT_END else "warning", True)


def in_steps(overview: Overview, array: Array) -> Iterator[Fault]:
    """Yield the axes whose readings have steps that are coarse compared with the stated noise."""
    if array.vector_noise_T is None:
        return
    for column, row in enumerate(overview.sorted_T):
        noise = float(array.vector_noise_T[column // 3])
        step = _step(row)
        if step is not None and step / np.sqrt(12) > COARSE * noise:
            words = (
                f"reads in steps of {in_nanotesla(step)} throughout, {step / np.sqrt(12) / noise:.3g} "
                "times the stated noise: state the noise of these readings, or leave it out"
            )
            yield fault_of_axis("quantised", column, words, overview.time_s, may_be_effect=True)


def _step(ordered: FloatArray) -> float | None:
    """Return the step of readings (n,) in increasing order, None where there is none to be seen."""
    gaps = np.diff(ordered)
    rising = gaps[gaps > rounding(ordered)]
    # Share of readings that others repeat from which the steps can be seen.
    if len(rising) < 2 or len(rising) > (1 - 0.05) * len(gaps):
        return None
    step = float(rising.min())
    multiples = np.round(rising / step)
    step = float(rising.sum() / multiples.sum())
    # Part of a step by which readings may miss it: those without steps miss by a quarter.
    return step if np.abs(rising / step - np.round(rising / step)).max() < 0.05 else None


def rounding(ordered: FloatArray) -> float:
    """Return by how much equal readings may differ: conversion of units rounds them."""
    return 8 * float(np.spacing(np.abs(ordered[[0, -1]]).max()))


CELLS = 2048
"""Cells of a histogram of values: a period of four of them or more is found."""

FEWEST_PERIODS = 2.5
"""Periods in the range of the values at least: fewer bands are no pattern."""


DIFFERENT = 100
"""Values that differ by a sixteenth of a period if no other sensor shows it: the poses of a turntable are fewer."""

COHERENT = 0.5
"""Least mean of the phases: values that fill half of each period have 2 / pi, those that fill all of it none."""

EMPTY = (0.45, 0.8)
"""Part of a period that is left out: half by one bit, three quarters by two adjacent bits."""

FILLED = 7
"""Of eight equal parts of the rest, that hold values: a pure lattice of steps has them in one."""


NEAR = 160
"""Values nearest to each other, in which short periods are looked for: the mean of their phases errs by 0.08."""


@dataclass(frozen=True)
class _Bands:
    """Where values lie: from the phase ``first`` on, in a part ``filled`` of each period, counted from an origin."""

    period_T: float
    origin_T: float
    first: float
    filled: float

    def place(self, values: FloatArray) -> FloatArray:
        """Return how far values (n,) lie behind the begin of their band, in periods."""
        return np.asarray(((values - self.origin_T) / self.period_T - self.first) % 1.0)


def with_stuck_bits(overview: Overview) -> Iterator[Fault]:
    """Yield the axes that leave out bands of values."""
    parts = [(column, part) for column, row in enumerate(overview.sorted_T) for part in _parts(row)]
    found = set()
    for (column, part), cycles in zip(parts, _cycles([part for _, part in parts]), strict=True):
        bands = None if cycles is None or column in found else _bands(part, cycles)
        if bands is not None and _is_of_converter(overview, column, part, bands):
            found.add(column)
            words = (
                f"leaves out every second band of {in_nanotesla(bands.period_T / 2)} throughout: "
                "a bit of its converter is stuck"
            )
            yield fault_of_axis("stuck_bits", column, words, overview.time_s)


def _parts(ordered: FloatArray) -> Iterator[FloatArray]:
    """Yield all values of increasing readings (n,), and those that lie nearest to each other."""
    values = ordered[np.append(True, np.diff(ordered) > rounding(ordered))]
    if len(values) >= DIFFERENT:
        yield values
    if len(values) >= 2 * NEAR:
        start = int(np.argmin(values[NEAR:] - values[:-NEAR]))
        yield values[start : start + NEAR]


def _cycles(parts: list[FloatArray]) -> list[float | None]:
    """Return how many periods at which the phases agree best fit into the range of each part; None: they do not agree.

    To half a period: with as many zeros behind, a histogram has two frequencies for each period.
    """
    histogram = np.empty((len(parts), CELLS))
    for row, values in zip(histogram, parts, strict=True):
        place = (values - values[0]) / (values[-1] - values[0]) * (CELLS - 1)
        row[:] = np.bincount((place + 0.5).astype(np.intp), minlength=CELLS) / len(values)
    coherence = np.abs(np.fft.rfft(histogram, 2 * CELLS, axis=1)[:, : CELLS // 2])
    coherence[:, : int(2 * FEWEST_PERIODS)] = 0
    best = coherence.argmax(axis=1)
    agree = coherence[range(len(parts)), best] >= COHERENT
    return [index / 2 * (CELLS - 1) / CELLS if is_one else None for index, is_one in zip(best, agree, strict=True)]


def _bands(values: FloatArray, cycles: float) -> _Bands | None:
    """Return the bands of increasing values (n,), of which a number fits into the range that is known to a half.

    Of the periods that may be meant it takes the one that leaves most out: where bands are few, unevenly filled ones
    agree best in their phases at another. None where they leave out too little, or fill no bands evenly.
    """
    span = float(values[-1] - values[0])
    near = cycles + np.linspace(-0.5, 0.5, 33)
    ordered = np.sort((values - values[0]) / span * near[:, None] % 1.0, axis=1)
    gaps = np.diff(ordered, axis=1, append=ordered[:, :1] + 1)
    period_T = span / float(near[gaps.max(axis=1).argmax()])
    ordered = np.sort((values - values[0]) / period_T % 1.0)  # to the last bit as ``place`` has it
    gaps = np.diff(ordered, append=ordered[0] + 1)
    widest = int(gaps.argmax())
    empty, first = float(gaps[widest]), float(ordered[(widest + 1) % len(ordered)])
    if not EMPTY[0] <= empty <= EMPTY[1]:
        return None
    bands = _Bands(period_T, float(values[0]), first, 1 - empty)
    parts = (8 * bands.place(values) / bands.filled).astype(int).clip(0, 7)
    return bands if len(np.unique(parts)) >= FILLED else None


def _is_mixed(overview: Overview, column: int, values: FloatArray, bands: _Bands) -> bool:
    """Whether the place of readings within their bands follows the sensor's other axes.

    A driver that multiplies coarse steps by a matrix widens each step by what it adds of the other axes.
    """
    first, readings = column - column % 3, overview.values_T
    # The period is known well enough among the values that showed it.
    readings = readings[:, (readings[column] >= values[0]) & (readings[column] <= values[-1])]
    own = np.delete(readings[first : first + 3], column - first, axis=0)
    place = bands.place(readings[column])
    # Noise leaves all of the variance within the bands, a matrix little.
    return bool(_unexplained(place, own / np.abs(own).max()).var() < 0.5 * place.var())


def _unexplained(values: FloatArray, causes: FloatArray) -> FloatArray:
    """Return what causes (p, n) and a constant leave of values (n,)."""
    design = np.column_stack([causes.T, np.ones(len(values))])
    return np.asarray(values - design @ np.linalg.lstsq(design, values, rcond=None)[0])


def _is_of_converter(overview: Overview, column: int, values: FloatArray, bands: _Bands) -> bool:
    """Whether bands are left out by a converter, and not by the motion, nor by a matrix behind the converter."""
    if _is_mixed(overview, column, values, bands):
        return False
    if overview.sensor_count == 1:
        different = 1 + int((np.diff((16 * (values - values[0]) / bands.period_T).astype(int)) > 0).sum())
        # The same if no other sensor shows that the motion leaves nothing out: fewer bands may be visited
        # attitudes.
        return different >= DIFFERENT and float(values[-1] - values[0]) > 16.0 * bands.period_T
    readings, first = overview.values_T, column - column % 3
    others = np.delete(readings, range(first, first + 3), axis=0)
    predicted = readings[column] - _unexplained(readings[column], others / np.abs(others).max())
    inside = (predicted > values[0]) & (predicted < values[-1])
    if not inside.any():
        return False
    moved_T, place = (readings[column] - predicted)[inside], bands.place(predicted[inside])
    # A bit moves half of the readings by half a period, and an offset takes half of that; other errors are smaller.
    return float(moved_T.std()) > bands.period_T / 8 and _part_of_place(moved_T, place) > 0.3


def _part_of_place(moved_T: FloatArray, place: FloatArray) -> float:
    """Return the part of the variance of how far readings are moved that their place in the period (n,) explains.

    A bit moves those at some places, which explains more than half; a jump of the bias moves those at any place.
    """
    part = (8 * place).astype(int).clip(0, 7)
    mean = np.bincount(part, moved_T, minlength=8) / np.maximum(np.bincount(part, minlength=8), 1)
    return float(np.var(mean[part]) / max(np.var(moved_T), np.finfo(float).tiny))
