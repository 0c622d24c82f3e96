"""The sensors in which a law is: they share its course, and each has coefficients of its own."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tam_calibration.effects.grades import MOST, NEGLIGIBLE
from tam_calibration.gap.laws.candidates import held
from tam_calibration.gap.laws.decisions import LEAST_EVIDENCE, TIE
from tam_calibration.gap.laws.evidence import Bins
from tam_calibration.gap.laws.law import SCALAR, Place
from tam_calibration.gap.laws.patterns import Candidate, Pattern, in_every_sensor, in_sensor, sensor_rows
from tam_calibration.gap.laws.states import steps
from tam_calibration.gap.laws.whitened import Residual

_Fitted = Callable[[Sequence[int]], Candidate]
"""A law in some sensors, numbers from 1 in order, fitted together."""


def in_its_sensors(residual: Residual, law: Candidate) -> Candidate:
    """Return a law in all sensors in which it is, fitted together; itself where these are those in which it was found.

    Parameters
    ----------
    residual : Residual
    law : Candidate
        Of one sensor or several. One of the scalar, or of a field that all sensors feel, stays as it is.
    """
    of = _fitted(residual, law)
    if of is None:
        return law
    all_of_them = range(1, residual.sensor_count + 1)
    if len(law.pattern.sensors) > 1:
        best = _in_fewer(residual, of(all_of_them), of)
    else:
        best = _in_more(residual, of([int(law.pattern.sensors[0])]), of)
    if 1 < len(best.pattern.sensors) == residual.sensor_count - 1:
        # Only differences between sensors are seen: what all have, all but one can have as well.
        best = of(all_of_them)
    return law if best.pattern.sensors == law.pattern.sensors else best


def as_good_elsewhere(residual: Residual, law: Candidate, sensors: Place) -> tuple[Place, ...]:
    """Return the other half of the sensors, if a law explains as much there: only differences of sensors are seen.

    Parameters
    ----------
    residual : Residual
    law : Candidate
        As ``in_its_sensors`` takes it.
    sensors : Place
        In which it is.
    """
    others = tuple(one for one in range(1, residual.sensor_count + 1) if one not in sensors)
    of = _fitted(residual, law) if len(others) == len(sensors) else None
    if of is None or of(others).evidence < of([int(one) for one in sensors]).evidence - TIE:
        return ()
    return (others,)


def _fitted(residual: Residual, law: Candidate) -> _Fitted | None:
    """Return how a law is fitted in some sensors; None for one of the scalar, or of a field that all sensors feel."""
    every = None if law.pattern.sensors == SCALAR else in_every_sensor(residual, law)
    if every is None or residual.sensor_count == 1:
        return None
    normal, width = every.normal(residual), every.width // residual.sensor_count

    def of(sensors: Sequence[int]) -> Candidate:
        columns = np.concatenate([np.arange(width * (one - 1), width * one) for one in sensors])
        return Candidate(_in(every, sensors), law.course, normal.part(columns).fit().evidence)

    return of


def _in_fewer(residual: Residual, best: Candidate, of: _Fitted) -> Candidate:
    """Return a law without the sensors that do not count."""
    while len(sensors := _sensors_of(best)) > 1:
        fewer = {one: of([other for other in sensors if other != one]) for one in sensors}
        left = max(sensors, key=lambda one: fewer[one].evidence)
        if _counts(residual, fewer[left], best, left, TIE):
            break
        best = fewer[left]
    return best


def _in_more(residual: Residual, best: Candidate, of: _Fitted) -> Candidate:
    """Return a law with the sensors that count, and in which it explains most of what is left."""
    every_sensor = range(1, residual.sensor_count + 1)
    while others := [one for one in every_sensor if one not in _sensors_of(best)]:
        more = {one: of(sorted([*_sensors_of(best), one])) for one in others}
        added = max(others, key=lambda one: more[one].evidence)
        if not _counts(residual, best, more[added], added, LEAST_EVIDENCE):
            break
        left = held(residual.without(best.signal(residual, residual)), added)
        if 2 * (more[added].evidence - best.evidence) < MOST * left:
            break
        best = more[added]
    return best


def _counts(residual: Residual, fewer: Candidate, more: Candidate, sensor: int, least: float) -> bool:
    """Say whether one more sensor has the least evidence, more than what errors of a law elsewhere leave or a step."""
    gain, each = more.evidence - fewer.evidence, more.evidence / len(more.pattern.sensors)
    if gain <= max(least, NEGLIGIBLE * each):
        return False
    rest, bins = residual.without(fewer.signal(residual, residual)), Bins.of_time(residual.time_s)
    own = [one for one in in_sensor(residual, sensor) if one.law == more.pattern.law]
    return all(next(steps(one, one.sums(rest, bins), bins)).evidence <= gain + TIE for one in own)


def _sensors_of(law: Candidate) -> list[int]:
    return [int(one) for one in law.pattern.sensors]


def _in(every: Pattern, sensors: Sequence[int]) -> Pattern:
    """Return a pattern of all sensors in some of them."""
    rows = np.concatenate([sensor_rows(one) for one in sensors])
    return replace(every, sensors=tuple(sensors), rows=rows, shifts=every.by_row[:, rows])
