"""The search for the causes of a gap: for each law, the strongest first, an effect that leaves nothing of it.

Noise comes after the other laws in its sensors. The effects that may explain a law are offered each in its likeliest
form.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from functools import reduce
from math import exp
from weakref import WeakKeyDictionary

import numpy as np

from tam_calibration.effects.covariates import Covariates, to_world
from tam_calibration.effects.effect import Effect, Finding, FoundEffect, LinearEffect
from tam_calibration.effects.grades import MINOR, MOST, NEARLY_ALL, NOTABLE, SLIGHT
from tam_calibration.effects.library import effect_named, installed_effects
from tam_calibration.effects.states import Times
from tam_calibration.gap.causes import sensors_and_axes
from tam_calibration.gap.floor import repeated
from tam_calibration.gap.hypothesis import EVERYWHERE, Hypothesis, Part, places_of, sensors_of
from tam_calibration.gap.laws.decisions import LEAST_SHARE
from tam_calibration.gap.laws.find import repeats
from tam_calibration.gap.laws.law import ATTITUDE, FREE, SCALAR, Place, Signature, acts_at, makes, may_make, usual_law
from tam_calibration.gap.laws.signature import Law, laws_of
from tam_calibration.gap.laws.whitened import Residual, residual_of
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import Base
from tam_calibration.gap.result import Considered
from tam_calibration.gap.size import Evidence, examine, sharpened, unusable
from tam_calibration.gap.steps import LEAST_EVIDENCE, MOST_CAUSES, Search, Step, absorbed, is_new, special_case
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import ALL
from tam_calibration.model.fitted_effect import SCALAR as SCALAR_ROW
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray


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
        self._tell = tell
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
            return [one for one in found if _part_of(one, base) > (1 - MINOR) * law.part]

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

    def special_cases(
        self, base: Base, general: str, law: Signature, times: Times, are_left_out: bool
    ) -> list[Evidence]:
        """Return the evidence for special cases of an effect.

        Parameters
        ----------
        base : Base
            Of the model without the effect.
        general : str
            Name of the effect.
        law : Signature
            That it explains.
        times : tuple of tuple of float
            At which they may come and go, seconds.
        are_left_out : bool
            Whether to return those that are not named as causes, in place of the others.
        """
        channels = base.channels
        found = [
            examine(base, effect, sensors_for(effect, law, base), times)
            for effect in (self._left_out if are_left_out else self._effects.values())
            if isinstance(effect, LinearEffect)
            and effect.is_within(general)
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
    """Return the first of some offers that may explain a law, each effect once.

    A plausible special case of an offer comes in its place or, where it explains less, before it.
    """
    plausible = [one for one in offers if is_plausible(base, one, law)]
    pairs = [(special_case(offer, plausible), offer) for offer in offers[:4]]
    more = [offer for special, offer in pairs if special.gain < NEARLY_ALL * offer.gain]
    chosen = {one.effect: one for one in (*(special for special, _ in pairs), *more)}
    return [one for one in chosen.values() if one in plausible]


def is_plausible(base: Base, offer: Evidence, law: Signature) -> bool:
    """Say whether an effect acts where a law is, and with no value that is larger than any in nature."""
    places, own = sensors_for(effect_named(offer.effect), law, base), sensors_of(places_of(offer.form))
    if places and ALL not in own and places.isdisjoint(own):
        return False
    if not isinstance(offer.form, Hypothesis):
        is_there = not places or ALL in own or own <= places
        return is_there and not (effect_named(offer.effect).is_of_lone_samples and _is_repeated(base, offer.form))
    fitted = Part.at(base, offer.form).fitted(offer.form.terms)
    return offer.form.effect.is_natural(base.channels.covariates, fitted)


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


Progress = Callable[[str, float], None]


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
        Names of effects that are not named as causes.
    progress : callable, optional
        Called with the name of the stage and the part that is done, 0 to 1, which never falls.
    """
    furthest = 0.0

    def tell(what: str, part: float) -> None:
        """Tell the stage, and how far the search is: it may seek causes a second time, but does not go back."""
        nonlocal furthest
        furthest = max(furthest, part)
        if progress is not None:
            progress(what, furthest)

    tell("nominal calibration", 0.0)
    nominal = Model.nominal(recording, array)
    try:
        nominal = nominal.aligned()
    except InputError:  # an attitude that was written otherwise than expected, as a remark says
        nominal = replace(nominal, recording=replace(nominal.recording, attitude=None))
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
        self._offers = Offers(nominal, without, tell)
        self._steps: list[Step] = []
        self._laws = WeakKeyDictionary[Residual, tuple[Law, ...]]()
        self._open: list[Law] = []  # those that predict, and have no cause
        self._model = nominal

    def run(self) -> Search:
        """Return the causes of the laws, and what they leave."""
        self._tell("laws", 0.0)
        whole = residual_of(self._nominal)
        self._gap = self._modelled = whole.excess
        laws = self._laws_of(whole)
        remaining = self._explain_all(laws, set())
        remaining = self._reconsidered(remaining)
        pair = [one for one in laws if any(found.is_of_two for found in one.found)]
        is_in_one_place = all(set(one.signature.sensors) & set(pair[0].signature.sensors) for one in pair)
        two = {_key(one) for one in pair if is_in_one_place}
        without_cause = two & {_key(one) for one in self._open} & {_key(one) for one in remaining}
        if without_cause and two != without_cause:
            # Without a cause of one, the two may only imitate another law, and the cause of the other is doubtful.
            self._steps, self._model, self._open, self._modelled = [], self._nominal, pair, self._gap
            remaining = self._explain_all(laws, two)
        return Search(
            self._nominal,
            self._model,
            tuple(self._steps),
            laws,
            remaining,
            tuple(self._offers.weighed.values()),
            self._offers.considered(laws),
        )

    def _explain_all(self, laws: tuple[Law, ...], unexplained: "set[_Key]") -> tuple[Law, ...]:
        """Explain laws but for some, and those of what is left; return the laws that remain.

        A law without a cause is tried again beside each further cause: large laws hide what each other follows.
        """
        remaining, explained, tried, open_laws = laws, set[_Key](), unexplained, self._open
        while len(self._steps) < MOST_CAUSES:
            asked = [one for one in remaining if _key(one) not in tried and not self._is_small(one)]
            if not asked:
                break
            law = asked[0]
            if law.signature.law == "noise":  # more variance would take for noise what is beside it
                sensors = set(law.signature.sensors)
                law = next((one for one in asked if one.found and sensors & set(one.signature.sensors)), law)
            left = self._explain(law, [one for one in remaining if one is not law])
            if left is None:
                tried = tried | {_key(law)}
                self._open = [*self._open, law] if law.found else self._open
                continue
            explained.add(_key(law))
            tried, self._open = unexplained, open_laws
            self._tell("laws", len(self._steps) / (MOST_CAUSES + 1))
            remaining = tuple(one for one in self._laws_of(left) if _key(one) not in explained)
        return remaining

    def _laws_of(self, residual: Residual) -> tuple[Law, ...]:
        """Return the laws of what a model leaves; a second time as they were found before."""
        if residual not in self._laws:
            self._laws[residual] = laws_of(residual, self._gap)
        return self._laws[residual]

    def _is_small(self, law: Law) -> bool:
        """Say whether a law is too small to ask for a cause of it, mostly in sensors of a cause or of an open law.

        The models of causes are right to some per cent of what they explain; samples that are left out need no model.
        """
        known = [*(step.law for step in self._steps), *(one.signature for one in self._open)]
        least = LEAST_SHARE if law.signature.is_apart_from(known) else MINOR
        return bool(known) and law.signature.energy < least * self._modelled / self._gap

    def _reconsidered(self, remaining: tuple[Law, ...]) -> tuple[Law, ...]:
        """Replace causes by special cases that explain as much now that all causes are known; return what remains.

        A general effect also explains parts of laws whose causes are found after it.
        """
        for number, step in enumerate(self._steps if len(self._steps) > 1 else ()):
            form, forms = step.accepted.form, [one.accepted.form for one in self._steps]
            if not isinstance(form, Hypothesis):
                continue
            base = reduce(Model.accept, forms[:number] + forms[number + 1 :], self._nominal).base()
            general = examine(base, form.effect, frozenset(sensors_of(places_of(form))))
            offers = self._offers.special_cases(base, form.effect.name, step.law, (), False)
            if isinstance(general, str) or not offers:
                continue
            special = special_case(general, [one for one in offers if is_plausible(base, one, step.law)])
            forms[number] = special.form
            left = residual_of(reduce(Model.accept, forms, self._nominal))
            if special is not general and left.excess < residual_of(self._model).excess + LEAST_SHARE * self._gap:
                self._steps[number] = replace(step, accepted=special, law=step.law.as_made_by(special.effect))
                self._model = left.model
                keys = {_key(one) for one in remaining}
                remaining = tuple(one for one in self._laws_of(left) if _key(one) in keys)
        return remaining

    def _explain(self, law: Law, others: Sequence[Law]) -> Residual | None:
        """Accept the first effect that leaves nothing of a law; return what it leaves, or None without one."""
        base, first = self._model.base(), None
        for offers in self._offers.of(base, law, self._steps):
            possible = candidates(base, offers, law.signature)
            first = first or max(filter(_is_bound, possible), key=lambda one: one.gain, default=None)
            for number, one in enumerate(possible):
                if (left := self._left_by([one], law, others)) is not None:
                    rest = [*possible[number + 1 :], *_at_times_of(one, offers)]
                    rest += self._offers.special_cases(base, one.effect, law.signature, _times_of(law), True)
                    as_good = [
                        other.effect
                        for other in rest
                        if _is_near(other, one) and self._left_by([other], law, others) is not None
                    ]
                    return self._accept([one], left, law, as_good)
            for one in possible:
                chain = [one]
                while (again := self._repeated(chain, law)) is not None:
                    chain.append(again)
                    if (left := self._left_by(chain, law, others)) is not None:
                        return self._accept(chain, left, law, ())
        return self._explain_by_two(first, law, others) if first else None

    def _explain_by_two(self, first: Evidence, law: Law, others: Sequence[Law]) -> Residual | None:
        """Accept two effects that together leave nothing of a law with a free course; None where there are none.

        Such a course imitates the sum of two effects. The second explains the law that the first leaves. Effects that
        are free in time imitate others and are not tried.
        """
        is_large = _part_of(first, self._model.base()) > NOTABLE * law.part
        is_free = bool(law.found) and law.signature.course in FREE - {"step"} and not law.signature.is_common
        if not (is_large and is_free) or len(self._steps) + 2 > MOST_CAUSES:
            return None
        model = self._with([first])
        left_by_first = residual_of(model)
        second = next((one for one in laws_of(left_by_first, self._gap, most=1) if one.found), None)
        part = 0.0 if second is None else second.signature.energy / law.signature.energy
        if second is None or second.signature.course in FREE or not MINOR <= part <= 1 - NOTABLE:
            return None
        steps = [*self._steps, Step(first, law.signature)]
        offers = next(self._offers.of(model.base(), second, steps))
        for one in candidates(model.base(), offers, second.signature):
            if not _is_bound(one) or one.effect == first.effect:
                continue
            if (left := self._left_by([first, one], law, others)) is not None:
                self._accept([first], left_by_first, law, ())
                return self._accept([one], left, second, ())
        return None

    def _left_by(self, chain: Sequence[Evidence], law: Law, others: Sequence[Law]) -> Residual | None:
        """Return the residual beside an effect, or several forms of it; None where it leaves something of a law."""
        model = self._with(chain)
        left = residual_of(model)
        form = chain[-1].form
        if not isinstance(form, Hypothesis):
            return None if self._takes_law(form, law) else left
        channels, part = model.base().channels, model.parts[-1]
        if not part.effect.is_natural(channels.covariates, part.fitted(part.terms(channels))):
            return None
        is_gone = self._is_gone(law, others, left, part.effect) and not _is_open_at_poses(
            part.effect, self._model, model
        )
        return left if is_gone else None

    def _takes_law(self, form: Finding, law: Law) -> bool:
        """Say whether a variance would take for noise a law that predicts, or what a larger open one leaves."""
        larger = (one.signature for one in self._open if one.signature.energy > law.signature.energy)
        is_open = any(not set(one.sensors).isdisjoint(law.signature.sensors) for one in larger)
        return form.is_variance and (bool(law.found) or is_open)

    def _accept(self, chain: Sequence[Evidence], left: Residual, law: Law, as_good: Sequence[str]) -> Residual:
        """Accept an effect, or several forms of it, and return the residual that they leave."""
        accepted = list[Evidence]()
        for one in chain:
            accepted.append(absorbed(one, self._steps))
            form, made = accepted[-1].form, law.signature.as_made_by(one.effect)
            # Samples that are far off by much are so by little in all sensors: the law tells where they are.
            if isinstance(form, Hypothesis) or ALL not in sensors_of(places_of(form)):
                made = made.at_place(*sensors_and_axes(places_of(form), self._model.recording))
            self._steps.append(Step(accepted[-1], made, tuple(dict.fromkeys(as_good))))
            if isinstance(form, Finding) and form.flagged is not None:
                self._modelled -= residual_of(self._model).excess - left.excess
        self._model = left.model if accepted == chain else self._with(accepted)
        return left

    def _with(self, chain: Sequence[Evidence]) -> Model:
        """Return the model with further causes."""
        return reduce(Model.accept, (one.form for one in chain), self._model)

    def _is_gone(self, law: Law, others: Sequence[Law], left: Residual, effect: LinearEffect) -> bool:
        """Say whether a model with an effect leaves too little of a law; less than most of one that predicts nothing.

        More may be left of a law that another law makes: a free course also follows the errors of the effect's model,
        which an effect that is free in time does not have.

        Such a law is left by a model that explains less than half of its energy.
        """
        if law.found:
            is_exact = effect.is_free_in_time or makes(effect.name, law.signature)
            return law.is_gone_from(left, others, LEAST_SHARE if is_exact else MINOR)
        if law.whole is not None and law.whole.excess - left.excess < (1 - MOST) * law.signature.energy * self._gap:
            return False
        sensors = set(law.signature.sensors)
        there = (one.signature for one in self._laws_of(left) if not sensors.isdisjoint(one.signature.sensors))
        return sum(one.energy for one in there) < MOST * law.signature.energy

    def _repeated(self, chain: Sequence[Evidence], law: Law) -> Evidence | None:
        """Return the next form of an effect that may happen more than once; None without evidence for it."""
        effect = effect_named(chain[0].effect)
        is_staircase = len(chain) > 1 and law.signature.course == "slow"  # three steps or more imitate it
        if not effect.may_repeat or is_staircase or len(self._steps) + len(chain) == MOST_CAUSES:
            return None
        model = self._with(chain)
        base = model.base()
        steps = [*self._steps, *(Step(one, law.signature) for one in chain)]
        again = examine(base, effect, sensors_for(effect, law.signature, base), law.times(residual_of(model)))
        if isinstance(again, str) or again.delta_bic < LEAST_EVIDENCE or not is_new(again, steps, base):
            return None
        return again if is_plausible(base, again, law.signature) else None


def _part_of(one: Evidence, base: Base) -> float:
    """Return the part of the residual's energy, with that of the noise, that an effect explains."""
    return 1 - exp(-one.gain / base.channels.count)


def _is_bound(one: Evidence) -> bool:
    """Say whether an effect is a function of what was recorded, and not of any time."""
    return isinstance(one.form, Hypothesis) and not one.form.effect.is_free_in_time


_Key = tuple[str, Place]


def _key(law: Law) -> _Key:
    return law.signature.law, law.signature.sensors


def _is_open_at_poses(effect: LinearEffect, before: Model, after: Model) -> bool:
    """Say whether poses that are taken up again speak against an effect without a recorded channel.

    What the motion makes is the same at both visits to a pose, and leaves little that is, beside what it explains; what
    goes with its rate may leave more. What depends on the time or on the way to a pose is not: else it imitates some
    function of the pose.
    """
    channels = [model.base().channels for model in (before, after)]
    again = None if effect.channels else repeats(pose_of(channels[0].covariates))
    if again is None:
        return False
    first, last = (
        np.column_stack([one.differential, np.sqrt(one.precision) * one.intensity_residual_T]) for one in channels
    )
    if (effect.is_free_in_time or effect.has_memory) and again.are_same(first - last):
        return True
    part = NOTABLE if usual_law(effect.name) == "rate" else SLIGHT
    least = max(part * again.energy(first), MINOR * float(np.mean(np.sum((first - last) ** 2, axis=1))))
    return not effect.is_free_in_time and again.energy(last) > least


def _at_times_of(accepted: Evidence, offers: Sequence[Evidence]) -> list[Evidence]:
    """Return the other effects that come and go with an accepted one, as leakage does with a gain."""
    form = accepted.form
    if not isinstance(form, Hypothesis) or not form.effect.is_free_in_time:
        return []
    return [
        one
        for one in offers
        if one.effect != accepted.effect
        and isinstance(one.form, Hypothesis)
        and one.form.shape.items() & form.shape.items()
    ]


def _is_near(other: Evidence, accepted: Evidence) -> bool:
    """Say whether an effect has about the evidence of an accepted one."""
    return other.delta_bic > accepted.delta_bic - LEAST_EVIDENCE or other.gain > NEARLY_ALL * accepted.gain


def pose_of(covariates: Covariates) -> FloatArray:
    """Return the axes of the array in the world (N, 9), or without attitude the field's direction in the array."""
    if covariates.attitude is None:
        return covariates.direction
    return to_world(covariates).reshape(covariates.sample_count, 9)
