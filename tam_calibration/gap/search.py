"""The search for the causes of a gap: forward selection, the strongest first, then backward elimination."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import log

from tam_calibration.effects.effect import Effect, LinearEffect
from tam_calibration.effects.excess_variance import LARGEST_NOISE
from tam_calibration.effects.grades import MINOR, NOTABLE, SLIGHT
from tam_calibration.effects.library import installed_effects
from tam_calibration.gap import support
from tam_calibration.gap.hypothesis import Hypothesis, given_form, places_of, restricted, sensors_of
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import Base
from tam_calibration.gap.result import Considered
from tam_calibration.gap.size import Evidence, certain_noise, evidence_of, examine, rivals, sharpened, usable
from tam_calibration.gap.surrogates import SurrogateTest
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording

Progress = Callable[[str, float], None]

LARGEST_REST = 1.0
"""Residual, in noise floors, that causes may leave: a larger one is a gap of its own."""

_MOST_CAUSES = 4
"""Causes of one gap, at most: more cannot be told apart."""

_STARTS = 2
"""Further effects from which a search starts, at most."""


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Causes that hold, the model with them, the rivals at that model, and its log-evidence (-BIC)."""

    first: Evidence | None
    steps: tuple[support.Step, ...]
    model: Model
    remaining: tuple[Evidence, ...]
    evidence: float
    is_clean: bool


class CauseSearch:
    """Searches at one nominal model."""

    def __init__(self, nominal: Model, without: Collection[str], tell: Progress) -> None:
        self.nominal, self._tell = nominal, tell
        self.first_base = nominal.base()
        self._effects, missing = usable(installed_effects(), without, self.first_base.channels)
        self._considered = {one.effect: one for one in missing}
        self._known: dict[tuple[Evidence, ...], tuple[Model, Base]] = {}

    @property
    def gross(self) -> Evidence | None:
        """The jump that was found before any calibration, where there is one."""
        jump = self.nominal.gross
        effect = None if jump is None else self._effects.get(jump.effect)
        if jump is None or not isinstance(effect, LinearEffect):
            return None
        return evidence_of(self.first_base, given_form(self.first_base, effect, jump))

    @property
    def considered(self) -> tuple[Considered, ...]:
        """Hypotheses without evidence."""
        return tuple(self._considered.values())

    @cached_property
    def weighed(self) -> tuple[Evidence, ...]:
        """The evidence for each effect at the nominal model."""
        return self._weigh(self.first_base, 0, self._effects)

    def found(self, first: Evidence | None) -> SearchResult:
        """Return the causes that hold of those found from a start, or from the strongest."""
        steps = self._forward([], first, ())
        held = self._beside_held(steps)
        causes = self._holding(self._swapped(held)) or held
        model, base = self._beside(causes)
        unknown, count = rivals(base), base.channels.count
        spent = base.rank - self.first_base.rank + sum(finding.parameter_count for finding in model.findings)
        evidence = -count * log(base.energy / count) - spent * log(count)
        is_small = base.energy < (1 + LARGEST_REST**2) * count
        is_clean = bool(causes or not steps) and is_small and support.open_part(self.first_base, base, unknown) < MINOR
        return SearchResult(steps[0].accepted if steps else None, tuple(causes), model, unknown, evidence, is_clean)

    def other_starts(self, found: SearchResult) -> Iterator[Evidence]:
        """Yield other starts where a gap remains: the first cause at one sensor only, and the next effects."""
        first = found.first
        if found.is_clean or first is None or first.is_certain or self.nominal.gross is not None:
            return
        ranked = sorted(self.weighed, key=lambda one: -one.delta_bic)
        others = [one for one in ranked if one is not first and one.delta_bic > NOTABLE * first.delta_bic]
        starts = [self._alone(one) or one for one in others[:_STARTS]]
        alone = self._alone(first)
        base = self.first_base
        for one in (alone, *starts):
            if one is not None and support.is_new(one, (), base) and support.support_of(base, one)[0]:
                yield one

    def _weigh(self, base: Base, depth: int, effects: Mapping[str, Effect]) -> tuple[Evidence, ...]:
        weighed = []
        for number, (name, effect) in enumerate(effects.items()):
            self._tell(name, (depth + number / len(effects)) / (_MOST_CAUSES + 1))
            found = examine(base, effect)
            if isinstance(found, Evidence):
                weighed.append(found)
            elif depth == 0:
                self._considered[name] = Considered(name, "not_supported", found)
        return sharpened(base, weighed)

    def _beside_held(self, steps: Sequence[support.Step]) -> list[support.Step]:
        """Return the causes that hold, and those found beside them in place of causes that do not."""
        held, passed_over = self._holding(steps), set[str]()
        while held and len(held) < len(steps):
            passed_over |= {step.accepted.effect for step in steps if step not in held}
            steps = self._forward(held, None, passed_over)
            more = self._holding(steps)
            if len(more) <= len(held):
                break
            held = more
        return held

    def _forward(
        self, known: Sequence[support.Step], first: Evidence | None, without: Collection[str]
    ) -> list[support.Step]:
        """Accept causes beside known ones, the strongest first; a given first one before all."""
        steps = list(known)
        weighed = self.weighed
        least = SLIGHT * self._visible()
        while len(steps) < _MOST_CAUSES:
            base = self._beside(steps)[1]
            if steps:
                # Effects are modelled to some per cent: less energy may be the modelling error of known causes.
                least = max(min(least, LARGEST_REST**2 * base.channels.count), SLIGHT**2 * self._visible())
                if base.energy < least:  # No cause can explain more than the residual energy.
                    return steps
                if base.energy - certain_noise(base.channels) < least and not self._is_found(
                    base, steps, without, least
                ):
                    return steps
                weighed = self._weigh(base, len(steps), self._effects)
            given = (first, support.support_of(base, first)[1]) if first is not None and not steps else None
            found = given or support.supported(
                base, [one for one in weighed if one.effect not in without], steps, least
            )
            if found is None:
                return steps
            accepted, surrogate_test = found
            steps.append(support.Step(support.absorbed(accepted, steps), weighed, surrogate_test))
        return steps

    def _is_found(self, base: Base, steps: Sequence[support.Step], without: Collection[str], least: float) -> bool:
        """Whether an effect is supported that no regression finds, and that therefore may explain noise too."""
        effects = {name: effect for name, effect in self._effects.items() if not isinstance(effect, LinearEffect)}
        weighed = self._weigh(base, len(steps), effects)
        return support.supported(base, [one for one in weighed if one.effect not in without], steps, least) is not None

    def _visible(self) -> float:
        """Return the energy of the gap: the most that any hypothesis explains, or the excess over the largest noise."""
        base = self.first_base
        explained = max((support.energy_explained(one, base) for one in (*self.weighed, *rivals(base))), default=0.0)
        return max(explained, base.energy - LARGEST_NOISE**2 * base.channels.count)

    def _beside(self, steps: Sequence[support.Step], step: support.Step | None = None) -> tuple[Model, Base]:
        """Return the model with all causes, or all but one, and its base."""
        return self._fitted(tuple(other.accepted for other in steps if other is not step))

    def _fitted(self, causes: tuple[Evidence, ...]) -> tuple[Model, Base]:
        """Return the model with some causes, and its base; only the last few are cached, as they take much memory."""
        fit = self._known.pop(causes) if causes in self._known else self._fit(causes)
        if len(self._known) == _MOST_CAUSES:
            del self._known[next(iter(self._known))]
        self._known[causes] = fit
        return fit

    def _fit(self, causes: tuple[Evidence, ...]) -> tuple[Model, Base]:
        if not causes:
            return self.nominal, self.first_base
        model = self._fitted(causes[:-1])[0].accept(causes[-1].form)
        return model, model.base()

    def _holding(self, steps: Sequence[support.Step]) -> list[support.Step]:
        """Return the causes that are still supported beside all others, dropping the weakest first."""
        kept = list(steps)
        while True:
            weakest_first = sorted(kept, key=lambda step: step.accepted.gain)
            failing = next((step for step in weakest_first if not self._holds(kept, step)), None)
            if failing is None:
                return kept
            kept.remove(failing)

    def _holds(self, steps: Sequence[support.Step], step: support.Step) -> bool:
        base = self._beside(steps, step)[1]
        return support.holds(base, step.accepted)

    def _swapped(self, steps: Sequence[support.Step]) -> list[support.Step]:
        """Return the causes, each replaced by the effect and form with the most evidence beside the others."""
        kept = list(steps)
        if len(kept) < 2 and self.nominal.gross is not None:
            return kept
        for index, step in enumerate(kept):
            if isinstance(step.accepted.form, Hypothesis):
                kept[index] = self._chosen_again(step, [one for one in kept if one is not step])
        return kept

    def _chosen_again(self, step: support.Step, rest: Sequence[support.Step]) -> support.Step:
        """Return the cause, or another that has more evidence beside the rest and exceeds its surrogates by more."""
        base, own = self._beside(rest)[1], step.accepted.effect
        others = {one.accepted.effect for one in rest}
        names = [
            one.effect
            for one in (*step.weighed, step.accepted)
            if isinstance(one.form, Hypothesis)
            and one.delta_bic > max(support.LEAST_EVIDENCE, NOTABLE * step.accepted.delta_bic)
            and (one.effect not in others or one.effect == own)
        ]
        offers = [examine(base, self._effects[name]) for name in dict.fromkeys(names)]
        sharp = sharpened(base, [offer for offer in offers if isinstance(offer, Evidence)])
        fitting = [offer for offer in sharp if support.is_new(offer, rest, base)]
        same = next((offer for offer in fitting if offer.effect == own), None)
        if same is None:
            return step

        def surrogate_test_of(offer: Evidence) -> tuple[bool, SurrogateTest | None]:
            is_held, surrogate_test = support.support_of(base, offer)
            return is_held or offer is same, surrogate_test

        best, most = same, support.beyond_surrogates(same, surrogate_test_of(same)[1])
        for offer in fitting:
            if offer.delta_bic > same.delta_bic and offer.gain > most:
                is_held, surrogate_test = surrogate_test_of(offer)
                beyond = support.beyond_surrogates(offer, surrogate_test)
                best, most = (offer, beyond) if is_held and beyond > most else (best, most)
        nested = support.special_case(best, fitting)
        best = nested if surrogate_test_of(nested)[0] else best
        return support.Step(best, step.weighed, step.surrogate_test if best is same else surrogate_test_of(best)[1])

    def _alone(self, one: Evidence) -> Evidence | None:
        """Return the evidence for a hypothesis at its strongest sensor alone; None where it has one sensor only."""
        if not isinstance(one.form, Hypothesis):
            return None
        sensors = sensors_of(places_of(one.form))
        alone = [restricted(self.first_base, one.form, sensor) for sensor in sensors] if len(sensors) > 1 else []
        best = max((form for form in alone if form is not None), key=lambda form: form.selection.gain, default=None)
        return None if best is None else evidence_of(self.first_base, best)


@dataclass(frozen=True, eq=False)
class Search:
    """The whole search.

    Parameters
    ----------
    nominal, model : Model
        Before the causes, and with them.
    steps : tuple of Step
        The causes, in the order in which they were accepted.
    weighed, rivals : tuple of Evidence
        Evidence for effects, and for functions without physics, at the nominal model.
    remaining : tuple of Evidence
        Evidence for functions without physics beside the causes.
    considered : tuple of Considered
        Hypotheses without evidence.
    """

    nominal: Model
    model: Model
    steps: tuple[support.Step, ...]
    weighed: tuple[Evidence, ...]
    rivals: tuple[Evidence, ...]
    remaining: tuple[Evidence, ...]
    considered: tuple[Considered, ...]


def search(
    recording: Recording, array: Array, without: Collection[str] = (), progress: Progress | None = None
) -> Search:
    """Accept causes, the strongest first, until none has evidence; then drop those that do not hold.

    The strongest at first need not be a cause: an effect common to all sensors may imitate one at a single sensor and
    another at the scalar magnetometer. Where that may be, the search is repeated from other starts and the best result
    is taken; also from the calibration of a steady part, where that of the whole leaves gross residuals.

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
    cause_search = CauseSearch(Model.nominal(recording, array), frozenset(without), tell)
    best = _best(cause_search)
    if not best.is_clean and (steady := cause_search.nominal.steady()) is not None:
        again = CauseSearch(steady, frozenset(without), tell)
        there = _best(again)
        if not (best.steps or there.steps) or _rank(there) > _rank(best):
            cause_search, best = again, there
    unknown = rivals(cause_search.first_base)
    return Search(
        cause_search.nominal,
        best.model,
        best.steps,
        cause_search.weighed,
        unknown,
        best.remaining,
        cause_search.considered,
    )


def _best(cause_search: CauseSearch) -> SearchResult:
    """Return the best outcome of the starts at one nominal model."""
    best = cause_search.found(cause_search.gross)
    for start in cause_search.other_starts(best):
        if best.is_clean:
            break
        best = max(best, cause_search.found(start), key=_rank)
    return best


def _rank(outcome: SearchResult) -> tuple[bool, float]:
    return outcome.is_clean, outcome.evidence
