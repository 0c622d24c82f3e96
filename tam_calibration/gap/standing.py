"""Which causes hold beside each other and against functions without physics."""

from collections.abc import Iterable, Sequence
from math import expm1, log, sqrt

import numpy as np

from tam_calibration.effects.effect import ALL, Finding
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.hypotheses import Evidence, examine
from tam_calibration.gap.regression import Base, twice_log_likelihood_ratio
from tam_calibration.gap.search import Hypothesis, Place, places_of
from tam_calibration.gap.unknown import FunctionOfDirection
from tam_calibration.gap.where import main_places

LEAST_EVIDENCE = 12.0
"""ΔBIC from which a hypothesis counts."""

NOISE, OUTLIERS = "noise_excess", "outliers"

AGAINST_RIVAL = 0.95
"""Part of the energy that a function without physics explains in the same sensors that a cause must explain."""

_CHANCE, _MOST_CHANCE = 3.0, 0.15
"""Standard deviations of the energy of noise by which a cause may fall short of a rival, and most of that."""

_AS_MUCH = 0.9
"""Part of the energy that a cause explains from which a rival at another place explains as much."""


def holds(base: Base, cause: Evidence, unknown: Sequence[Evidence]) -> bool:
    """Whether a cause holds at the base of all other causes against functions without physics there."""
    if isinstance(cause.form, Finding):
        return cause.effect != NOISE or (
            isinstance(examine(base, effect_named(NOISE)), Evidence) and beats(base, cause, unknown, AGAINST_RIVAL)
        )
    form = cause.form.moved(base.channels.situation)
    gain, rank = base.project(base.channels.design(form.terms)).gain()
    gain = twice_log_likelihood_ratio(base.energy, gain, base.channels.count)
    alone = Evidence(cause.effect, form, gain - rank * log(base.channels.count), gain)
    if alone.delta_bic < LEAST_EVIDENCE or _is_elsewhere(base, alone, unknown):
        return False
    follows_field_alone = not (form.effect.is_free_in_time or form.effect.channels)
    if follows_field_alone and _is_of_direction(alone, unknown):
        return False
    return beats(base, alone, unknown, AGAINST_RIVAL)


def beats(base: Base, candidate: Evidence, unknown: Iterable[Evidence], tolerance: float) -> bool:
    """Whether a candidate explains nearly all of the energy that the best function without physics does."""
    count, energy = base.channels.count, base.energy
    rival = _energy_of(max((_gain_beside(base, one, candidate) for one in unknown), default=0.0), energy, count)
    if rival <= 0:
        return True
    chance = _CHANCE * energy / count * sqrt(2 * count) / rival
    return energy_explained(candidate, base) >= (tolerance - min(chance, _MOST_CHANCE)) * rival


def open_part(first: Base, last: Base, unknown: Iterable[Evidence]) -> float:
    """Return the part of all that can be explained that causes leave to functions without physics."""
    left = max((energy_explained(one, last) for one in unknown if one.delta_bic > LEAST_EVIDENCE), default=0.0)
    return left / max(left + first.energy - last.energy, np.finfo(float).tiny)


def energy_explained(one: Evidence, base: Base) -> float:
    """Return the energy that a hypothesis explains of what a base leaves."""
    return _energy_of(one.gain, base.energy, base.channels.count)


def sensors_of(places: Iterable[Place]) -> set[int]:
    """Return the sensors of places."""
    return {sensor for sensor, _ in places}


def _is_elsewhere(base: Base, cause: Evidence, unknown: Iterable[Evidence]) -> bool:
    """Whether a function without physics explains as much with less, in none of the sensors of a cause."""
    sensors = sensors_of(places_of(cause.form))
    return ALL not in sensors and any(
        one.delta_bic > cause.delta_bic
        and energy_explained(one, base) > _AS_MUCH * energy_explained(cause, base)
        and not sensors & sensors_of(main_places(base, one))
        for one in unknown
    )


def _is_of_direction(cause: Evidence, unknown: Iterable[Evidence]) -> bool:
    """Whether more speaks for some function of the direction, though it pays for more coefficients: no time matters."""
    return any(one.effect == FunctionOfDirection.name and one.delta_bic > cause.delta_bic for one in unknown)


def _energy_of(gain: float, energy: float, count: float) -> float:
    return energy * -expm1(-gain / count)


def _gain_beside(base: Base, rival: Evidence, candidate: Evidence) -> float:
    """Return what a rival gains in the sensors of a candidate, beyond what noise lets it gain."""
    if rival.delta_bic < LEAST_EVIDENCE:
        return 0.0
    assert isinstance(rival.form, Hypothesis)
    sensors = sensors_of(places_of(candidate.form))
    terms = [term for term in rival.form.terms if term.sensor in sensors or ALL in sensors]
    if not terms:
        return 0.0
    gain, rank = base.project(base.channels.design(terms)).gain()
    return twice_log_likelihood_ratio(base.energy, gain, base.channels.count) - rank
