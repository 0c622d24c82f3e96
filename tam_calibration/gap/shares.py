"""The part of each cause in what all explain: in the order of the search, and whatever the order (Shapley value)."""

from collections.abc import Sequence
from itertools import combinations
from math import expm1, factorial

import numpy as np

from tam_calibration.gap.design import Design
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import Base
from tam_calibration.gap.support import Step
from tam_calibration.units import FloatArray


def energies_of(steps: Sequence[Step], count: float) -> dict[Step, float]:
    """Return the part of the energy that each cause explains of what those accepted before it leave."""
    left, energies = 1.0, {}
    for step in steps:
        energies[step] = left * -expm1(-step.accepted.gain / count)
        left -= energies[step]
    return energies


def shares_of(model: Model) -> FloatArray:
    """Return the shares (M,) of the parts of a model; they add up to one."""
    count = len(model.parts)
    if count < 2:
        return np.ones(count)
    channels = model.channels()
    designs = [channels.design(part.terms(channels)) for part in model.parts]
    projected = Base(channels, [channels.calibration]).project(Design.joined(designs))
    ends = np.cumsum([design.width for design in designs])
    columns = [np.arange(end - design.width, end) for end, design in zip(ends, designs, strict=True)]
    explained: dict[tuple[int, ...], float] = {(): 0.0}
    for size in range(1, count + 1):
        for group in combinations(range(count), size):
            explained[group] = projected.take(np.concatenate([columns[member] for member in group])).gain()[0]
    values = np.zeros(count)
    for group, energy in explained.items():
        for member in group:
            others = tuple(other for other in group if other != member)
            weight = factorial(len(others)) * factorial(count - len(group)) / factorial(count)
            values[member] += weight * (energy - explained[others])
    return np.maximum(values, 0) / max(float(np.maximum(values, 0).sum()), np.finfo(float).tiny)
