"""The verdict on a gap, and the sentence that says it."""

import numpy as np

from tam_calibration.effects.effect import ALL
from tam_calibration.effects.excess_variance import LARGEST_NOISE, Excess, Moments, best_excess
from tam_calibration.effects.grades import MINOR, MOST, NOTABLE
from tam_calibration.gap.hypotheses import Evidence
from tam_calibration.gap.looking import LARGEST_REST
from tam_calibration.gap.model import Model
from tam_calibration.gap.result import Cause, Size, Verdict, Where
from tam_calibration.gap.search import places_of, sensors_of
from tam_calibration.gap.steps import Search
from tam_calibration.gap.support import LEAST_EVIDENCE, open_part


def noisier_rows(model: Model) -> Excess | None:
    """Return the excess of variance of some rows over the others, whatever makes it."""
    channels = model.channels(model.signal() if model.parts else None)
    excess = best_excess(Moments.of(channels.misfit), channels.situation)
    if excess is None or excess.gain - excess.parameter_count * np.log(channels.count) < LEAST_EVIDENCE:
        return None
    return excess


def verdict_on(found: Search, size: Size, variance: float, is_noisier: bool) -> Verdict:
    """Return the verdict on a search; some rows may be noisier than the others without a cause for it."""
    if size.before < MINOR:
        return "no_gap"
    if not found.steps:
        is_even = _strongest(found) is None and variance < LARGEST_NOISE**2 and not is_noisier
        return "no_gap" if is_even else "unexplained"
    if size.closed < NOTABLE:  # It may be what causes have in common with an unknown one.
        return "unexplained"
    left = open_part(found.nominal.base(), found.model.base(), found.remaining)
    is_whole = left < MINOR and size.closed > MOST and size.after < LARGEST_REST
    return "explained" if is_whole and not _is_open_elsewhere(found) else "partly_explained"


def _is_open_elsewhere(found: Search) -> bool:
    """Whether rows of a sensor without a cause are noisier than the others: that is no error of a cause's model."""
    own = {sensor for step in found.steps for sensor in sensors_of(places_of(step.accepted.form))}
    excess = None if ALL in own else noisier_rows(found.model)
    return excess is not None and excess.place.sensor not in own


def smallest_gap(count: float) -> float:
    """Return the gap in noise floors that would have been seen in so many channels: of one coefficient of one row."""
    return max(MINOR, float(np.sqrt((LEAST_EVIDENCE + np.log(count)) / count)))


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
