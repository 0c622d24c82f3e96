"""The values that an axis takes: an end of its range, or coarse steps."""

from collections.abc import Iterator

import numpy as np

from tam_calibration.integrity.fault import Fault, Severity, between, channel, in_nanotesla
from tam_calibration.integrity.overview import Overview
from tam_calibration.model.array import Array
from tam_calibration.model.units import FloatArray

FEWEST_AT_END = 6
"""Samples at the end of a range that are no coincidence."""

END_RATIO = 5.0
"""Of samples at the end to those one step further in: where a sine turns, coarse steps make 2.4."""

STEPS_OF_RANGE = 20.0
"""Steps in the range of an axis at least, before one value is its end: a few steps may fill unevenly."""

MANY_AT_END = 0.01
"""Share of the samples at an end that spoils a fit: a sphere is cut off by 2 % of the field, and scale errs by 1e-3."""

COARSE = 10.0
"""Of the error of rounding to the stated noise: standard errors are told ten times too small."""

REPEATING = 0.05
"""Share of readings that others repeat from which the steps can be seen."""

OFF_STEP = 0.05
"""Part of a step by which readings may miss it: those without steps miss by a quarter."""


def at_ends(overview: Overview) -> Iterator[Fault]:
    """Yield the axes that stay at an end of their range, each with the share of the samples there."""
    values, ordered = overview.values_T, overview.sorted_T
    count = values.shape[1]
    for column, row in enumerate(ordered):
        if count <= 2 * FEWEST_AT_END:
            return
        for name, outward in (("largest", row[::-1]), ("smallest", row)):
            end = outward[0]
            if outward[FEWEST_AT_END - 1] != end:
                continue
            inner = outward[outward != end]
            if not len(inner) or STEPS_OF_RANGE * abs(end - inner[0]) > abs(end - inner[-1]):
                continue
            there = values[column] == end
            own = 3 * (column // 3)
            different = len(np.unique(values[own : own + 3, there], axis=1).T)
            if different >= max(FEWEST_AT_END, END_RATIO * int((inner == inner[0]).sum())):
                yield _at_end(overview, column, name, float(end), there)


def _at_end(overview: Overview, column: int, name: str, end_T: float, there: np.ndarray) -> Fault:
    sensor, axis, share = column // 3 + 1, "xyz"[column % 3], float(there.mean())
    time_s = overview.recording.time_s[there]
    span = float(time_s[0]), float(time_s[-1])
    sentence = (
        f"{channel(sensor, axis)} stays at its {name} reading, {in_nanotesla(end_T)}, in {share:.2g} of the samples "
        f"{between(span)}: it is saturated"
    )
    severity: Severity = "refusal" if share >= MANY_AT_END else "warning"
    return Fault("saturated", sensor, axis, span, sentence, severity, may_be_effect=True)


def in_steps(overview: Overview, array: Array) -> Iterator[Fault]:
    """Yield the axes whose readings have steps that are coarse beside the stated noise."""
    if array.vector_noise_T is None:
        return
    for column, row in enumerate(overview.sorted_T):
        noise = float(array.vector_noise_T[column // 3])
        step = _step(row)
        if step is not None and step / np.sqrt(12) > COARSE * noise:
            sensor, axis = column // 3 + 1, "xyz"[column % 3]
            sentence = (
                f"{channel(sensor, axis)} reads in steps of {in_nanotesla(step)} {between(overview.time_s)}, "
                f"{step / np.sqrt(12) / noise:.3g} times the stated noise: state the noise of these readings, or leave "
                "it out"
            )
            yield Fault("quantised", sensor, axis, overview.time_s, sentence, may_be_effect=True)


def _step(ordered: FloatArray) -> float | None:
    """Return the step of readings (n,) in increasing order, None where there is none to be seen."""
    gaps = np.diff(ordered)
    rising = gaps[gaps > rounding(ordered)]
    if len(rising) < 2 or len(rising) > (1 - REPEATING) * len(gaps):
        return None
    step = float(rising.min())
    multiples = np.round(rising / step)
    step = float(rising.sum() / multiples.sum())
    return step if np.abs(rising / step - np.round(rising / step)).max() < OFF_STEP else None


def rounding(ordered: FloatArray) -> float:
    """Return by how much equal readings may differ: conversion of units rounds them."""
    return 8 * float(np.spacing(np.abs(ordered[[0, -1]]).max()))
