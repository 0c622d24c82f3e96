"""Which cases a set is made of."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from tam_validation.blind import SETS
from tam_validation.blind.catalogue import CATALOGUE, CAUSES, OUTSIDE_SETS

GAPS = (0.3, 1.0, 3.0)
"""In noise floors: hidden in the noise, as large, and plain to see; figures are asked for at each."""

_MIXED = (2.0, 1.0)
"""Gaps of the known cause and of the unknown one beside it."""

_SHARES = {
    "single": 0.42,
    "pair": 0.08,
    "outside": 0.12,
    "clean": 0.10,
    "withheld": 0.06,
    "short": 0.06,
    "mixed": 0.08,
    "large": 0.08,
}
"""Of the kinds in a set: of 600 cases three or four are of each effect and gap, and 36 to 72 of each other kind."""

_EVERYWHERE = (
    *("ambient_gradient", "platform_field"),
    *("emptying_bottle", "belt_drive"),
    *("shifted_battery", "dropped_ballast"),
)
"""What disturbs all sensors leaves none to another cause."""

OF_SCALAR = ("geomagnetic_drift", "scalar_heading_error")
"""What disturbs the scalar leaves no place of its own to an unknown cause that needs one."""


@dataclass(frozen=True)
class CasePlan:
    """What a case shall be: its kind, its causes' names and gaps; how many samples, where that is not drawn."""

    kind: str
    effects: tuple[str, ...]
    gaps: tuple[float, ...]
    samples: int | None = None

    @property
    def withheld(self) -> str:
        """The channel that decides and is left out; nothing in other kinds."""
        return CATALOGUE[self.effects[0]].channel if self.kind == "withheld" else ""


def plan_cases(kinds: tuple[str, ...], count: int, seed: int, outside: str = SETS[0]) -> list[CasePlan]:
    """Return the plans of a set, with one set of causes outside the library, in an order that tells nothing."""
    rng = np.random.default_rng([seed, 0])
    others = [str(name) for name in rng.permutation(list(OUTSIDE_SETS[outside]))]
    total = sum(_SHARES[kind] for kind in kinds)
    plans: list[CasePlan] = []
    for kind in kinds:
        plans += _plan_kind(rng, kind, round(count * _SHARES[kind] / total), others)
    plans = (plans + _plan_kind(rng, kinds[0], count, others))[:count]
    return [plans[i] for i in rng.permutation(count)]


def _plan_kind(rng: Generator, kind: str, count: int, others: list[str]) -> list[CasePlan]:
    if kind == "clean":
        return [CasePlan(kind, (), ())] * count
    names = list(CATALOGUE)
    quiet = [name for name in names if not CATALOGUE[name].coarse]
    if kind == "pair":
        return [CasePlan(kind, *_pair(rng, quiet)) for _ in range(count)]
    if kind == "short":
        drawn = [CasePlan(kind, (str(rng.choice(names)),), (GAPS[1 + number % 2],)) for number in range(count)]
        return [CasePlan(kind, (), ()) if number % 4 == 3 else plan for number, plan in enumerate(drawn)]
    if kind == "mixed":
        known = [str(name) for name in rng.permutation([name for name in quiet if name not in _EVERYWHERE])]
        others = [name for name in others if name not in _EVERYWHERE]
        turns = [divmod(i, len(known)) for i in range(2 * count)]  # each time around the known ones meet others
        beside = [(known[i], others[(i + turn) % len(others)]) for turn, i in turns]
        return [CasePlan(kind, both, _MIXED) for both in beside if _can_meet(*both) and not _are_of_scalar(*both)][
            :count
        ]
    cycles = {
        "single": [(name, gap) for gap in GAPS for name in names],
        "outside": [(name, gap) for gap in GAPS for name in others],
        "withheld": [(name, gap) for gap in GAPS[1:] for name in names if CATALOGUE[name].channel],
        "large": [(name, gap) for name in names for gap in CATALOGUE[name].large],
    }
    cycle = cycles[kind]
    if kind != "withheld":
        cycle = [cycle[i] for i in rng.permutation(len(cycle))]
    return [CasePlan(kind, (cycle[i % len(cycle)][0],), (cycle[i % len(cycle)][1],)) for i in range(count)]


def _pair(rng: Generator, names: list[str]) -> tuple[tuple[str, str], tuple[float, float]]:
    """Draw two effects and a gap for each."""
    while True:
        first, second = (str(name) for name in rng.choice(names, 2, replace=False))
        if _can_meet(first, second):
            break
    return (first, second), (float(rng.uniform(1, 3)), float(rng.uniform(1, 3)))


def _can_meet(first: str, second: str) -> bool:
    """Say whether there is a motion that shows both causes."""
    return bool(set(CAUSES[first].motions) & set(CAUSES[second].motions))


def _are_of_scalar(known: str, unknown: str) -> bool:
    """Say whether both causes disturb the scalar."""
    return known in OF_SCALAR and CAUSES[unknown].scalar_needed
