"""Whether a change is abrupt: what comes and goes at some times, against smooth courses of the same.

What an effect adds while it is there, times cosines of half periods of the record, is any smooth course of it: a gain
or a bias that wanders. A staircase follows a wandering course as well as many courses of its spectrum do, but never as
well as a smooth one; and a real step beside a wandering course stands out among steps at all other times.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import log

import numpy as np

from tam_calibration.effects.effect import Shape, Term
from tam_calibration.effects.geomagnetic_drift import ORDERS
from tam_calibration.effects.grades import LONGEST_BURST, SLIGHT
from tam_calibration.effects.term import chosen
from tam_calibration.gap.regression import Base, twice_log_likelihood_ratio
from tam_calibration.gap.search import Hypothesis
from tam_calibration.gap.standing import Standing
from tam_calibration.gap.unknown import cosines
from tam_calibration.units import FloatArray

_TIMES = 64
"""At which other steps are set, evenly over the record."""

MOST_STEPS = 3
"""Times at which one sensor's bias or scale changes; what does more often is a loose part or contact, and no step."""

SHARPEST = 24.0
"""How many times what a step at another time gains each change must gain where the changes do not leave all else noise.

A magnet put at a sensor gains hundreds of times as much, an offset or a tail that comes and goes a few times.
"""


def standing_of_change(base: Base, form: Hypothesis, whole: Shape, delta_bic: float) -> tuple[Standing, bool]:
    """Return how the changes of a form stand among steps at other times, and whether a smooth course says more.

    That is where the evidence for smooth courses exceeds that for the form; the changes are then held beside the best
    of them.

    Parameters
    ----------
    base : Base
    form : Hypothesis
        Which comes and goes at the times of its shape.
    whole : Shape
        The shape in which it is always there.
    delta_bic : float
        The evidence for the form.
    """
    always = chosen(base.channels.terms(form.effect, whole), form.keys)
    changes = np.array([value for name, value in form.shape.items() if whole.get(name) != value])
    course = _best_course(base, form, always, changes, delta_bic)
    return _among_times(base, form, always, changes, course), bool(course)


def _best_course(base: Base, form: Hypothesis, always: Sequence[Term], changes: FloatArray, least: float) -> list[Term]:
    """Return the smooth course with the most evidence; nothing where a form, or levels of their own, have more.

    Parameters
    ----------
    base : Base
    form : Hypothesis
        Between its changes, if they are few, it may have any levels: that would be more of the same effect.
    always : sequence of Term
        Of the form, as if it were always there.
    changes : (C,) array
        Times of its changes.
    least : float
        The evidence for the form.
    """
    channels, count, width = base.channels, base.channels.count, form.width
    time_s = channels.situation.time_s[:: channels.stride]
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


def _among_times(
    base: Base, form: Hypothesis, always: Sequence[Term], changes: FloatArray, course: Sequence[Term]
) -> Standing:
    """Return how each change of a form stands beside a smooth course among steps at all other times beside both.

    With few changes, the next strongest are no such steps but more of them.
    """
    channels = base.channels
    time_s = channels.situation.time_s[:: channels.stride]
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
    return Standing.among(
        twice_log_likelihood_ratio(smooth.energy, gain, channels.count),
        twice_log_likelihood_ratio(smooth.energy, count * others, channels.count),
    )


def _times(terms: Sequence[Term], courses: FloatArray) -> list[Term]:
    """Return terms times each of some courses (N, C), course by course."""
    return [replace(term, features=term.features * course[:, None]) for course in courses.T for term in terms]
