"""Names held against the law of the gap: a cause whose signature is another one is not named, or is doubted."""

from collections.abc import Collection, Sequence
from dataclasses import replace

from tam_calibration.gap.hypothesis import places_of, sensors_of
from tam_calibration.gap.laws.causes import acts_at, agrees
from tam_calibration.gap.laws.law import SCALAR, Place, Signature
from tam_calibration.gap.result import Cause, Considered, Gap
from tam_calibration.gap.search import Search
from tam_calibration.gap.size import rivals
from tam_calibration.model.fitted_effect import SCALAR as SCALAR_ROW

_FREE = ("random", "slow")
"""Courses of an offset or a gain that imitate any function of motion or time: they contradict no cause."""

_PREDICT_NOTHING = ("noise", "samples")
"""Laws that do the same."""

_DECISIVE = 0.6
"""Share of the gap that laws explain, at least, where they contradict a cause."""


def contradicted(found: Search, laws: Sequence[Signature]) -> tuple[str, ...]:
    """Return the effects named by a search that can make none of the laws, where these explain most of the gap."""
    sure = [law for law in laws if law.law not in _PREDICT_NOTHING and not _is_free(law)]
    if sum(law.energy for law in sure) < _DECISIVE:
        return ()
    return _disagreeing(found, laws)


def _is_free(law: Signature) -> bool:
    return law.law in ("offset", "gain") and law.course in _FREE


def doubted(found: Search, laws: Sequence[Signature]) -> tuple[str, ...]:
    """Return the effects named by a search that can make none of the laws."""
    return _disagreeing(found, laws) if laws else ()


def misplaced(found: Search, laws: Sequence[Signature]) -> tuple[str, ...]:
    """Return the effects named by a search that are not where the law is: in the scalar, or not in the scalar."""
    sensors = [(step.accepted.effect, sensors_of(places_of(step.accepted.form))) for step in found.steps]
    is_of_scalar = {law.places for law in laws} == {(SCALAR,)} and laws[0].energy >= _DECISIVE
    names = [name for name, own in sensors if own == {SCALAR_ROW} and not acts_at(name, _place_of(name, laws, SCALAR))]
    names += [name for name, own in sensors if is_of_scalar and SCALAR_ROW not in own]
    return tuple(dict.fromkeys(names))


def _place_of(effect: str, laws: Sequence[Signature], default: Place) -> Place:
    """Return the likeliest place of the strongest law of the intensity that an effect can make."""
    return next((law.places[0] for law in laws if law.is_common and agrees(effect, [law])), default)


def placed(gap: Gap, laws: Sequence[Signature], places: Sequence[Place]) -> Gap:
    """Return a gap that only the residual of the intensity shows at the likeliest of its places, and so its causes.

    Parameters
    ----------
    gap : Gap
        With its causes.
    laws : sequence of Signature
        The strongest first.
    places : sequence of Place
        Of the strongest law, or of the gap.
    """
    causes = tuple(_moved(one, _place_of(one.fitted.effect, laws, places[0])) for one in gap.causes)
    sensors = {sensor for one in causes for sensor in one.sensors} or set(places[0])
    axes = () if sensors == set(places[0]) else gap.where.axes
    where = replace(gap.where, sensors=tuple(sorted(sensors, key=str)), axes=axes)
    return replace(gap, causes=causes, where=where)


def _moved(cause: Cause, place: Place) -> Cause:
    """Return a cause that acts on the scalar at another place in which it may act."""
    is_there = "scalar" in cause.sensors and acts_at(cause.fitted.effect, place)
    return replace(cause, sensors=place, axes=()) if is_there else cause


def _disagreeing(found: Search, laws: Sequence[Signature]) -> tuple[str, ...]:
    named = dict.fromkeys(step.accepted.effect for step in found.steps)
    return tuple(name for name in named if not agrees(name, laws))


def without_causes(found: Search, names: Collection[str]) -> Search:
    """Return a search without some of its causes, the others fitted again."""
    steps = tuple(step for step in found.steps if step.accepted.effect not in names)
    if not steps:
        return replace(found, steps=(), model=found.nominal, remaining=found.rivals)
    parts = tuple(part for part in found.model.parts if part.effect.name not in names)
    findings = tuple(one for one in found.model.findings if one.fitted.effect not in names)
    model = replace(found.model, parts=parts, findings=findings).settled()
    return replace(found, steps=steps, model=model, remaining=tuple(rivals(model.base())))


def considered_without(
    considered: Sequence[Considered], names: Collection[str], laws: Sequence[Signature]
) -> tuple[Considered, ...]:
    """Return the statuses of all hypotheses, with the reason for those that were not named."""
    others = [one for one in considered if one.effect not in names]
    return (*others, *(Considered(name, "not_supported", _why(name, laws[0])) for name in names))


def _why(effect: str, law: Signature) -> str:
    if agrees(effect, [law]):
        return "it acts elsewhere than where the gap is"
    return f"the gap is a law of {law.law.replace('_', ' ')}, which it does not make"
