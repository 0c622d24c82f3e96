"""Which effect a search accepts next beside the causes that it has."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.effects.effect import Finding
from tam_calibration.gap.hypotheses import Evidence
from tam_calibration.gap.noise_gain import noise_gain
from tam_calibration.gap.regression import Base
from tam_calibration.gap.search import Hypothesis, places_of
from tam_calibration.gap.standing import (
    AGAINST_RIVAL,
    LEAST_EVIDENCE,
    NOISE,
    OUTLIERS,
    beats,
    energy_explained,
    sensors_of,
)

_LATER_EVIDENCE = 40.0
"""ΔBIC from which a further cause counts."""

_NOISE_WORTH = 0.3
"""Noise explains any excess: its evidence is worth less than that of what says how it comes."""

_LEAST_FIRST_SHARE = 0.3
_LEAST_SHARE = 0.08
"""Part of the energy that anything explains that the first cause must explain, and each further one."""

_OF_NOISE = 0.5
"""Part of what a cause gains that it may gain by averaging noise."""

_AMONG_SEVERAL = 0.35
"""Part of a rival's energy that a cause must explain before all causes are known."""

_JUMP = "bias_jump"
_REPEATED = {_JUMP, "periodic_interference", NOISE, OUTLIERS}
"""Effects that may happen more than once, each time in another form."""

_OF_EACH_SENSOR = {"temperature_drift"}
"""Effects that each sensor may have in a form of its own, so that two forms tell what several sensors do."""

_MOST_JUMPS = 3
"""Times at which one sensor's bias jumps; what comes and goes more often is a loose part or contact, and no jump."""

_MOST_STRUCK = 0.04
"""Part of the samples that are outliers at most."""

_SAME_TIME = 3.0
"""Sampling steps within which two jumps are one."""


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the search: what was accepted, and all that was weighed."""

    accepted: Evidence
    weighed: tuple[Evidence, ...]
    rivals: tuple[Evidence, ...]


def choose(
    base: Base, weighed: Sequence[Evidence], unknown: Sequence[Evidence], steps: Sequence[Step], explained: float
) -> Evidence | None:
    """Return the strongest effect that is no mere trifle and no poor stand-in for a function without physics."""
    most = max((energy_explained(one, base) for one in (*weighed, *unknown)), default=0.0)
    least = (_LEAST_SHARE if steps else _LEAST_FIRST_SHARE) * max(most, explained)
    # Noise is what remains when nothing else explains about as much.
    for candidate in sorted(
        weighed, key=lambda one: (-one.is_certain, -one.delta_bic * (_NOISE_WORTH if one.effect == NOISE else 1.0))
    ):
        if candidate.delta_bic < (_LATER_EVIDENCE if steps else LEAST_EVIDENCE):
            continue
        if isinstance(candidate.form, Finding) and not _gives_up_more(candidate.form, base):
            continue
        if energy_explained(candidate, base) < least or not is_new(candidate, steps, base):
            continue
        if is_plausible(base, candidate, unknown):
            return candidate
    return None


def is_plausible(base: Base, candidate: Evidence, unknown: Sequence[Evidence]) -> bool:
    """Whether a candidate may be one of several causes: no poor stand-in for a rival, and no average of noise."""
    tolerance = AGAINST_RIVAL if isinstance(candidate.form, Finding) else _AMONG_SEVERAL
    if not (candidate.is_certain or beats(base, candidate, unknown, tolerance)):
        return False
    if isinstance(candidate.form, Finding):
        return True
    own = noise_gain(base, candidate.form)
    return candidate.delta_bic - own > LEAST_EVIDENCE and own < _OF_NOISE * candidate.gain


def is_new(candidate: Evidence, steps: Sequence[Step], base: Base) -> bool:
    """Whether a candidate may come beside the causes accepted."""
    alike = [step.accepted for step in steps if step.accepted.effect == candidate.effect]
    if candidate.effect in _OF_EACH_SENSOR:
        alike = alike if len(alike) > 1 else [one for one in alike if len(sensors_of(places_of(one.form))) == 1]
    if alike and candidate.effect not in _REPEATED:
        return False
    if candidate.effect == OUTLIERS and _struck([candidate, *alike]) > _MOST_STRUCK:
        return False
    sensors = sensors_of(places_of(candidate.form))
    there = [step.accepted for step in steps if sensors & sensors_of(places_of(step.accepted.form))]
    if any(_is_nested(candidate, other) for other in there):
        return False
    return candidate.effect != _JUMP or _jumps([candidate, *there], base.channels.situation.step_s) <= _MOST_JUMPS


def _is_nested(one: Evidence, other: Evidence) -> bool:
    """Whether one of two is a special case of the other."""
    effects = [form.effect for form in (one.form, other.form) if isinstance(form, Hypothesis)]
    return len(effects) == 2 and bool({one.effect, other.effect} & {name for own in effects for name in own.within})


def _struck(causes: Sequence[Evidence]) -> float:
    """Return the part of the samples that findings flag."""
    flags = [one.form.flagged for one in causes if isinstance(one.form, Finding) and one.form.flagged is not None]
    return float(np.any(flags, axis=0).mean())


def _jumps(causes: Sequence[Evidence], step_s: float) -> int:
    """Return the number of times at which biases jump."""
    forms = [one.form for one in causes if one.effect == _JUMP]
    times = sorted(time for form in forms if isinstance(form, Hypothesis) for time in form.shape.values())
    return sum(
        later - time > _SAME_TIME * step_s for time, later in zip(times, [*times[1:], float("inf")], strict=True)
    )


def absorbed(accepted: Evidence, steps: Sequence[Step]) -> Evidence:
    """Return noise or spikes in sensors that saturate or are rounded as part of that: what is left there is of it."""
    if not isinstance(accepted.form, Finding) or accepted.is_certain:
        return accepted
    sensors = sensors_of(places_of(accepted.form))
    for step in steps:
        before = step.accepted
        if not (before.is_certain and isinstance(before.form, Finding)):
            continue
        if sensors <= sensors_of(places_of(before.form)):
            return replace(accepted, effect=before.effect, form=replace(accepted.form, fitted=before.form.fitted))
    return accepted


def _gives_up_more(finding: Finding, base: Base) -> bool:
    """Whether a finding gives up samples that are still counted, or gives up none at all."""
    return finding.flagged is None or bool((finding.flagged & base.channels.is_counted).any())
