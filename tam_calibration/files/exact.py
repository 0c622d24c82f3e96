"""Decimal values for files that read back as the very numbers that were written, where the unit allows."""

from collections.abc import Callable

import numpy as np

from tam_calibration.units import FloatArray, from_degrees, from_nanotesla, to_degrees, to_nanotesla


def nanotesla_to_write(tesla: FloatArray) -> FloatArray:
    """Return nanotesla that `units.from_nanotesla` turns back into the same tesla, to the last bit where it can be."""
    return _invert(tesla, to_nanotesla, from_nanotesla)


def degrees_to_write(radians: FloatArray) -> FloatArray:
    """Return degrees that `units.from_degrees` turns back into the same radians, to the last bit where it can be."""
    return _invert(radians, to_degrees, from_degrees)


def _invert(
    values: FloatArray, forward: Callable[[FloatArray], FloatArray], backward: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    best = forward(np.asarray(values, dtype=float))
    for candidate in (np.nextafter(best, -np.inf), np.nextafter(best, np.inf)):
        mends = (backward(best) != values) & (backward(candidate) == values)
        best = np.where(mends, candidate, best)
    return best
