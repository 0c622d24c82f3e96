"""Which pairs a set is made of: kinds, effects, gaps."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from tam_validation.blind.catalogue import CATALOGUE
from tam_validation.blind.disturbance import MOVING
from tam_validation.blind.outside import OUTSIDE

SHARES = {
    "missing": 60,
    "surplus": 40,
    "other": 20,
    "level": 15,
    "colour": 15,
    "two": 15,
    "none": 25,
    "outside": 10,
}
"""Pairs of each kind in 200."""

BESIDE = {"mistake": 20, "runs": 20}
"""Pairs beside these 200: gross mistakes of a simulator, and two runs of one simulator."""

WORLD = {"world": 20}
"""Pairs whose recording is of the world that others made, where it is given."""

GAPS = (0.3, 1.0, 3.0)
"""Of a single effect in noise floors; figures are asked for at each."""

MOVED = tuple(name for name, entry in CATALOGUE.items() if set(entry.motions) & set(MOVING))
"""Effects that show in a run that moves."""

QUIET = tuple(name for name in MOVED if not CATALOGUE[name].coarse)
"""Those that do not ask for noisy sensors, and can stand beside others."""

OF_ITS_RUN = ("eddy_current", "saturation")
"""Effects whose amplitude is that of one run's motion. Of the others one draw at one amplitude is the same effect in
two runs under one course of temperature and current and one intensity."""

WITH_PARAMETERS = (
    "temperature_drift",
    "current_interference",
    "time_skew",
    "hysteresis",
    "nonlinearity",
    "scalar_heading_error",
    "flexure",
)
"""Of those, what an array has in every run, with parameters that can be compared."""

MENDED_AT = 1.0
"""Least gap at which the simulation is mended by its maker."""

MISTAKES = (
    "gauss_for_tesla",
    "microtesla_for_tesla",
    "ned_for_enu",
    "frd_for_flu",
    "wrong_hemisphere",
    "no_world_field",
    "mirrored_axis",
    "variance_for_deviation",
    "same_noise_in_channels",
    "same_noise_again",
    "same_noise_in_runs",
    "attitude_wxyz",
)
"""Gross mistakes of simulators, by the names that the comparison gives them."""

WORLD_EFFECTS = (
    "temperature_drift",
    "hysteresis",
    "nonlinearity",
    "time_skew",
    "eddy_current",
    "ambient_gradient",
    "scalar_heading_error",
    "geomagnetic_drift",
    "bias_jump",
    "current_interference",
    "flexure",
    "periodic_interference",
    "outliers",
    "noise_excess",
    "quantization",
    "saturation",
)
"""Effects of the other world."""


@dataclass(frozen=True)
class PairPlan:
    """What a pair shall be.

    Parameters
    ----------
    kind : str
    missing, surplus : tuple of str
        Causes in the recording, and in the simulation.
    gaps : tuple of float
        Visible gaps of those, in this order, in noise floors.
    detail : str
        The mistake, the colour of the noise or where it is louder.
    """

    kind: str
    missing: tuple[str, ...] = ()
    surplus: tuple[str, ...] = ()
    gaps: tuple[float, ...] = ()
    detail: str = ""

    @property
    def effects(self) -> tuple[str, ...]:
        """All causes."""
        return self.missing + self.surplus

    @property
    def is_mended(self) -> bool:
        """Whether there is a simulation to which its maker added what it lacks."""
        return self.kind == "missing" and self.gaps[0] >= MENDED_AT and self.missing[0] not in OF_ITS_RUN


def plan_pairs(count: int, seed: int, with_world: bool) -> list[PairPlan]:
    """Return the plans of a set, in an order that tells nothing.

    Parameters
    ----------
    count : int
        Pairs without those of ``BESIDE`` and ``WORLD``, which are in proportion.
    seed : int
    with_world : bool
        Whether there are pairs of the other world.
    """
    rng = np.random.default_rng([seed, 0])
    shares = SHARES | BESIDE | (WORLD if with_world else {})
    whole = sum(SHARES.values())
    plans = [
        plan for kind, share in shares.items() for plan in _plan_kind(rng, kind, max(1, round(count * share / whole)))
    ]
    return [plans[i] for i in rng.permutation(len(plans))]


def _plan_kind(rng: Generator, kind: str, count: int) -> list[PairPlan]:
    if kind == "two":
        return [_two(rng, number % 2 == 0) for number in range(count)]
    if kind in ("none", "runs"):
        return [PairPlan(kind)] * count
    if kind == "other":
        names = _in_turn(rng, WITH_PARAMETERS, count)
        return [PairPlan(kind, (name,), (name,), (3.0,)) for name in names]
    details = {"level": ("all", "one"), "colour": ("1/f", "band"), "mistake": MISTAKES}
    if kind in details:
        return [PairPlan(kind, detail=detail) for detail in _in_turn(rng, details[kind], count)]
    if kind == "outside":
        names = _in_turn(rng, tuple(OUTSIDE), count)
        return [PairPlan(kind, (name,), (), (GAPS[1 + i % 2],)) for i, name in enumerate(names)]
    effects = WORLD_EFFECTS if kind == "world" else MOVED
    chosen = zip(_in_turn(rng, effects, count), (GAPS[i % len(GAPS)] for i in range(count)), strict=True)
    if kind == "surplus":
        return [PairPlan(kind, surplus=(name,), gaps=(gap,)) for name, gap in chosen]
    return [PairPlan(kind, missing=(name,), gaps=(gap,)) for name, gap in chosen]


def _in_turn(rng: Generator, names: tuple[str, ...], count: int) -> list[str]:
    """Return so many names: each as often as any other, in an order of its own each time around."""
    rounds = -(-count // len(names))
    return [str(name) for _ in range(rounds) for name in rng.permutation(names)][:count]


def _two(rng: Generator, both_missing: bool) -> PairPlan:
    first, second = (str(name) for name in rng.choice(QUIET, 2, replace=False))
    gaps = float(rng.uniform(1, 3)), float(rng.uniform(1, 3))
    missing, surplus = ((first, second), ()) if both_missing else ((first,), (second,))
    return PairPlan("two", missing, surplus, gaps)
