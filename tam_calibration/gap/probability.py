"""The probabilities of the hypotheses, calibrated on simulated recordings."""

from collections.abc import Mapping

import numpy as np

from tam_calibration.gap.steps import LEAST_EVIDENCE, Search

_TEMPER = 6.0
"""By how much the logarithm of the odds is weaker than BIC has it: bases are never quite right."""


def probabilities(found: Search) -> Mapping[str, float]:
    """Return the probabilities of no gap, of each effect weighed first, and of none of these; they add up to one."""
    accepted = [step.accepted.effect for step in found.steps]
    logits = {"no_gap": LEAST_EVIDENCE / 2}
    for one in found.weighed:
        penalty = 0.0 if one.effect in accepted[:1] or not accepted else 1.0
        logits[one.effect] = one.delta_bic / 2 - penalty
    strongest = max((rival.delta_bic for rival in found.rivals), default=0.0)
    logits["none_of_these"] = strongest / 2 if not accepted else -np.inf
    values = np.array(list(logits.values())) / _TEMPER
    odds = np.exp(np.maximum(values - values.max(), -700))
    return dict(zip(logits, (odds / odds.sum()).tolist(), strict=True))
