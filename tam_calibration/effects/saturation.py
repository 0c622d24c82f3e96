"""Saturation: an axis that cannot read beyond a limit.

The converter or the amplifier of a sensor has a range; what lies beyond it is read as its end. Readings then repeat
at the largest or smallest value, where the other sensors say that the axis should have read more. Source: IEEE Std
1241-2010, Standard for Terminology and Test Methods for Analog-to-Digital Converters, on overload.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tam_calibration.core.noise import noise_deviation
from tam_calibration.effects.effect import Contribution, Covariates, Finding, FoundEffect
from tam_calibration.effects.grades import CERTAIN, FEWEST, NOTABLE
from tam_calibration.effects.residuals import WhitenedResiduals
from tam_calibration.model.units import FloatArray

_ENDS = {"upper limit": 1.0, "lower limit": -1.0}
"""Signs that turn either end of a range into an upper one."""


@dataclass(frozen=True, eq=False)
class _Limit:
    row: int
    end: str
    value_T: float
    standard_error_T: float
    samples: NDArray[np.intp]


class Saturation(FoundEffect):
    """An axis that reads the end of its range where the field lies beyond."""

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the limits, and as flagged the samples at them, or why there is none."""
        limits = find_limits(residuals)
        if not limits:
            return "no axis stays at its largest or smallest reading where the others say that it should read more"
        flagged = np.zeros(len(residuals.energy), dtype=bool)
        flagged[np.concatenate([limit.samples for limit in limits])] = True
        saved = sum(float(np.sum(residuals.row_deviations[one.samples, one.row] ** 2 - 1)) for one in limits)
        return self.of_samples(_contributions(limits), residuals, flagged, saved, 2 * len(limits))

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        return np.clip(rows_T, part.values.get("lower limit", -np.inf), part.values.get("upper limit", np.inf))


def find_limits(residuals: WhitenedResiduals) -> list[_Limit]:
    """Return the limits at which axes stay, at the upper and the lower end."""
    readings = residuals.recording.readings_T.reshape(len(residuals.energy), -1)
    told = [_limit_of(residuals, row, end, own) for row, own in enumerate(readings.T) for end in _ENDS]
    return [limit for limit in told if limit is not None]


def _limit_of(residuals: WhitenedResiduals, row: int, end: str, reading: FloatArray) -> _Limit | None:
    """Return the limit at one end of a row: where readings repeat, or where they pile up within their noise."""
    sign, information = _ENDS[end], residuals.row_information[:, row]
    if not (information > 0).any():
        return None
    noise = 1 / np.sqrt(float(np.mean(information[information > 0])))
    outward = sign * reading
    top = float(outward.max())
    at_limit = np.flatnonzero(outward == top)
    inner = outward[outward < top]
    # On a coarse lattice of readings the next step down holds about as many.
    next_count = int(np.sum(inner == inner.max())) if len(inner) else 0
    is_repeated = len(at_limit) > 3 * (next_count - 1)
    if len(at_limit) == 1 or not is_repeated:
        piled = _pile(outward, sign * residuals.row_shift_T[:, row], noise)
        at_limit = piled if len(piled) or not is_repeated else at_limit
    if len(at_limit) < 2:
        return None
    deviations = residuals.row_deviations[:, row]
    excess = -sign * np.sum(deviations[at_limit]) / (CERTAIN * np.sqrt(len(at_limit)))
    if not excess > max(1.0, float(noise_deviation(deviations))):
        return None
    spread = float(np.std(outward[at_limit]))
    return _Limit(row, end, sign * float(np.mean(outward[at_limit])), spread / np.sqrt(len(at_limit)), at_limit)


def _pile(outward: FloatArray, shift: FloatArray, noise: float) -> NDArray[np.intp]:
    """Return the readings that stay within their noise of one value although they should differ, none if so."""
    expected = outward - shift
    order = np.argsort(expected)[::-1]
    count = np.arange(1, len(order) + 1)
    depth = outward[order] - outward.max()
    scatter = np.cumsum(depth**2) / count - (np.cumsum(depth) / count) ** 2
    lost = np.cumsum(shift[order] ** 2)
    # Energy explained by a constant instead of the expected reading, for the k largest expected readings.
    best = int(np.argmax(lost - count * np.maximum(scatter, 0)))
    chosen = order[: best + 1]
    if len(chosen) < FEWEST:
        return chosen[:0]
    should, did = expected[chosen] - expected[chosen].mean(), outward[chosen] - outward[chosen].mean()
    is_flat = should @ should > len(chosen) * (3 * noise) ** 2 and abs(should @ did) < NOTABLE * (should @ should)
    return chosen if is_flat and np.std(did) < 2 * noise else chosen[:0]


def _contributions(limits: list[_Limit]) -> Iterator[Contribution]:
    for row, of_row in groupby(limits, key=lambda limit: limit.row):
        ends = {limit.end: (limit.value_T, limit.standard_error_T) for limit in of_row}
        values, errors = ({end: both[index] for end, both in ends.items()} for index in (0, 1))
        sensor, axis = divmod(row, 3)
        yield Contribution(sensor, axis, "limit", values, errors)
