"""Rivals of the library's effects that assume no physics: smooth functions of time, of direction, of the field's rate.

When one of them explains a residual that no effect explains, the cause is none of the library, and the rows in which
it stands say where to look.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.effect import Coefficient, LinearEffect, Misfit, Shape, Situation, Term
from tam_calibration.effects.geomagnetic_drift import ORDERS
from tam_calibration.effects.grades import LONGEST_BURST
from tam_calibration.effects.harmonics import harmonics
from tam_calibration.effects.neighbours import sum_around
from tam_calibration.effects.orientation import upwards
from tam_calibration.units import FloatArray

_HIGHEST_TILT = 3
"""Degree of the harmonics of the direction upwards: of a bend or a loose part under its weight one or two matter."""


class FunctionOfTime(LinearEffect):
    """Each row shifts by a smooth function of time."""

    name = "function_of_time"
    title = "a shift that changes with time"
    physics = "No physics: cosines of half periods of the record."
    excitation = "none"
    is_free_in_time = True
    is_of_site = True

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return cosines in bands of growing order, for each sensor's axes."""
        terms = []
        for first, last in ORDERS:
            if last * LONGEST_BURST > situation.sample_count:
                break
            orders = np.arange(first, last + 1)
            features = cosines(situation.time_s, orders)
            coefficients = [Coefficient(f"cosine {order}", "T") for order in orders]
            terms += [
                Term.of_row(situation, row, f"order {first} to {last}", coefficients, features)
                for row in range(situation.scalar_row + 1)
            ]
        return terms


class FunctionOfDirection(LinearEffect):
    """Each row shifts by a smooth function of the direction of the field in the array frame."""

    name = "function_of_direction"
    title = "a shift that changes with the attitude"
    physics = "No physics: polynomials of the direction of the field beyond those that the calibration holds."
    excitation = "none"

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return polynomials of degree 2, 3 and 4 for each axis."""
        x, y, z = (situation.field_T / situation.intensity_T[:, None]).T
        functions = {
            "degree 2": (x * y, x * z, y * z, x * x - y * y, 3 * z * z - 1),
            "degree 3": (x * y * z, z * (x * x - y * y), x * (x * x - 3 * y * y), y * (3 * x * x - y * y),
                         x * (5 * z * z - 1), y * (5 * z * z - 1), z * (5 * z * z - 3)),
            "degree 4": (x * y * (x * x - y * y), y * z * (3 * x * x - y * y), x * y * (7 * z * z - 1),
                         y * z * (7 * z * z - 3), 35 * z**4 - 30 * z * z + 3, x * z * (7 * z * z - 3),
                         (x * x - y * y) * (7 * z * z - 1), x * z * (x * x - 3 * y * y),
                         x * x * (x * x - 3 * y * y) - y * y * (3 * x * x - y * y)),
        }  # fmt: skip
        features = {degree: np.column_stack(of_degree) for degree, of_degree in functions.items()}
        return [
            Term.of_row(situation, row, degree, _numbered(own.shape[1]), own)
            for degree, own in features.items()
            for row in range(situation.scalar_row + (degree != "degree 2"))
        ]


class FunctionOfTilt(LinearEffect):
    """Each row shifts by a smooth function of the direction upwards in the array frame."""

    name = "function_of_tilt"
    title = "a shift that changes with the tilt"
    physics = "No physics: spherical harmonics of the direction upwards."
    excitation = "none"
    channels = ("attitude",)

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return spherical harmonics of degree 1, 2 and 3 for each axis."""
        functions = harmonics(upwards(situation), _HIGHEST_TILT)
        return [
            Term.of_row(
                situation,
                row,
                f"degree {degree}",
                _numbered(2 * degree + 1),
                functions[:, degree**2 : (degree + 1) ** 2],
            )
            for degree in range(1, _HIGHEST_TILT + 1)
            for row in range(situation.scalar_row + 1)
        ]


class FunctionOfRate(LinearEffect):
    """Each row follows the field's change from sample to sample."""

    name = "function_of_rate"
    title = "a shift that changes with the rate of the field"
    physics = "No physics: differences of the field to the samples before and after."
    excitation = "none"

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return the field's difference and second difference for each axis."""
        before = np.concatenate([situation.field_T[:1], situation.field_T[:-1]])
        after = np.concatenate([situation.field_T[1:], situation.field_T[-1:]])
        return [
            Term.of_row(situation, row, name, _numbered(3), features)
            for name, features in (("change", after - before), ("bend", after + before))
            for row in range(situation.scalar_row)
        ]


class FunctionOfNeighbours(LinearEffect):
    """Each row shifts by what the samples around it are shifted by: whatever is slower than the sampling."""

    name = "function_of_neighbours"
    title = "a shift that neighbouring samples share"
    physics = "No physics: means of the residual over neighbouring samples, the sample itself left out."
    excitation = "none"
    is_free_in_time = True

    def __init__(self) -> None:
        self._shift: FloatArray = np.empty((0, 0))

    def shapes(self, situation: Situation, misfit: Misfit) -> Iterable[Shape]:
        """Return spans of samples."""
        self._shift = np.where(misfit.is_counted[:, None], misfit.row_shift_T, 0.0)
        return [{"samples": float(span)} for span in (1, 4, 16, 64) if 8 * span <= situation.sample_count]

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return the mean of the neighbours' shifts for each row."""
        span = int(shape["samples"])
        mean = sum_around(self._shift, span) / (2 * span)
        return [
            Term.of_row(situation, row, "shift", [Coefficient("shift", "1")], mean[:, [row]])
            for row in range(mean.shape[1])
            # What the calibration took off a row turns its neighbours against it: that is no shift they share.
            if mean[:, row] @ self._shift[:, row] > 0
        ]


def cosines(time_s: FloatArray, orders: NDArray[np.integer[Any]]) -> FloatArray:
    """Return the cosines (N, C) of whole numbers (C,) of half periods of a record."""
    phase = np.pi * (time_s - time_s[0]) / max(float(np.ptp(time_s)), np.finfo(float).tiny)
    values: FloatArray = np.cos(phase[:, None] * orders)
    return values


def _numbered(count: int) -> list[Coefficient]:
    return [Coefficient(str(number + 1), "T") for number in range(count)]
