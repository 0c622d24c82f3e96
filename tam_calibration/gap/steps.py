"""The diagnosis of a recording: is there a gap, where, which effect causes it, and how far it shrinks."""

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from math import expm1, log

from tam_calibration.array import Array
from tam_calibration.effects.effect import ALL, Finding
from tam_calibration.effects.library import installed_effects
from tam_calibration.gap.channels import Design
from tam_calibration.gap.hypotheses import Evidence, examine, rivals, usable
from tam_calibration.gap.model import Model
from tam_calibration.gap.nominal import prepared
from tam_calibration.gap.regression import Base
from tam_calibration.gap.result import Considered
from tam_calibration.gap.search import Hypothesis, places_of
from tam_calibration.recording import Recording

Progress = Callable[[str, float], None]

_MOST_CAUSES = 4
LEAST_EVIDENCE = 12.0
_LEAST_FIRST_SHARE = 0.3
_LEAST_SHARE = 0.1
"""Part of the energy that anything explains that the first cause must explain, and each further one."""

_AGAINST_RIVAL = 0.9
"""Part of the energy that a function without physics explains in the same sensors that a cause must explain."""

_AMONG_SEVERAL = 0.35
"""The same before all causes are known."""

_REPEATED = {"bias_jump", "periodic_interference", "noise_excess"}
"""Effects that may happen more than once, each time in another form."""


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the search: what was accepted, and all that was weighed."""

    accepted: Evidence
    weighed: tuple[Evidence, ...]
    rivals: tuple[Evidence, ...]


@dataclass(frozen=True, eq=False)
class Search:
    """The whole search.

    Parameters
    ----------
    nominal, model : Model
        In front of the causes, and with them.
    steps : tuple of Step
        The causes, in the order in which they were accepted.
    weighed, rivals : tuple of Evidence
        What was weighed at the nominal model.
    remaining : tuple of Evidence
        What functions without physics still explain beside the causes.
    considered : tuple of Considered
        Hypotheses without evidence.
    """

    nominal: Model
    model: Model
    steps: tuple[Step, ...]
    weighed: tuple[Evidence, ...]
    rivals: tuple[Evidence, ...]
    remaining: tuple[Evidence, ...]
    considered: tuple[Considered, ...]


def search(recording: Recording, array: Array, without: Collection[str] = (), progress: Progress | None = None) -> Search:
    """Look for causes, the strongest first, until nothing more speaks for one; then drop those that do not hold."""
    tell = progress or (lambda what, part: None)
    tell("nominal calibration", 0.0)
    nominal = model = Model.nominal(prepared(recording), array)
    steps: list[Step] = []
    explained = 0.0
    while True:
        base = model.base()
        effects, considered = usable(installed_effects(), without, base.channels)
        weighed: list[Evidence] = []
        for number, (name, effect) in enumerate(effects.items()):
            tell(name, (len(steps) + number / len(effects)) / (_MOST_CAUSES + 1))
            found = examine(base, effect)
            if isinstance(found, Evidence):
                weighed.append(found)
            else:
                considered.append(Considered(name, "not_supported", found))
        unknown = rivals(base)
        accepted = None if len(steps) == _MOST_CAUSES else _choose(base, weighed, unknown, steps, explained)
        if accepted is None:
            break
        steps.append(Step(accepted, tuple(weighed), tuple(unknown)))
        explained = max(explained, _energy(accepted, base.energy, base.channels.count))
        model = model.accept(accepted.form)
    kept = _holding(nominal, steps)
    first = steps[0] if steps else None
    if len(kept) < len(steps):
        steps = kept
        model = nominal
        for step in steps:
            model = model.accept(step.accepted.form)
        unknown = rivals(model.base())
    return Search(
        nominal,
        model,
        tuple(steps),
        first.weighed if first else tuple(weighed),
        first.rivals if first else tuple(unknown),
        tuple(unknown),
        tuple(considered),
    )


def _choose(
    base: Base, weighed: list[Evidence], unknown: list[Evidence], steps: list[Step], explained: float
) -> Evidence | None:
    """Return the strongest effect that is no mere trifle and no poor stand-in for a function without physics."""
    count, energy = base.channels.count, base.energy
    most = max((_energy(one, energy, count) for one in (*weighed, *unknown)), default=0.0)
    done = {step.accepted.effect for step in steps}
    for candidate in sorted(weighed, key=lambda one: -one.delta_bic):
        if candidate.delta_bic < LEAST_EVIDENCE:
            break
        if candidate.effect in done - _REPEATED:
            continue
        least = _LEAST_SHARE if steps else _LEAST_FIRST_SHARE
        if _energy(candidate, energy, count) < least * max(most, explained):
            continue
        tolerance = _AGAINST_RIVAL if isinstance(candidate.form, Finding) else _AMONG_SEVERAL
        if _beats(base, candidate, unknown, tolerance):
            return candidate
    return None


def _holding(nominal: Model, steps: list[Step]) -> list[Step]:
    """Return the causes that, beside all others, explain what functions without physics explain in their sensors."""
    kept = list(steps)
    while kept:
        failing = [step for step in kept if isinstance(step.accepted.form, Hypothesis) and not _holds(nominal, kept, step)]
        if not failing:
            break
        kept.remove(min(failing, key=lambda step: step.accepted.gain))
    return kept


def _holds(nominal: Model, steps: list[Step], step: Step) -> bool:
    model = nominal
    for other in steps:
        if other is not step:
            model = model.accept(other.accepted.form)
    base = model.base()
    assert isinstance(step.accepted.form, Hypothesis)
    form = step.accepted.form.moved(base.channels.situation)
    gain, rank = base.project(form.design).gain()
    gain = base.channels.count * log(base.energy / max(base.energy - gain, 1e-300))
    unknown = step.rivals if model is nominal and step is steps[0] else rivals(base)
    alone = Evidence(step.accepted.effect, form, gain - rank * log(base.channels.count), gain)
    return alone.delta_bic >= LEAST_EVIDENCE and _beats(base, alone, unknown, _AGAINST_RIVAL)


def _beats(base: Base, candidate: Evidence, unknown: Iterable[Evidence], tolerance: float) -> bool:
    count, energy = base.channels.count, base.energy
    rival = max((_gain_beside(base, one, candidate) for one in unknown), default=0.0)
    return candidate.gain >= _AGAINST_RIVAL * rival or (
        _energy_of(candidate.gain, energy, count) >= tolerance * _energy_of(rival, energy, count)
    )


def _energy(one: Evidence, energy: float, count: float) -> float:
    """Return the energy that a hypothesis explains."""
    return _energy_of(one.gain, energy, count)


def _energy_of(gain: float, energy: float, count: float) -> float:
    return energy * -expm1(-gain / count)


def _gain_beside(base: Base, rival: Evidence, candidate: Evidence) -> float:
    """Return what a rival gains in the sensors of a candidate, beyond what noise lets it gain."""
    if rival.delta_bic < LEAST_EVIDENCE:
        return 0.0
    assert isinstance(rival.form, Hypothesis)
    sensors = {sensor for sensor, _ in places_of(candidate.form)}
    terms = [term for term in rival.form.terms if term.sensor in sensors or ALL in sensors]
    if not terms:
        return 0.0
    gain, rank = base.project(Design.of(terms)).gain()
    return base.channels.count * log(base.energy / max(base.energy - gain, 1e-300)) - rank
