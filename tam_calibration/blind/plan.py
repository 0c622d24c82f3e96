"""Which cases a set is made of."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from tam_calibration.blind.catalogue import CATALOGUE
from tam_calibration.blind.outside import OUTSIDE

GAPS = (0.3, 1.0, 3.0)


@dataclass(frozen=True)
class Plan:
    """What a case shall be: its kind, its causes' names and gaps; how many samples, where that is not drawn."""

    kind: str
    effects: tuple[str, ...]
    gaps: tuple[float, ...]
    samples: int | None = None


def plan_cases(kinds: tuple[str, ...], count: int, seed: int) -> list[Plan]:
    """Return the plans of a set in an order that tells nothing: over half single causes, each at each gap."""
    rng = np.random.default_rng([seed, 0])
    shares = {"single": 0.52, "pair": 0.10, "outside": 0.13, "clean": 0.11, "withheld": 0.07, "short": 0.07}
    total = sum(shares[kind] for kind in kinds)
    plans: list[Plan] = []
    for kind in kinds:
        plans += _plan_kind(rng, kind, round(count * shares[kind] / total))
    plans = (plans + _plan_kind(rng, kinds[0], count))[:count]
    return [plans[i] for i in rng.permutation(count)]


def _plan_kind(rng: Generator, kind: str, count: int) -> list[Plan]:
    names, others = list(CATALOGUE), list(OUTSIDE)
    deciding = [name for name, entry in CATALOGUE.items() if entry.channel]
    plans = []
    for number in range(count):
        gap = GAPS[number % 3]
        if kind == "clean" or (kind == "short" and number % 4 == 3):
            plans.append(Plan(kind, (), ()))
        elif kind == "pair":
            first, second = rng.choice(names, 2, replace=False)
            plans.append(Plan(kind, (str(first), str(second)), (float(rng.uniform(1, 3)), float(rng.uniform(1, 3)))))
        elif kind == "outside":
            plans.append(Plan(kind, (others[number % len(others)],), (gap,)))
        elif kind == "withheld":
            plans.append(Plan(kind, (deciding[number % len(deciding)],), (GAPS[1 + number // len(deciding) % 2],)))
        elif kind == "short":
            plans.append(Plan(kind, (str(rng.choice(names)),), (GAPS[1 + number % 2],)))
        else:
            plans.append(Plan(kind, (names[number % len(names)],), (gap,)))
    return plans
