"""The diagnosis of a recording: is there a gap, where, which effect causes it, and how far it shrinks."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import expm1, log

from tam_calibration.array import Array
from tam_calibration.effects.effect import ALL, Effect, Finding
from tam_calibration.effects.library import installed_effects
from tam_calibration.gap.channels import Design
from tam_calibration.gap.hypotheses import Evidence, evidence_of, examine, rivals, sharpened, usable
from tam_calibration.gap.model import Model
from tam_calibration.gap.nominal import prepared
from tam_calibration.gap.regression import Base
from tam_calibration.gap.result import Considered
from tam_calibration.gap.search import Hypothesis, places_of, restricted
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

_STARTS = 3
"""Effects from which a search starts, at most."""

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
    """Look for causes, the strongest first, until nothing more speaks for one; then drop those that do not hold.

    The strongest at first need not be a cause: what acts on all sensors may be one thing at one of them and another at
    the scalar magnetometer. The search is made again from other starts where that may be, and the best is kept.
    """
    tell = progress or (lambda what, part: None)
    tell("nominal calibration", 0.0)
    nominal = Model.nominal(prepared(recording), array)
    looking = _Looking(nominal, frozenset(without), tell)
    found = looking.forward(None)
    for start in looking.other_starts(found):
        found = max(found, looking.forward(start), key=lambda one: one.evidence)
    steps = _holding(nominal, _swapped(nominal, found.steps, looking.effects))
    model = nominal
    for step in steps:
        model = model.accept(step.accepted.form)
    first = found.steps[0] if found.steps else found
    return Search(
        nominal, model, tuple(steps), first.weighed, first.rivals, tuple(rivals(model.base())), looking.considered
    )


@dataclass(frozen=True, eq=False)
class _Path:
    """Causes, and what was weighed last."""

    steps: tuple[Step, ...]
    weighed: tuple[Evidence, ...]
    rivals: tuple[Evidence, ...]
    evidence: float


class _Looking:
    """A search at a nominal model."""

    def __init__(self, nominal: Model, without: Collection[str], tell: Progress) -> None:
        self._nominal, self._tell = nominal, tell
        self._first_base = nominal.base()
        self.effects, missing = usable(installed_effects(), without, self._first_base.channels)
        self._considered = {one.effect: one for one in missing}
        self._first: tuple[tuple[Evidence, ...], tuple[Evidence, ...]] | None = None

    @property
    def considered(self) -> tuple[Considered, ...]:
        """What nothing speaks for."""
        return tuple(self._considered.values())

    def _weigh(self, base: Base, depth: int) -> tuple[tuple[Evidence, ...], tuple[Evidence, ...]]:
        if depth == 0 and self._first is not None:
            return self._first
        weighed = []
        for number, (name, effect) in enumerate(self.effects.items()):
            self._tell(name, (depth + number / len(self.effects)) / (_MOST_CAUSES + 1))
            found = examine(base, effect)
            if isinstance(found, Evidence):
                weighed.append(found)
            elif depth == 0:
                self._considered[name] = Considered(name, "not_supported", found)
        result = sharpened(base, weighed), tuple(rivals(base))
        if depth == 0:
            self._first = result
        return result

    def forward(self, first: Evidence | None) -> _Path:
        """Accept causes, the strongest first, or one that is given and then the strongest."""
        model, base = self._nominal, self._first_base
        steps: list[Step] = []
        explained = 0.0
        while True:
            weighed, unknown = self._weigh(base, len(steps))
            accepted = first if first is not None and not steps else None
            if accepted is None and len(steps) < _MOST_CAUSES:
                accepted = _choose(base, weighed, unknown, steps, explained)
            if accepted is None:
                count = base.channels.count
                spent = base.rank - self._first_base.rank
                spent += sum(finding.parameter_count for finding in model.findings)
                return _Path(tuple(steps), weighed, unknown, -count * log(base.energy / count) - spent * log(count))
            steps.append(Step(accepted, weighed, unknown))
            explained = max(explained, _energy(accepted, base.energy, base.channels.count))
            model = model.accept(accepted.form)
            base = model.base()


    def other_starts(self, found: _Path) -> list[Evidence]:
        """Return from what else to start: the first cause at one sensor, and the next effects where a gap remains."""
        base = self._first_base
        starts = []
        first = found.steps[0].accepted if found.steps else None
        if first is not None and isinstance(first.form, Hypothesis) and len({t.sensor for t in first.form.terms}) > 1:
            starts.append(_at_strongest_sensor(base, first.form))
        if first is not None and max((one.delta_bic for one in found.rivals), default=0.0) > LEAST_EVIDENCE:
            weighed, _ = self._weigh(base, 0)
            ranked = sorted(weighed, key=lambda one: -one.delta_bic)
            starts += [one for one in ranked[:_STARTS] if one.delta_bic > first.delta_bic / 2 and one is not first]
        return [start for start in starts if start is not None]


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
            if isinstance(one.form, Hypothesis) and one.delta_bic > LEAST_EVIDENCE and one.effect not in others
        ]
        offers = [examine(base, effects[name]) for name in dict.fromkeys(names)]
        sharp = sharpened(base, [offer for offer in offers if isinstance(offer, Evidence)])
        best = max(sharp, key=lambda offer: offer.delta_bic, default=step.accepted)
        if best.effect != step.accepted.effect:
            kept[index] = Step(best, step.weighed, step.rivals)
    return kept


def _beside(nominal: Model, steps: Sequence[Step], step: Step) -> Model:
    """Return the model with all causes but one."""
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
    for candidate in sorted(weighed, key=lambda one: (-one.is_certain, -one.delta_bic)):
        if candidate.delta_bic < LEAST_EVIDENCE:
            continue
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
    base = _beside(nominal, steps, step).base()
    assert isinstance(step.accepted.form, Hypothesis)
    form = step.accepted.form.moved(base.channels.situation)
    gain, rank = base.project(form.design).gain()
    gain = base.channels.count * log(base.energy / max(base.energy - gain, 1e-300))
    unknown = step.rivals if steps == [step] else rivals(base)
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
