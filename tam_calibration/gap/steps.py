"""The diagnosis of a recording: is there a gap, where, which effect causes it, and how far it shrinks."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import expm1, log, sqrt

import numpy as np

from tam_calibration.array import Array
from tam_calibration.effects.effect import ALL, Effect, Finding, LinearEffect
from tam_calibration.effects.library import installed_effects
from tam_calibration.effects.removal import filled
from tam_calibration.gap.hypotheses import Evidence, evidence_of, examine, rivals, sharpened, usable
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import Base, twice_log_likelihood_ratio
from tam_calibration.gap.result import Considered
from tam_calibration.gap.search import Hypothesis, given_form, places_of, restricted
from tam_calibration.recording import Recording

Progress = Callable[[str, float], None]

_MOST_CAUSES = 4
LEAST_EVIDENCE = 12.0
_LATER_EVIDENCE = 40.0
"""ΔBIC from which a first cause counts, and a further one."""

_NOISE, _NOISE_WORTH = "noise_excess", 0.3
"""Noise explains any excess: its evidence is worth less than that of what says how it comes."""

_LEAST_FIRST_SHARE = 0.3
_LEAST_SHARE = 0.08
"""Part of the energy that anything explains that the first cause must explain, and each further one."""

_CHANCE, _MOST_CHANCE = 3.0, 0.15
"""Standard deviations of the energy of noise by which a cause may fall short of a rival, and most of that."""

_AGAINST_RIVAL = 0.95
"""Part of the energy that a function without physics explains in the same sensors that a cause must explain."""

_AMONG_SEVERAL = 0.35
"""The same before all causes are known."""

CLEAN = 0.1
"""Part of the gap that causes may leave open and still explain it."""

_HOPELESS = 0.5
"""Part of the gap that no causes may leave open."""

_STARTS = 4
"""Effects from which a search starts, at most."""

_START_PART = 0.25
"""Part of the first's evidence that another start must have."""

_REPEATED = {"bias_jump", "periodic_interference", "noise_excess", "outliers"}
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


def search(
    recording: Recording, array: Array, without: Collection[str] = (), progress: Progress | None = None
) -> Search:
    """Look for causes, the strongest first, until nothing more speaks for one; then drop those that do not hold.

    The strongest at first need not be a cause: what acts on all sensors may be one thing at one of them and another at
    the scalar magnetometer. The search is made again from other starts where that may be, and the best is kept.
    """
    tell = progress or (lambda what, part: None)
    tell("nominal calibration", 0.0)
    nominal = Model.nominal(filled(recording), array)
    looking = _Looking(nominal, frozenset(without), tell)
    best = looking.found(looking.gross)
    for number, start in enumerate(looking.other_starts(best)):
        if number > 0 and best.is_clean:
            break
        best = max(best, looking.found(start), key=lambda one: (one.is_clean, one.evidence))
    weighed, unknown = looking.weigh(looking.first_base, 0)
    return Search(
        nominal,
        best.model,
        best.steps,
        weighed,
        unknown,
        best.remaining,
        looking.considered,
    )


@dataclass(frozen=True, eq=False)
class _Outcome:
    """Causes that hold, the model with them, what is still open, and the evidence for it all."""

    first: Evidence | None
    steps: tuple[Step, ...]
    model: Model
    remaining: tuple[Evidence, ...]
    evidence: float
    is_clean: bool


class _Looking:
    """A search at a nominal model."""

    def __init__(self, nominal: Model, without: Collection[str], tell: Progress) -> None:
        self._nominal, self._tell = nominal, tell
        self.first_base = nominal.base()
        self._effects, missing = usable(installed_effects(), without, self.first_base.channels)
        self._considered = {one.effect: one for one in missing}
        self._first: tuple[tuple[Evidence, ...], tuple[Evidence, ...]] | None = None

    @property
    def gross(self) -> Evidence | None:
        """The jump that was seen without a calibration, where there is one."""
        jump = self._nominal.gross
        effect = None if jump is None else self._effects.get(jump.effect)
        if jump is None or not isinstance(effect, LinearEffect):
            return None
        return evidence_of(self.first_base, given_form(self.first_base, effect, jump))

    @property
    def considered(self) -> tuple[Considered, ...]:
        """What nothing speaks for."""
        return tuple(self._considered.values())

    def weigh(self, base: Base, depth: int) -> tuple[tuple[Evidence, ...], tuple[Evidence, ...]]:
        """Return what speaks for each effect and, in front of all causes, for each function without physics."""
        if depth == 0 and self._first is not None:
            return self._first
        weighed = []
        for number, (name, effect) in enumerate(self._effects.items()):
            self._tell(name, (depth + number / len(self._effects)) / (_MOST_CAUSES + 1))
            found = examine(base, effect)
            if isinstance(found, Evidence):
                weighed.append(found)
            elif depth == 0:
                self._considered[name] = Considered(name, "not_supported", found)
        if depth > 0:
            return sharpened(base, weighed), ()
        self._first = sharpened(base, weighed), tuple(rivals(base))
        return self._first

    def found(self, first: Evidence | None) -> _Outcome:
        """Return the causes that hold of those found from a start, or from the strongest."""
        steps, base = self._forward(first)
        unknown = self.weigh(self.first_base, 0)[1]
        if not steps or open_part(self.first_base, base, rivals(base)) > _HOPELESS:
            kept = []
        else:
            kept = _holding(self._nominal, steps, unknown)
            kept = _swapped(self._nominal, kept, self._effects)
        model = _beside(self._nominal, kept, None)
        if kept != steps:
            base = model.base()
        unknown = tuple(rivals(base)) if kept else unknown
        count = base.channels.count
        spent = base.rank - self.first_base.rank + sum(finding.parameter_count for finding in model.findings)
        evidence = -count * log(base.energy / count) - spent * log(count)
        is_clean = bool(kept or not steps) and open_part(self.first_base, base, unknown) < CLEAN
        return _Outcome(steps[0].accepted if steps else None, tuple(kept), model, unknown, evidence, is_clean)

    def _forward(self, first: Evidence | None) -> tuple[list[Step], Base]:
        """Accept causes, the strongest first, or one that is given and then the strongest."""
        model, base = self._nominal, self.first_base
        steps: list[Step] = []
        explained = 0.0
        while True:
            weighed, unknown = self.weigh(base, len(steps))
            accepted = first if not steps else None
            if accepted is None and len(steps) < _MOST_CAUSES:
                accepted = _choose(base, weighed, unknown, steps, explained)
            if accepted is None:
                return steps, base
            steps.append(Step(_absorbed(accepted, steps), weighed, unknown))
            explained = max(explained, _energy(accepted, base.energy, base.channels.count))
            model = model.accept(accepted.form)
            base = model.base()

    def other_starts(self, found: _Outcome) -> list[Evidence]:
        """Return from what else to start: the first cause at one sensor, and the next effects where a gap remains."""
        first = found.first
        if first is None or first.is_certain or self._nominal.gross is not None:
            return []
        ranked = sorted(self.weigh(self.first_base, 0)[0], key=lambda one: -one.delta_bic)
        others = [one for one in ranked if one is not first and one.delta_bic > _START_PART * first.delta_bic]
        starts = [] if found.is_clean else [self._alone(one) or one for one in others[:_STARTS]]
        alone = self._alone(first)
        return starts if alone is None else [alone, *starts]

    def _alone(self, one: Evidence) -> Evidence | None:
        """Return the evidence at the strongest sensor alone of what is spread over several."""
        if isinstance(one.form, Hypothesis) and len({term.sensor for term in one.form.terms}) > 1:
            return _at_strongest_sensor(self.first_base, one.form)
        return None


def _absorbed(accepted: Evidence, steps: Sequence[Step]) -> Evidence:
    """Return noise or spikes in sensors that saturate or are rounded as part of that: what is left there is of it."""
    if not isinstance(accepted.form, Finding) or accepted.is_certain:
        return accepted
    sensors = {sensor for sensor, _ in places_of(accepted.form)}
    for step in steps:
        before = step.accepted
        if not (before.is_certain and isinstance(before.form, Finding)):
            continue
        if sensors <= {at for at, _ in places_of(before.form)}:
            return replace(accepted, effect=before.effect, form=replace(accepted.form, fitted=before.form.fitted))
    return accepted


def _at_strongest_sensor(base: Base, form: Hypothesis) -> Evidence | None:
    """Return the part of a form at the sensor where it explains most."""
    alone: dict[int, Hypothesis] = {}
    for sensor in {term.sensor for term in form.terms}:
        found = restricted(base, form, sensor)
        if found is not None:
            alone[sensor] = found
    if not alone:
        return None
    best = max(alone.values(), key=lambda one: one.selection.gain)
    return evidence_of(base, best)


def _swapped(nominal: Model, steps: Sequence[Step], effects: Mapping[str, Effect]) -> list[Step]:
    """Return the causes, each replaced by the effect that explains most beside the others."""
    kept = list(steps)
    if len(kept) < 2:
        return kept
    for index, step in enumerate(kept):
        if not isinstance(step.accepted.form, Hypothesis):
            continue
        base = _beside(nominal, kept, step).base()
        others = {one.accepted.effect for one in kept if one is not step}
        names = [
            one.effect
            for one in (*step.weighed, step.accepted)
            if isinstance(one.form, Hypothesis)
            and one.delta_bic > LEAST_EVIDENCE
            and (one.effect not in others or one.effect == step.accepted.effect)
        ]
        offers = [examine(base, effects[name]) for name in dict.fromkeys(names)]
        sharp = sharpened(base, [offer for offer in offers if isinstance(offer, Evidence)])
        best = max(sharp, key=lambda offer: offer.delta_bic, default=step.accepted)
        if best.effect != step.accepted.effect:
            kept[index] = Step(best, step.weighed, step.rivals)
    return kept


def _beside(nominal: Model, steps: Sequence[Step], step: Step | None) -> Model:
    """Return the model with all causes, or all but one."""
    model = nominal
    for other in steps:
        if other is not step:
            model = model.accept(other.accepted.form)
    return model


def _choose(
    base: Base, weighed: Sequence[Evidence], unknown: Sequence[Evidence], steps: list[Step], explained: float
) -> Evidence | None:
    """Return the strongest effect that is no mere trifle and no poor stand-in for a function without physics."""
    count, energy = base.channels.count, base.energy
    most = max((_energy(one, energy, count) for one in (*weighed, *unknown)), default=0.0)
    done = {step.accepted.effect for step in steps}
    # Noise is what remains when nothing else explains about as much.
    for candidate in sorted(
        weighed, key=lambda one: (-one.is_certain, -one.delta_bic * (_NOISE_WORTH if one.effect == _NOISE else 1.0))
    ):
        if candidate.delta_bic < (_LATER_EVIDENCE if steps else LEAST_EVIDENCE):
            continue
        if isinstance(candidate.form, Finding) and not _gives_up_more(candidate.form, base):
            continue
        if candidate.effect in done - _REPEATED:
            continue
        least = _LEAST_SHARE if steps else _LEAST_FIRST_SHARE
        if _energy(candidate, energy, count) < least * max(most, explained):
            continue
        tolerance = _AGAINST_RIVAL if isinstance(candidate.form, Finding) else _AMONG_SEVERAL
        if candidate.is_certain or _beats(base, candidate, unknown, tolerance):
            return candidate
    return None


def _gives_up_more(finding: Finding, base: Base) -> bool:
    """Whether a finding gives up samples that are still counted, or gives up none at all."""
    return finding.flagged is None or bool((finding.flagged & base.channels.is_counted).any())


def _holding(nominal: Model, steps: list[Step], rivals_of_all: Sequence[Evidence]) -> list[Step]:
    """Return the causes that, beside all others, explain what functions without physics explain in their sensors."""
    kept = list(steps)
    while True:
        weakest_first = sorted(kept, key=lambda step: step.accepted.gain)
        failing = next((step for step in weakest_first if not _holds(nominal, kept, step, rivals_of_all)), None)
        if failing is None:
            return kept
        kept.remove(failing)


def _holds(nominal: Model, steps: list[Step], step: Step, rivals_of_all: Sequence[Evidence]) -> bool:
    base = _beside(nominal, steps, step).base()
    if isinstance(step.accepted.form, Finding):
        unknown = rivals_of_all if steps == [step] else rivals(base)
        return step.accepted.effect != _NOISE or _beats(base, step.accepted, unknown, _AGAINST_RIVAL)
    form = step.accepted.form.moved(base.channels.situation)
    gain, rank = base.project(base.channels.design(form.terms)).gain()
    gain = twice_log_likelihood_ratio(base.energy, gain, base.channels.count)
    unknown = rivals_of_all if steps == [step] else rivals(base)
    alone = Evidence(step.accepted.effect, form, gain - rank * log(base.channels.count), gain)
    return alone.delta_bic >= LEAST_EVIDENCE and _beats(base, alone, unknown, _AGAINST_RIVAL)


def _beats(base: Base, candidate: Evidence, unknown: Iterable[Evidence], tolerance: float) -> bool:
    """Whether a candidate explains nearly all of the energy that the best function without physics does."""
    count, energy = base.channels.count, base.energy
    rival = _energy_of(max((_gain_beside(base, one, candidate) for one in unknown), default=0.0), energy, count)
    if rival <= 0:
        return True
    chance = _CHANCE * energy / count * sqrt(2 * count) / rival
    return _energy(candidate, energy, count) >= (tolerance - min(chance, _MOST_CHANCE)) * rival


def open_part(first: Base, last: Base, unknown: Iterable[Evidence]) -> float:
    """Return the part of all that can be explained that causes leave to functions without physics."""
    count = last.channels.count
    left = max((_energy(one, last.energy, count) for one in unknown if one.delta_bic > LEAST_EVIDENCE), default=0.0)
    return left / max(left + first.energy - last.energy, np.finfo(float).tiny)


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
    gain, rank = base.project(base.channels.design(terms)).gain()
    return twice_log_likelihood_ratio(base.energy, gain, base.channels.count) - rank
