"""The effects that may explain a law, each in its likeliest form."""

from collections.abc import Callable, Collection, Iterator, Sequence

from tam_calibration.effects.effect import Effect, Finding, LinearEffect
from tam_calibration.effects.grades import MINOR
from tam_calibration.effects.library import effect_named, installed_effects
from tam_calibration.gap.hypothesis import EVERYWHERE, Hypothesis, given_form, places_of, sensors_of
from tam_calibration.gap.laws.causes import acts_at, makes, may_make
from tam_calibration.gap.laws.law import ATTITUDE, FREE, SCALAR, Signature
from tam_calibration.gap.laws.signature import Law
from tam_calibration.gap.model import Model
from tam_calibration.gap.part import Part
from tam_calibration.gap.regression import Base
from tam_calibration.gap.result import Considered
from tam_calibration.gap.size import Evidence, energy_explained, evidence_of, examine, sharpened, usable
from tam_calibration.gap.steps import LEAST_EVIDENCE, MOST_CAUSES, Step, is_new, special_case
from tam_calibration.model.fitted_effect import ALL
from tam_calibration.model.fitted_effect import SCALAR as SCALAR_ROW

_MOST_TRIED = 4
"""Effects that are fitted to explain one law, at most: those with the most evidence."""


class Offers:
    """The effects of the library that a recording can show, and what was found of each.

    Parameters
    ----------
    nominal : Model
        Before any cause.
    without : collection of str
        Names of effects that are not tried.
    tell : callable
        Called with the name of an effect and the part of the search that is done.
    """

    def __init__(self, nominal: Model, without: Collection[str], tell: Callable[[str, float], None]) -> None:
        self._gross, self._tell = nominal.gross, tell
        self._effects, missing = usable(installed_effects(), without, nominal.base().channels)
        self._reasons = {one.effect: one for one in missing}
        self._weighed: dict[str, Evidence] = {}

    @property
    def weighed(self) -> tuple[Evidence, ...]:
        """Evidence for the effects that were examined at the nominal model."""
        return tuple(self._weighed.values())

    def considered(self, laws: Sequence[Law]) -> tuple[Considered, ...]:
        """Return why the effects without evidence are no causes, with the laws of the gap."""
        strongest = laws[0].signature.law.replace("_", " ") if laws else ""
        why = f"the gap is a law of {strongest}, which it does not make" if laws else "no law of a gap was found"
        others = {name: Considered(name, "not_supported", why) for name in self._effects.keys() - self._weighed.keys()}
        return tuple((others | self._reasons).values())

    def of(self, base: Base, law: Law, steps: Sequence[Step]) -> Iterator[list[Evidence]]:
        """Yield the effects that make a law, then others that explain as much; in each list the likeliest first.

        A free course imitates what follows a slow motion: then others are tried too.

        Parameters
        ----------
        base : Base
            Of the model with the causes that are known.
        law : Law
        steps : sequence of Step
            These causes.
        """
        signature = law.signature
        own = [name for name in self._effects if may_make(name, signature)]
        # What predicts a part of a noise is preferred to more variance.
        found = self._examined(base, own, law, steps)
        yield sorted(
            found, key=lambda one: (not one.is_certain, isinstance(one.form, Finding) and one.form.is_variance)
        )
        if law.found and signature.course in FREE:
            others = [name for name in self._effects if not makes(name, signature)]
            least = (1 - MINOR) * law.part * base.energy
            yield [
                one
                for one in self._examined(base, others, law, steps)
                if (isinstance(one.form, Hypothesis) or one.is_certain) and energy_explained(one, base) > least
            ]

    def _examined(self, base: Base, names: Sequence[str], law: Law, steps: Sequence[Step]) -> list[Evidence]:
        """Return the evidence for effects that are new, the most first."""
        found = []
        for number, name in enumerate(names):
            self._tell(name, (len(steps) + number / len(names)) / (MOST_CAUSES + 1))
            evidence = self._evidence(base, self._effects[name], law, is_first=not steps)
            if evidence is not None and evidence.delta_bic > LEAST_EVIDENCE and is_new(evidence, steps, base):
                found.append(evidence)
        sharp = sharpened(base, found)
        if not steps:
            self._weighed |= {one.effect: one for one in sharp}
        return sorted(sharp, key=lambda one: -one.delta_bic)

    def _evidence(self, base: Base, effect: Effect, law: Law, is_first: bool) -> Evidence | None:
        jump = self._gross
        if is_first and jump is not None and jump.effect == effect.name and isinstance(effect, LinearEffect):
            return evidence_of(base, given_form(base, effect, jump))
        times = law.times if law.signature.course in FREE else ()
        evidence = examine(base, effect, sensors_for(effect, law.signature, base), times)
        if isinstance(evidence, str):
            self._reasons.setdefault(effect.name, Considered(effect.name, "not_supported", evidence))
            return None
        if is_first:
            self._weighed[effect.name] = evidence
        return evidence


def candidates(base: Base, offers: Sequence[Evidence], law: Signature) -> list[Evidence]:
    """Return the first of some offers, or special cases of them, that may explain a law; each effect once."""
    chosen = {one.effect: one for one in (special_case(offer, offers) for offer in offers[:_MOST_TRIED])}
    return [one for one in chosen.values() if is_plausible(base, one, law)]


def is_plausible(base: Base, offer: Evidence, law: Signature) -> bool:
    """Say whether an effect acts where a law is, and with no value that is larger than any in nature."""
    places, own = sensors_for(effect_named(offer.effect), law, base), sensors_of(places_of(offer.form))
    if places and ALL not in own and places.isdisjoint(own):
        return False
    if not isinstance(offer.form, Hypothesis):
        return True
    fitted = Part.at(base, offer.form).fitted(offer.form.terms)
    return offer.form.effect.oversize(base.channels.covariates, fitted) is None


def sensors_for(effect: Effect, law: Signature, base: Base) -> frozenset[int]:
    """Return the sensors in which an effect may make a law, as effects count them; empty where that is everywhere."""
    sensors = {one for place in law.places for one in place}
    every = set(range(1, base.channels.recording.sensor_count + 1))
    acts_there = any(acts_at(effect.name, place) for place in law.places)
    if ATTITUDE[0] in sensors or sensors >= every or not acts_there:
        return EVERYWHERE
    return frozenset(SCALAR_ROW if one == SCALAR[0] else int(one) - 1 for one in sensors)
