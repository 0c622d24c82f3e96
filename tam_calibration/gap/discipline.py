"""Names held against the law of the gap: a cause whose signature is another one is not named, or is doubted."""

from collections.abc import Collection, Sequence
from dataclasses import replace

from tam_calibration.gap.laws.causes import agrees
from tam_calibration.gap.laws.law import Signature
from tam_calibration.gap.result import Considered
from tam_calibration.gap.search import Search
from tam_calibration.gap.size import rivals

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
    first = laws[0] if laws else None
    why = "" if first is None else f"the gap is a law of {first.law.replace('_', ' ')}, which it does not make"
    others = [one for one in considered if one.effect not in names]
    return (*others, *(Considered(name, "not_supported", why) for name in names))
