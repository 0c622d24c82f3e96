"""The diagnosis of a recording: is there a gap, where, which effect causes it, and how far it shrinks."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from math import log

from tam_calibration.array import Array
from tam_calibration.effects.effect import Finding
from tam_calibration.effects.library import installed_effects
from tam_calibration.gap.channels import Design
from tam_calibration.gap.hypotheses import Evidence, examine, rivals, usable
from tam_calibration.gap.model import Model
from tam_calibration.gap.nominal import prepared
from tam_calibration.gap.regression import Base
from tam_calibration.gap.result import Considered
from tam_calibration.gap.search import Hypothesis
from tam_calibration.recording import Recording

Progress = Callable[[str, float], None]

_MOST_CAUSES = 4
LEAST_EVIDENCE = 12.0
_LEAST_SHARE = 0.05
_AGAINST_RIVAL = 0.75


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the search: what was accepted, and all that was weighed."""

    accepted: Evidence
    weighed: tuple[Evidence, ...]
    rivals: tuple[Evidence, ...]


@dataclass(frozen=True, eq=False)
class Search:
    """The whole search: the model in front of it and after it, its steps, and what was weighed last."""

    nominal: Model
    model: Model
    steps: tuple[Step, ...]
    weighed: tuple[Evidence, ...]
    rivals: tuple[Evidence, ...]
    considered: tuple[Considered, ...]


def search(recording: Recording, array: Array, without: Collection[str] = (), progress: Progress | None = None) -> Search:
    """Look for causes, the strongest first, until nothing more speaks for one."""
    tell = progress or (lambda what, part: None)
    tell("nominal calibration", 0.0)
    nominal = model = Model.nominal(prepared(recording), array)
    steps: list[Step] = []
    while True:
        base = model.base()
        effects, considered = usable(installed_effects(), without, base.channels.situation)
        weighed: list[Evidence] = []
        for number, (name, effect) in enumerate(effects.items()):
            tell(name, (len(steps) + number / len(effects)) / (_MOST_CAUSES + 1))
            found = examine(base, effect)
            if isinstance(found, Evidence):
                weighed.append(found)
            else:
                considered.append(Considered(name, "not_supported", found))
        unknown = rivals(base)
        accepted = None if len(steps) == _MOST_CAUSES else _choose(base, weighed, unknown, steps)
        if accepted is None:
            return Search(nominal, model, tuple(steps), tuple(weighed), tuple(unknown), tuple(considered))
        steps.append(Step(accepted, tuple(weighed), tuple(unknown)))
        if isinstance(accepted.form, Finding):
            model = model.accept_finding(accepted.form)
        else:
            model = model.accept(accepted.form)


def _choose(base: Base, weighed: list[Evidence], unknown: list[Evidence], steps: list[Step]) -> Evidence | None:
    done = sum(step.accepted.gain for step in steps)
    for candidate in sorted(weighed, key=lambda one: -one.delta_bic):
        if candidate.delta_bic < LEAST_EVIDENCE:
            break
        if candidate.gain < _LEAST_SHARE * (done + candidate.gain):
            continue
        if all(candidate.gain >= _AGAINST_RIVAL * _gain_beside(base, rival, candidate) for rival in unknown):
            return candidate
    return None


def _gain_beside(base: Base, rival: Evidence, candidate: Evidence) -> float:
    """Return what a rival gains in the sensors of a candidate."""
    if rival.delta_bic < LEAST_EVIDENCE:
        return 0.0
    assert isinstance(rival.form, Hypothesis)
    if isinstance(candidate.form, Hypothesis):
        sensors = {term.sensor for term in candidate.form.terms}
    else:
        sensors = {one.sensor for one in candidate.form.fitted.contributions}
    terms = [term for term in rival.form.terms if term.sensor in sensors or min(sensors) == -2]
    if not terms:
        return 0.0
    gain = base.project(Design.of(terms)).gain()[0]
    return base.channels.count * log(base.energy / max(base.energy - gain, 1e-300))
