"""What a search for the causes of a gap found."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

from tam_calibration.effects.grades import MINOR
from tam_calibration.gap.laws.law import Signature
from tam_calibration.gap.laws.signature import Law
from tam_calibration.gap.model import Model
from tam_calibration.gap.result import Considered
from tam_calibration.gap.size import Evidence
from tam_calibration.gap.steps import Step

LARGEST_REST = 1.0
"""Residual, in noise floors, that causes may leave: a larger one is a gap of its own."""


@dataclass(frozen=True, eq=False)
class Search:
    """What a search found.

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
        """The laws of the gap, the strongest first: those that causes explain, and those that remain."""
        laws = dict.fromkeys([*(step.law for step in self.steps), *(law.signature for law in self.remaining)])
        return tuple(sorted(laws, key=lambda one: -one.energy))

    @property
    def open_part(self) -> float:
        """Part of the energy of all laws that the causes leave, 0 to 1."""
        before, after = self.nominal.base().energy, self.model.base().energy
        left = after * sum(law.part for law in self.remaining)
        return left / max(left + before - after, 1.0)

    @property
    def explains_all(self) -> bool:
        """Whether the causes explain the laws: they leave a small part in their sensors, and nothing elsewhere."""
        elsewhere = any(is_elsewhere(law.signature, self.steps) for law in self.remaining)
        return self.open_part < MINOR and not elsewhere

    @property
    def is_clean(self) -> bool:
        """Whether the causes leave nothing but noise."""
        base = self.model.base()
        return self.explains_all and base.energy < (1 + LARGEST_REST**2) * base.channels.count

    @property
    def evidence(self) -> float:
        """Log-evidence of the model: -BIC."""
        base = self.model.base()
        spent = base.rank + sum(finding.parameter_count for finding in self.model.findings)
        return -base.channels.count * log(base.energy / base.channels.count) - spent * log(base.channels.count)


def is_elsewhere(law: Signature, steps: Sequence[Step]) -> bool:
    """Say whether a law sits in no sensor in which the law of a cause may sit.

    Parameters
    ----------
    law : Signature
    steps : sequence of Step
        The causes.
    """
    return {one for place in law.places for one in place}.isdisjoint(
        one for step in steps for place in step.law.places for one in place
    )
