"""The verdict on a gap, and the sentence that says it."""

import numpy as np

from tam_calibration.effects.effect import ALL, Finding
from tam_calibration.effects.excess_variance import Excess, Moments, best_excess
from tam_calibration.gap.hypotheses import Evidence
from tam_calibration.gap.looking import CLEAN
from tam_calibration.gap.model import Model
from tam_calibration.gap.result import Cause, Size, Verdict, Where
from tam_calibration.gap.search import Hypothesis, places_of
from tam_calibration.gap.size import LARGEST_NOISE
from tam_calibration.gap.standing import LEAST_EVIDENCE, OUTLIERS, open_part, sensors_of
from tam_calibration.gap.steps import Search
from tam_calibration.gap.unknown import FunctionOfDirection, FunctionOfRate, FunctionOfTilt
from tam_calibration.gap.where import main_places

SMALLEST_GAP = 0.1
"""In noise floors; what is smaller is no gap, however certain."""

_PARTLY_CLOSED = 0.6

_OPEN, _OPEN_BY_OUTLIERS = 0.065, 0.02
"""Part of a gap that a true cause leaves open in its own sensors at most, where it is the only one."""

_OF_MOTION = {FunctionOfDirection.name, FunctionOfTilt.name, FunctionOfRate.name}
"""What noise and spikes do not follow."""

_LEFT, _LEFT_BY_MANY, _MANY = 0.18, 0.12, 3
"""Part of a gap's amplitude that several leave out of sample, and that many do, for these together imitate much."""


def noisier_rows(nominal: Model) -> Excess | None:
    """Return the excess of variance of some rows over the others, whatever makes it."""
    channels = nominal.channels()
    excess = best_excess(Moments.of(channels.misfit), channels.situation)
    if excess is None or excess.gain - excess.parameter_count * np.log(channels.count) < LEAST_EVIDENCE:
        return None
    return excess


def verdict_on(found: Search, size: Size, variance: float, is_noisier: bool) -> Verdict:
    """Return the verdict on a search; some rows may be noisier than the others without a cause for it."""
    if size.before < SMALLEST_GAP:
        return "no_gap"
    left = open_part(found.nominal.base(), found.model.base(), found.remaining)
    if not found.steps:
        is_even = _strongest(found) is None and variance < LARGEST_NOISE**2 and not is_noisier
        return "no_gap" if is_even else "unexplained"
    if len(found.steps) == 1:
        is_much = left > _OPEN or _is_more_than_chance(found.steps[0].accepted, found, left)
    else:
        is_much = size.closed < 1 - _most_left(found) ** 2
    if size.closed < _PARTLY_CLOSED or (is_much and _is_at_home(found)):
        return "unexplained"
    return "explained" if size.closed >= 1 - CLEAN or left < CLEAN else "partly_explained"


def _is_more_than_chance(cause: Evidence, found: Search, left: float) -> bool:
    """Whether noise or outliers leave more than chance does: what follows the motion, or more than a trifle."""
    if not isinstance(cause.form, Finding) or cause.is_certain:
        return False
    strongest = _strongest(found)
    follows = strongest is not None and strongest.effect in _OF_MOTION
    return follows or (cause.effect == OUTLIERS and left > _OPEN_BY_OUTLIERS)


def _most_left(found: Search) -> float:
    """Return the part of a gap's amplitude that several true causes leave at most; jumps, being sharp, less."""
    forms = [step.accepted.form for step in found.steps]
    is_exact = all(isinstance(form, Hypothesis) and form.effect.has_exact_shapes for form in forms)
    return _LEFT_BY_MANY if is_exact or len(forms) >= _MANY else _LEFT


def _is_at_home(found: Search) -> bool:
    """Whether what causes visibly leave is in their own sensors: if it is much, they stand in for something else."""
    strongest = _strongest(found)
    if strongest is None:
        return False
    own = {sensor for step in found.steps for sensor in sensors_of(places_of(step.accepted.form))}
    return ALL in own or sensors_of(main_places(found.model.base(), strongest)) <= own


def _strongest(found: Search) -> Evidence | None:
    """Return the function without physics that says most of what causes leave, where it says anything."""
    seen = [one for one in found.remaining if one.delta_bic >= LEAST_EVIDENCE]
    return max(seen, key=lambda one: one.delta_bic, default=None)


def statement(verdict: Verdict, size: Size, where: Where, causes: tuple[Cause, ...]) -> str:
    """Return the verdict in one sentence."""
    if verdict == "no_gap":
        return "No gap: what the calibration leaves is noise."
    told = f"A gap of {size.before:.2g} times the noise floor in {_named(where)}"
    if verdict == "unexplained":
        return f"{told} that no effect of the library explains."
    names = " and ".join(dict.fromkeys(cause.fitted.effect.replace("_", " ") for cause in causes))
    part = "explained" if verdict == "explained" else "partly explained"
    return f"{told}, {part} by {names}: {100 * size.closed:.0f} % of it closes."


def _named(where: Where) -> str:
    """Return the place in words."""
    numbers = [str(one) for one in where.sensors if isinstance(one, int)]
    parts = []
    if numbers:
        parts.append(f"sensor{'s' * (len(numbers) > 1)} {', '.join(numbers)}")
    if "scalar" in where.sensors:
        parts.append("the scalar magnetometer")
    return " and ".join(parts) or "all sensors"
