"""Sweeps of a simulation over one of its settings: many runs a point, on all cores."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from multiprocessing import get_context

import numpy as np

from tam_calibration.fleet.processes import processes
from tam_calibration.model.units import FloatArray
from tam_calibration.simulation import Scenario

Figures = Mapping[tuple[str, str], FloatArray]
"""What one run gives, by (source, quantity)."""
_Score = Callable[[Scenario, int], Figures]
"""Simulates a scenario and scores what it is for; the number of the run makes its random numbers."""
Progress = Callable[[int, int], None]
"""Called with the number of runs that are done, and of all."""

_CHUNK = 4


@dataclass(frozen=True, eq=False)
class SweepPlan:
    """A sweep to run.

    Parameters
    ----------
    name, symbol, unit : str
        What is swept, for people.
    points : sequence of float
        Values of the setting.
    scenarios : sequence of Scenario
        What is simulated at each.
    """

    name: str
    symbol: str
    unit: str
    points: Sequence[float]
    scenarios: Sequence[Scenario]


@dataclass(frozen=True, eq=False)
class Sweep:
    """A sweep and what came out.

    Parameters
    ----------
    plan : Plan
        What was simulated.
    values : mapping
        (points, runs, n) arrays by (source, quantity).
    """

    plan: SweepPlan
    values: Figures

    @property
    def points(self) -> FloatArray:
        """(P,) values of the setting."""
        return np.array(self.plan.points, dtype=float)

    def mean(self, source: str, quantity: str) -> FloatArray:
        """Return the means over the runs.

        Parameters
        ----------
        source : str
            What gave the figures: a method, the raw readings, the noise floor or the bound.
        quantity : str
            Which of its figures.

        Returns
        -------
        (P, n) array
            A row for each point of the sweep, in the unit of the quantity.
        """
        return np.asarray(self.values[source, quantity].mean(axis=1))

    def exponent(self, curve: FloatArray, least: float = 0.0) -> float:
        """Return the exponent with which a curve changes with the setting.

        Parameters
        ----------
        curve : (P,) array
            A positive value for each point of the sweep.
        least : float
            Points with a smaller setting are left out.
        """
        chosen = self.points >= least
        return float(np.polyfit(np.log(self.points[chosen]), np.log(curve[chosen]), 1)[0])


def run(plans: Sequence[SweepPlan], score: _Score, runs: int, progress: Progress) -> list[Sweep]:
    """Return the sweeps of plans, simulated on all cores.

    Parameters
    ----------
    plans : sequence of Plan
        What to simulate.
    score : callable
        Importable by name.
    runs : int
        Of each point; the runs of different points share their numbers.
    progress : callable
        Called with what is done, and of how much.
    """
    tasks = tasks_of(plans, runs)
    results: list[Figures] = []
    with processes(os.cpu_count() or 1, get_context("spawn")) as pool:
        for figures in pool.map(score, *zip(*tasks, strict=True), chunksize=_CHUNK):
            results.append(figures)
            progress(len(results), len(tasks))
    return sweeps_of(plans, results)


def tasks_of(plans: Sequence[SweepPlan], runs: int) -> list[tuple[Scenario, int]]:
    """Return what is to be scored: each scenario of each plan, as often as there are runs.

    Parameters
    ----------
    plans : sequence of SweepPlan
        What to simulate.
    runs : int
        Of each scenario, numbered from 0.

    Returns
    -------
    list of (Scenario, int)
        Scenario and number of the run, plan by plan and point by point.
    """
    return [(scenario, number) for plan in plans for scenario in plan.scenarios for number in range(runs)]


def sweeps_of(plans: Sequence[SweepPlan], results: Sequence[Figures]) -> list[Sweep]:
    """Return the sweeps of plans from the scores of their tasks.

    Parameters
    ----------
    plans : sequence of SweepPlan
        What was simulated.
    results : sequence of mapping
        The figures of each task, in the order of ``tasks_of``.
    """
    runs = len(results) // sum(len(plan.points) for plan in plans)
    rest = iter(results)
    sweeps = []
    for plan in plans:
        own = list(islice(rest, runs * len(plan.points)))
        shape = (len(plan.points), runs, -1)
        sweeps.append(Sweep(plan, {key: np.array([each[key] for each in own]).reshape(shape) for key in own[0]}))
    return sweeps
