"""The search for the causes of a gap: for each law, the strongest first, an effect that leaves nothing of it."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from math import log

from tam_calibration.effects.effect import Effect, LinearEffect
from tam_calibration.effects.grades import MINOR, MOST, NEARLY_ALL, NOTABLE
from tam_calibration.effects.library import effect_named, installed_effects
from tam_calibration.gap.hypothesis import EVERYWHERE, Hypothesis, form_at, given_form, places_of, sensors_of
from tam_calibration.gap.laws.causes import acts_at, makes, may_make
from tam_calibration.gap.laws.decisions import LEAST_SHARE
from tam_calibration.gap.laws.law import ATTITUDE, SCALAR, Place, Signature
from tam_calibration.gap.laws.signature import Law, laws_of
from tam_calibration.gap.laws.whitened import Residual, residual_of
from tam_calibration.gap.model import Model, Part
from tam_calibration.gap.regression import Base
from tam_calibration.gap.repeats import pose_of, repeats
from tam_calibration.gap.result import Considered
from tam_calibration.gap.size import Evidence, energy_explained, evidence_of, examine, sharpened, usable
from tam_calibration.gap.support import LEAST_EVIDENCE, Step, absorbed, is_new, special_case
from tam_calibration.model.array import Array
from tam_calibration.model.fitted_effect import ALL
from tam_calibration.model.fitted_effect import SCALAR as SCALAR_ROW
from tam_calibration.model.recording import Recording

Progress = Callable[[str, float], None]

LARGEST_REST = 1.0
"""Residual, in noise floors, that causes may leave: a larger one is a gap of its own."""

_MOST_CAUSES = 4
"""Causes of one gap, at most: more cannot be told apart."""

_FREE = ("step", "episodes", "slow", "random")
"""Courses of any function of time."""

_MOST_TRIED = 4
"""Effects that are fitted to explain one law, at most: those with the most evidence."""


@dataclass(frozen=True, eq=False)
class Search:
    """The whole search.

    Parameters
    ----------
    nominal, model : Model
        Before the causes, and with them.
    steps : tuple of Step
        The causes, in the order in which they were accepted.
    laws, remaining : tuple of Law
        Of the gap, and of what the causes leave of it; the strongest first.
    weighed : tuple of Evidence
        For the effects that were examined at the nominal model.
    considered : tuple of Considered
        Hypotheses without evidence.
    """

    nominal: Model
    model: Model
    steps: tuple[Step, ...]
    laws: tuple[Law, ...]
    remaining: tuple[Law, ...]
    weighed: tuple[Evidence, ...]
    considered: tuple[Considered, ...]

    @property
    def signature(self) -> tuple[Signature, ...]:
        """The laws of the gap, the strongest first: those that causes explain, and those beside or without them."""
        laws = dict.fromkeys([*(step.law for step in self.steps), *(law.signature for law in self.remaining)])
        return tuple(sorted(laws, key=lambda one: -one.energy))

    @property
    def open_part(self) -> float:
        """Part of the energy of all laws that the causes leave, 0 to 1."""
        before, after = self.nominal.base().energy, self.model.base().energy
        left = after * sum(law.part for law in self.remaining)
        return left / max(left + before - after, 1.0)

    @property
    def is_whole(self) -> bool:
        """Whether the causes explain the laws: they leave a small part in their sensors, and nothing elsewhere."""
        elsewhere = any(_is_elsewhere(law.signature, self.steps) for law in self.remaining)
        return self.open_part < MINOR and not elsewhere

    @property
    def is_clean(self) -> bool:
        """Whether the causes leave nothing but noise."""
        base = self.model.base()
        return self.is_whole and base.energy < (1 + LARGEST_REST**2) * base.channels.count

    @property
    def evidence(self) -> float:
        """Log-evidence of the model: -BIC."""
        base = self.model.base()
        spent = base.rank + sum(finding.parameter_count for finding in self.model.findings)
        return -base.channels.count * log(base.energy / base.channels.count) - spent * log(base.channels.count)


def search(
    recording: Recording, array: Array, without: Collection[str] = (), progress: Progress | None = None
) -> Search:
    """Explain the laws of a gap, the strongest first, until no effect explains one.

    Where the calibration of the whole leaves gross residuals, that of a steady part is tried too: the better is taken.

    Parameters
    ----------
    recording : Recording
        As given, of K sensors.
    array : Array
        Geometry, bounds of the field, and noise where it is stated.
    without : collection of str
        Names of effects that are not tried.
    progress : callable, optional
        Called with the name of the stage and the part that is done, 0 to 1.
    """
    tell = progress or (lambda what, part: None)
    tell("nominal calibration", 0.0)
    nominal = Model.nominal(recording, array)
    best = _CauseSearch(nominal, without, tell).run()
    if not best.is_clean and (steady := nominal.steady()) is not None:
        other = _CauseSearch(steady, without, tell).run()
        is_better = (other.is_clean, other.evidence) > (best.is_clean, best.evidence)
        return other if is_better or not (best.steps or other.steps) else best
    return best


class _CauseSearch:
    """The search at one nominal model."""

    def __init__(self, nominal: Model, without: Collection[str], tell: Progress) -> None:
        self._nominal, self._tell = nominal, tell
        channels = nominal.base().channels
        self._effects, missing = usable(installed_effects(), without, channels)
        self._considered = {one.effect: one for one in missing}
        self._weighed: dict[str, Evidence] = {}
        self._steps: list[Step] = []
        self._model = nominal
        self._gap = residual_of(nominal).excess

    def run(self) -> Search:
        """Return the causes of the laws, and what they leave."""
        self._tell("laws", 0.0)
        laws = remaining = laws_of(self._nominal, residual_of(self._nominal), self._gap)
        explained, unexplained = set[_Key](), set[_Key]()
        while len(self._steps) < _MOST_CAUSES:
            law = next((one for one in remaining if _key(one) not in unexplained and not self._is_small(one)), None)
            if law is None:
                break
            left = self._explain(law, [one for one in remaining if one is not law])
            if left is None:
                unexplained.add(_key(law))
                continue
            explained.add(_key(law))
            self._tell("laws", len(self._steps) / (_MOST_CAUSES + 1))
            remaining = tuple(one for one in laws_of(self._model, left, self._gap) if _key(one) not in explained)
        strongest = laws[0].signature.law.replace("_", " ") if laws else ""
        why = f"the gap is a law of {strongest}, which it does not make" if laws else "no law of a gap was found"
        for name in self._effects.keys() - self._weighed.keys():
            self._considered.setdefault(name, Considered(name, "not_supported", why))
        return Search(
            self._nominal,
            self._model,
            tuple(self._steps),
            laws,
            remaining,
            tuple(self._weighed.values()),
            tuple(self._considered.values()),
        )

    def _is_small(self, law: Law) -> bool:
        """Say whether a law is too small to ask for a cause of it, mostly in sensors of a cause.

        The models of causes are right to some per cent.
        """
        least = LEAST_SHARE if _is_elsewhere(law.signature, self._steps) else MINOR
        return law.signature.energy < least and bool(self._steps)

    def _explain(self, law: Law, others: Sequence[Law]) -> Residual | None:
        """Accept the first effect that leaves nothing of a law; return what it leaves, or None without one."""
        base, tried = self._model.base(), list[tuple[Evidence, list[Evidence]]]()
        for offers in self._offers(base, law):
            candidates = _candidates(base, offers, law.signature)
            for number, one in enumerate(candidates):
                left = self._left_by([one], law, others)
                if left is not None:
                    rest = [*candidates[number + 1 :], *self._at_times_of(one, law.signature)]
                    as_good = [
                        other.effect
                        for other in rest
                        if _is_near(other, one) and self._left_by([other], law, others) is not None
                    ]
                    self._accept([one], law, offers, as_good)
                    return left
            tried += [(one, offers) for one in candidates]
        for one, offers in tried:
            chain = [one]
            while (again := self._repeated(chain, law)) is not None:
                chain.append(again)
                left = self._left_by(chain, law, others)
                if left is not None:
                    self._accept(chain, law, offers, ())
                    return left
        return None

    def _at_times_of(self, accepted: Evidence, law: Signature) -> list[Evidence]:
        """Return the other effects that may come and go with an accepted one, as leakage does with a gain."""
        if not isinstance(accepted.form, Hypothesis):
            return []
        base = self._model.base()
        effects = [
            one for one in self._effects.values() if isinstance(one, LinearEffect) and one.name != accepted.effect
        ]
        forms = (
            form_at(base, effect, shape, _sensors_of(law, effect, base))
            for effect in effects
            for shape in effect.shapes_at(accepted.form.shape)
        )
        return [evidence_of(base, form) for form in forms if form is not None]

    def _left_by(self, chain: Sequence[Evidence], law: Law, others: Sequence[Law]) -> Residual | None:
        """Return the residual beside an effect, or several forms of it; None where it leaves something of a law."""
        model = self._with(chain)
        left = residual_of(model)
        if not isinstance(chain[-1].form, Hypothesis):
            return left
        channels, part = model.channels(model.signal()), model.parts[-1]
        if part.effect.oversize(channels.covariates, part.fitted(part.terms(channels))) is not None:
            return None
        return (
            left
            if self._is_gone(law, others, model, left) and not _is_open_at_poses(chain[-1], self._model, model)
            else None
        )

    def _accept(self, chain: Sequence[Evidence], law: Law, offers: Sequence[Evidence], as_good: Sequence[str]) -> None:
        self._model = self._with(chain)
        for one in chain:
            self._steps.append(
                Step(absorbed(one, self._steps), tuple(offers), law.signature, tuple(dict.fromkeys(as_good)))
            )

    def _with(self, chain: Sequence[Evidence]) -> Model:
        """Return the model with further causes."""
        model = self._model
        for one in chain:
            model = model.accept(one.form)
        return model

    def _is_gone(self, law: Law, others: Sequence[Law], model: Model, left: Residual) -> bool:
        """Say whether a model leaves too little of a law; less than most of one that predicts nothing."""
        if law.found:
            return law.is_gone_from(left, others)
        sensors = set(law.signature.sensors)
        there = (
            one.signature for one in laws_of(model, left, self._gap) if not sensors.isdisjoint(one.signature.sensors)
        )
        return sum(one.energy for one in there) < MOST * law.signature.energy

    def _repeated(self, chain: Sequence[Evidence], law: Law) -> Evidence | None:
        """Return the next form of an effect that may happen more than once; None without evidence for it."""
        effect = effect_named(chain[0].effect)
        if not effect.may_repeat or len(self._steps) + len(chain) == _MOST_CAUSES:
            return None
        base = self._with(chain).base()
        steps = [*self._steps, *(Step(one, (), law.signature) for one in chain)]
        again = examine(base, effect, _sensors_of(law.signature, effect, base))
        if isinstance(again, str) or again.delta_bic < LEAST_EVIDENCE or not is_new(again, steps, base):
            return None
        return again if _is_plausible(base, again, law.signature) else None

    def _offers(self, base: Base, law: Law) -> Iterator[list[Evidence]]:
        """Yield the effects that make a law, then others that explain as much as the law does; the likeliest first.

        A free course imitates what follows a slow motion.
        """
        signature = law.signature
        own = [name for name in self._effects if may_make(name, signature)]
        others = [name for name in self._effects if not makes(name, signature)]
        yield sorted(self._examined(base, own, signature), key=lambda one: not one.is_certain)
        if law.found and signature.course in _FREE:
            yield self._others(base, others, law)

    def _others(self, base: Base, names: Sequence[str], law: Law) -> list[Evidence]:
        """Return effects that do otherwise than a law, and yet predict as much, or are certain."""
        examined = self._examined(base, names, law.signature)
        least = (1 - MINOR) * law.part * base.energy
        predictive = [one for one in examined if isinstance(one.form, Hypothesis) or one.is_certain]
        return [one for one in predictive if energy_explained(one, base) > least]

    def _examined(self, base: Base, names: Sequence[str], law: Signature) -> list[Evidence]:
        """Return the evidence for effects that are new, the most first."""
        found = []
        for number, name in enumerate(names):
            self._tell(name, (len(self._steps) + number / len(names)) / (_MOST_CAUSES + 1))
            evidence = self._evidence(base, self._effects[name], law)
            if evidence is not None and evidence.delta_bic > LEAST_EVIDENCE and is_new(evidence, self._steps, base):
                found.append(evidence)
        sharp = sharpened(base, found)
        if not self._steps:
            self._weighed |= {one.effect: one for one in sharp}
        return sorted(sharp, key=lambda one: -one.delta_bic)

    def _evidence(self, base: Base, effect: Effect, law: Signature) -> Evidence | None:
        jump = self._nominal.gross
        if not self._steps and jump is not None and jump.effect == effect.name and isinstance(effect, LinearEffect):
            return evidence_of(base, given_form(base, effect, jump))
        evidence = examine(base, effect, _sensors_of(law, effect, base))
        if not self._steps and isinstance(evidence, Evidence):
            self._weighed[effect.name] = evidence
        elif isinstance(evidence, str):
            self._considered.setdefault(effect.name, Considered(effect.name, "not_supported", evidence))
        return evidence if isinstance(evidence, Evidence) else None


_Key = tuple[str, Place]


def _key(law: Law) -> _Key:
    return law.signature.law, law.signature.sensors


def _is_elsewhere(law: Signature, steps: Sequence[Step]) -> bool:
    """Say whether a law sits in no sensor in which the law of a cause may sit."""
    return {one for place in law.places for one in place}.isdisjoint(
        one for step in steps for place in step.law.places for one in place
    )


def _is_open_at_poses(offer: Evidence, before: Model, after: Model) -> bool:
    """Say whether an effect of the motion leaves much of what is the same whenever a pose is taken up again."""
    effect = effect_named(offer.effect)
    if effect.channels or getattr(effect, "is_free_in_time", False):
        return False
    first, last = (model.channels(model.signal() if model.parts else None) for model in (before, after))
    again = repeats(pose_of(first.covariates))
    if again is None:
        return False
    energy, left = (again.energy(one.differential) for one in (first, last))
    return left > NOTABLE * energy > 0


def _sensors_of(law: Signature, effect: Effect, base: Base) -> frozenset[int]:
    """Return the sensors in which an effect may make a law, as effects count them; empty where that is everywhere."""
    sensors = {one for place in law.places for one in place}
    every = set(range(1, base.channels.recording.sensor_count + 1))
    acts_there = any(acts_at(effect.name, place) for place in law.places)
    if ATTITUDE[0] in sensors or sensors >= every or not acts_there:
        return EVERYWHERE
    return frozenset(SCALAR_ROW if one == SCALAR[0] else int(one) - 1 for one in sensors)


def _is_near(other: Evidence, accepted: Evidence) -> bool:
    """Say whether an effect has about the evidence of an accepted one."""
    return other.delta_bic > accepted.delta_bic - LEAST_EVIDENCE or other.gain > NEARLY_ALL * accepted.gain


def _candidates(base: Base, offers: Sequence[Evidence], law: Signature) -> list[Evidence]:
    """Return the first of some offers, or special cases of them, that may explain a law; each effect once."""
    chosen = {one.effect: one for one in (special_case(offer, offers) for offer in offers[:_MOST_TRIED])}
    return [one for one in chosen.values() if _is_plausible(base, one, law)]


def _is_plausible(base: Base, offer: Evidence, law: Signature) -> bool:
    """Say whether an effect acts where a law is, and with no value that is larger than any in nature."""
    places, own = _sensors_of(law, effect_named(offer.effect), base), sensors_of(places_of(offer.form))
    if places and ALL not in own and places.isdisjoint(own):
        return False
    if not isinstance(offer.form, Hypothesis):
        return True
    fitted = Part.at(base, offer.form).fitted(offer.form.terms)
    return offer.form.effect.oversize(base.channels.covariates, fitted) is None
