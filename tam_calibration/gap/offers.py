"""The effects that may explain a law, each in its likeliest form."""

from collections.abc import Callable, Collection, Iterator, Sequence
from math import exp

from tam_calibration.effects.effect import Effect, Finding, FoundEffect, LinearEffect
from tam_calibration.effects.grades import MINOR, MOST
from tam_calibration.effects.library import effect_named, installed_effects
from tam_calibration.effects.states import Times
from tam_calibration.gap.hypothesis import EVERYWHERE, Hypothesis, Part, given_form, places_of, sensors_of
from tam_calibration.gap.laws.law import ATTITUDE, FREE, SCALAR, Signature, acts_at, makes, may_make
from tam_calibration.gap.laws.scatter import repeated
from tam_calibration.gap.laws.signature import Law
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import Base
from tam_calibration.gap.result import Considered
from tam_calibration.gap.size import Evidence, evidence_of, examine, sharpened, unusable
from tam_calibration.gap.steps import LEAST_EVIDENCE, MOST_CAUSES, Step, is_new, special_case
from tam_calibration.model.fitted_effect import ALL
from tam_calibration.model.fitted_effect import SCALAR as SCALAR_ROW


class Offers:
    """The effects of the library that a recording can show, and what was found of each.

    Parameters
    ----------
    nominal : Model
        Before any cause.
    without : collection of str
        Names of effects that are not named as causes.
    tell : callable
        Called with the name of an effect and the part of the search that is done.

    Attributes
    ----------
    weighed : dict of str to Evidence
        For the effects that were examined at the nominal model.
    """

    def __init__(self, nominal: Model, without: Collection[str], tell: Callable[[str, float], None]) -> None:
        self._gross, self._tell = nominal.gross, tell
        channels = nominal.base().channels
        every = installed_effects()
        effects = {name: effect for name, effect in every.items() if name not in without}
        reasons = {name: unusable(one, channels.recording, channels.covariates) for name, one in effects.items()}
        self._reasons = {name: reason for name, reason in reasons.items() if reason is not None}
        self._effects = {name: effect for name, effect in effects.items() if name not in self._reasons}
        self._left_out = [effect for name, effect in every.items() if name in without]
        self.weighed: dict[str, Evidence] = {}

    def considered(self, laws: Sequence[Law]) -> tuple[Considered, ...]:
        """Return why the effects without evidence are no causes, with the laws of the gap."""
        strongest = laws[0].signature.law.replace("_", " ") if laws else ""
        why = f"the gap is a law of {strongest}, which only other effects make" if laws else "no law of a gap was found"
        others = {name: Considered(name, "not_supported", why) for name in self._effects.keys() - self.weighed.keys()}
        return tuple((others | self._reasons).values())

    def of(self, base: Base, law: Law, steps: Sequence[Step]) -> Iterator[list[Evidence]]:
        """Yield the effects that make a law, then others that explain as much; in each list the likeliest first.

        A free course imitates what follows a slow motion: then others are tried too. Those of which the readings are
        proof, such as many at the end of a range, come before all.

        Parameters
        ----------
        base : Base
            Of the model with the causes that are known.
        law : Law
        steps : sequence of Step
            These causes.
        """
        signature, times = law.signature, _times_of(law)
        others = {name: one for name, one in self._effects.items() if not makes(name, signature)}

        def explaining(names: Sequence[str]) -> list[Evidence]:
            found = self._examined(base, names, signature, times, steps)
            return [one for one in found if 1 - exp(-one.gain / base.channels.count) > (1 - MINOR) * law.part]

        proven = explaining([name for name, one in others.items() if isinstance(one, FoundEffect) and one.is_certain])
        makers = [name for name in self._effects if may_make(name, signature)]
        own = self._examined(base, makers, signature, times, steps)
        # What predicts a part of a noise is preferred to more variance.
        yield sorted(
            [*proven, *own],
            key=lambda one: (not one.is_certain, isinstance(one.form, Finding) and one.form.is_variance),
        )
        if law.found and signature.course in FREE:
            yield explaining([name for name, one in others.items() if isinstance(one, LinearEffect)])

    def special_cases(self, base: Base, law: Law, accepted: Evidence) -> list[Evidence]:
        """Return the evidence for effects that were left out and are special cases of an accepted one.

        Parameters
        ----------
        base : Base
            Of the model without the accepted effect.
        law : Law
            That it explains.
        accepted : Evidence
            For the accepted effect.
        """
        channels = base.channels
        found = [
            examine(base, effect, sensors_for(effect, law.signature, base), _times_of(law))
            for effect in self._left_out
            if isinstance(effect, LinearEffect)
            and effect.is_within(accepted.effect)
            and unusable(effect, channels.recording, channels.covariates) is None
        ]
        return [one for one in found if isinstance(one, Evidence)]

    def _examined(
        self, base: Base, names: Sequence[str], law: Signature, times: Times, steps: Sequence[Step]
    ) -> list[Evidence]:
        """Return the evidence for effects that are new, the most first."""
        found = []
        for number, name in enumerate(names):
            self._tell(name, (len(steps) + number / len(names)) / (MOST_CAUSES + 1))
            effect = self._effects[name]
            if not steps and self._gross is not None and self._gross.effect == name:
                assert isinstance(effect, LinearEffect)
                evidence: Evidence | str = evidence_of(base, given_form(base, effect, self._gross))
            else:
                evidence = examine(base, effect, sensors_for(effect, law, base), times)
            if isinstance(evidence, str):
                self._reasons.setdefault(name, Considered(name, "not_supported", evidence))
                continue
            if not steps:
                self.weighed[name] = evidence
            if evidence.delta_bic > LEAST_EVIDENCE and is_new(evidence, steps, base):
                found.append(evidence)
        sharp = sharpened(base, found)
        if not steps:
            self.weighed |= {one.effect: one for one in sharp}
        return sorted(sharp, key=lambda one: -one.delta_bic)


def _times_of(law: Law) -> Times:
    """Return the times at which a law may come and go, where its course is free."""
    return law.times() if law.signature.course in FREE else ()


def candidates(base: Base, offers: Sequence[Evidence], law: Signature) -> list[Evidence]:
    """Return the first of some offers, or special cases of them, that may explain a law; each effect once."""
    chosen = {one.effect: one for one in (special_case(offer, offers) for offer in offers[:4])}
    return [one for one in chosen.values() if is_plausible(base, one, law)]


def is_plausible(base: Base, offer: Evidence, law: Signature) -> bool:
    """Say whether an effect acts where a law is, and with no value that is larger than any in nature."""
    places, own = sensors_for(effect_named(offer.effect), law, base), sensors_of(places_of(offer.form))
    if places and ALL not in own and places.isdisjoint(own):
        return False
    if not isinstance(offer.form, Hypothesis):
        is_there = not places or ALL in own or own <= places
        return is_there and not (effect_named(offer.effect).is_of_lone_samples and _is_repeated(base, offer.form))
    fitted = Part.at(base, offer.form).fitted(offer.form.terms)
    return offer.form.effect.oversize(base.channels.covariates, fitted) is None


def _is_repeated(base: Base, form: Finding) -> bool:
    """Say whether most of the samples that a finding flags repeat the reading before, or lie on a line."""
    held = repeated(base.channels.recording.readings_T)
    return form.flagged is not None and bool(held[form.flagged].any(axis=1).mean() > MOST)


def sensors_for(effect: Effect, law: Signature, base: Base) -> frozenset[int]:
    """Return the sensors in which an effect may make a law, as effects count them; empty where that is everywhere."""
    sensors = {one for place in law.places for one in place}
    every = set(range(1, base.channels.recording.sensor_count + 1))
    acts_there = any(acts_at(effect.name, place) for place in law.places)
    if ATTITUDE[0] in sensors or sensors >= every or not acts_there:
        return EVERYWHERE
    return frozenset(SCALAR_ROW if one == SCALAR[0] else int(one) - 1 for one in sensors)
