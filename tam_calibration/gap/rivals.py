"""Rivals of the library's effects: functions without physics; and a test whether a change is abrupt or smooth."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.harmonics import harmonics
from tam_calibration.effects.covariates import Covariates, upwards
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.geomagnetic_drift import ORDERS
from tam_calibration.effects.grades import LONGEST_BURST, SLIGHT
from tam_calibration.effects.motion import sum_around
from tam_calibration.effects.term import Coefficient, Term, WhitenedResiduals, chosen
from tam_calibration.gap.hypothesis import Hypothesis
from tam_calibration.gap.regression import Base, twice_log_likelihood_ratio
from tam_calibration.gap.surrogates import SurrogateTest
from tam_calibration.model.fitted_effect import Shape
from tam_calibration.model.units import FloatArray

_HIGHEST_TILT = 3
"""Degree of the harmonics of the direction upwards: a bend or a loose part under its weight has degree one or two."""


class FunctionOfTime(LinearEffect):
    """Each row shifts by a smooth function of time."""

    name = "function_of_time"
    is_free_in_time = True
    is_of_site = True

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return cosines in bands of growing order, for each sensor's axes.

        Parameters
        ----------
        covariates : Covariates
            Time stamps of N samples, and the number of sensors.
        shape : Shape
            Not used: there are no parameters.
        """
        terms = []
        for first, last in ORDERS:
            if last * LONGEST_BURST > covariates.sample_count:
                break
            orders = np.arange(first, last + 1)
            features = cosines(covariates.time_s, orders)
            coefficients = [Coefficient(f"cosine {order}", "T") for order in orders]
            terms += [
                Term.of_row(covariates, row, f"order {first} to {last}", coefficients, features)
                for row in range(covariates.scalar_row + 1)
            ]
        return terms


class FunctionOfDirection(LinearEffect):
    """Each row shifts by a smooth function of the direction of the field in the array frame."""

    name = "function_of_direction"

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return polynomials of degree 2, 3 and 4 for each axis.

        Parameters
        ----------
        covariates : Covariates
            Field of N samples in the array frame, tesla.
        shape : Shape
            Not used: there are no parameters.
        """
        x, y, z = (covariates.field_T / covariates.intensity_T[:, None]).T
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
            Term.of_row(covariates, row, degree, _numbered(own.shape[1]), own)
            for degree, own in features.items()
            for row in range(covariates.scalar_row + (degree != "degree 2"))
        ]


class FunctionOfTilt(LinearEffect):
    """Each row shifts by a smooth function of the direction upwards in the array frame."""

    name = "function_of_tilt"
    channels = ("attitude",)

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return spherical harmonics of degree 1, 2 and 3 for each axis.

        Parameters
        ----------
        covariates : Covariates
            With the attitude of N samples.
        shape : Shape
            Not used: there are no parameters.
        """
        functions = harmonics(upwards(covariates), _HIGHEST_TILT)
        return [
            Term.of_row(
                covariates,
                row,
                f"degree {degree}",
                _numbered(2 * degree + 1),
                functions[:, degree**2 : (degree + 1) ** 2],
            )
            for degree in range(1, _HIGHEST_TILT + 1)
            for row in range(covariates.scalar_row + 1)
        ]


class FunctionOfRate(LinearEffect):
    """Each row follows the field's change from sample to sample."""

    name = "function_of_rate"

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return the field's difference and second difference for each axis.

        Parameters
        ----------
        covariates : Covariates
            Field of N samples in the array frame, tesla.
        shape : Shape
            Not used: there are no parameters.
        """
        before = np.concatenate([covariates.field_T[:1], covariates.field_T[:-1]])
        after = np.concatenate([covariates.field_T[1:], covariates.field_T[-1:]])
        return [
            Term.of_row(covariates, row, name, _numbered(3), features)
            for name, features in (("change", after - before), ("bend", after + before))
            for row in range(covariates.scalar_row)
        ]


class FunctionOfNeighbours(LinearEffect):
    """Each row shifts by what the samples around it are shifted by: whatever is slower than the sampling."""

    name = "function_of_neighbours"
    is_free_in_time = True

    def __init__(self) -> None:
        self._shift: FloatArray = np.empty((0, 0))

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return spans of samples.

        Parameters
        ----------
        covariates : Covariates
            Of N samples; a span has an eighth of them at most.
        residuals : WhitenedResiduals
            Their shifts of the rows are kept for ``terms``.
        """
        self._shift = np.where(residuals.is_counted[:, None], residuals.row_shift_T, 0.0)
        # Interpolation alone makes the noise of the next sample alike.
        spans = (1, 4, 16, 64) if residuals.recording.interpolated_noise is None else (4, 16, 64)
        return [{"samples": float(span)} for span in spans if 8 * span <= covariates.sample_count]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return the mean of the neighbours' shifts for each row.

        Parameters
        ----------
        covariates : Covariates
            Of the samples of the residuals that ``shapes`` was given.
        shape : Shape
            ``samples`` is the number of neighbours on either side over which the mean is taken.
        """
        span = int(shape["samples"])
        mean = sum_around(self._shift, span) / (2 * span)
        return [
            Term.of_row(covariates, row, "shift", [Coefficient("shift", "1")], mean[:, [row]])
            for row in range(mean.shape[1])
            # Where the calibration absorbs a part of a row, neighbours are anticorrelated: that is no common shift.
            if mean[:, row] @ self._shift[:, row] > 0
        ]


def cosines(time_s: FloatArray, orders: NDArray[np.integer[Any]]) -> FloatArray:
    """Return the cosines (N, C) of whole numbers (C,) of half periods of a record.

    Parameters
    ----------
    time_s : (N,) array
        Time stamps, seconds.
    orders : (C,) array of int
        Number of half periods between the first sample and the last.
    """
    phase = np.pi * (time_s - time_s[0]) / max(float(np.ptp(time_s)), np.finfo(float).tiny)
    return np.asarray(np.cos(phase[:, None] * orders))


def _numbered(count: int) -> list[Coefficient]:
    return [Coefficient(str(number + 1), "T") for number in range(count)]


_TIMES = 64
"""Times of surrogate steps, evenly over the record."""

MOST_STEPS = 3
"""Steps of one sensor's bias or scale, at most; what changes more often is a loose part or contact."""

SHARPEST = 24.0
"""Least ratio of a change's gain to that of the best step at another time, where more than noise remains.

A magnet put at a sensor has a ratio of hundreds, an offset or a tail that comes and goes one of a few.
"""


def surrogate_test_of_change(
    base: Base, form: Hypothesis, permanent: Shape, delta_bic: float
) -> tuple[SurrogateTest, bool]:
    """Return the test of a form's changes against steps at other times, and whether a smooth course is likelier.

    It is where a smooth course has more evidence than the form; the changes are then tested beside the best of them.

    Parameters
    ----------
    base : Base
    form : Hypothesis
        An effect that begins and ends at the times of its shape.
    permanent : Shape
        The shape in which it is always present.
    delta_bic : float
        The evidence for the form.
    """
    always = chosen(base.channels.terms(form.effect, permanent), form.keys)
    changes = np.array([value for name, value in form.shape.items() if permanent.get(name) != value])
    course = _best_course(base, form, always, changes, delta_bic)
    return _among_other_times(base, form, always, changes, course), bool(course)


def _best_course(base: Base, form: Hypothesis, always: Sequence[Term], changes: FloatArray, least: float) -> list[Term]:
    """Return the smooth course with the most evidence; empty where the form, or free levels between changes, have more.

    Parameters
    ----------
    base : Base
    form : Hypothesis
        Where its changes are few, it may take any level between them: that is still the same effect.
    always : sequence of Term
        Of the form, as if it were always present.
    changes : (C,) array
        Times of its changes.
    least : float
        The evidence for the form.
    """
    channels, count, width = base.channels, base.channels.count, form.width
    time_s = channels.covariates.time_s[:: channels.stride]
    orders = [last for _, last in ORDERS if last * LONGEST_BURST <= len(time_s)]
    if not orders:
        return []
    courses = _times(always, cosines(time_s, np.arange(1, orders[-1] + 1)))

    def evidence(gain: float, rank: int) -> float:
        return float(twice_log_likelihood_ratio(base.energy, gain, count) - rank * log(count))

    if len(changes) <= MOST_STEPS:
        levels = _times(always, (time_s[:, None] >= changes).astype(float))
        least = max(least, evidence(*base.project(channels.design(levels)).gain()) - len(changes) * log(count))
    projected, best = base.project(channels.design(courses)), 0
    for order in orders:
        smooth = evidence(*projected.take(np.arange(order * width)).gain())
        if smooth > least:
            best, least = order, smooth
    return courses[: best * len(always)]


def _among_other_times(
    base: Base, form: Hypothesis, always: Sequence[Term], changes: FloatArray, course: Sequence[Term]
) -> SurrogateTest:
    """Return the test of a form's changes, beside a smooth course, against steps at all other times.

    Where a form has few changes, the strongest other steps count as further changes of it, not as surrogates.
    """
    channels = base.channels
    time_s = channels.covariates.time_s[:: channels.stride]
    count = len(changes)
    smooth = base.beside(channels.design(course)) if course else base
    own = channels.design(form.terms)
    both = smooth.beside(own)
    gain = smooth.project(own).gain()[0]
    times: FloatArray = np.linspace(time_s[0], time_s[-1], _TIMES + 2)[1:-1]
    steps = channels.design(_times(always, (time_s[:, None] >= times).astype(float)))
    each = steps.split(len(times))
    while True:
        is_other = np.abs(times[:, None] - changes).min(axis=1) > SLIGHT * np.ptp(time_s)
        others: FloatArray = both.gains_apart(each, steps)[is_other]
        if not len(others) or len(changes) >= MOST_STEPS:
            break
        best = int(np.flatnonzero(is_other)[np.argmax(others)])
        both = both.beside(each[best])
        changes = np.append(changes, times[best])
    return SurrogateTest.among(
        twice_log_likelihood_ratio(smooth.energy, gain, channels.count),
        twice_log_likelihood_ratio(smooth.energy, count * others, channels.count),
    )


def _times(terms: Sequence[Term], courses: FloatArray) -> list[Term]:
    """Return terms times each of some courses (N, C), course by course."""
    return [replace(term, features=term.features * course[:, None]) for course in courses.T for term in terms]
