import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.results.scenario import read_scenario
from tam_validation.papers.sweep import Sweep, SweepPlan, run, sweeps_of, tasks_of
from tam_validation.papers.wu2025_sweeps import score

PLANS = [SweepPlan("first", "x", "nT", (1, 10), ("a", "b")), SweepPlan("second", "y", "", (5,), ("c",))]


def test_each_scenario_is_scored_in_each_run():
    """The numbers of the runs are the same at every point."""
    assert tasks_of(PLANS, 2) == [("a", 0), ("a", 1), ("b", 0), ("b", 1), ("c", 0), ("c", 1)]


def test_scores_are_put_where_they_belong():
    """Values are by point, run and column, each sweep having its own."""
    letters = {"a": 1.0, "b": 2.0, "c": 3.0}
    scores = [{("us", "error"): np.array([letters[name], run])} for name, run in tasks_of(PLANS, 2)]
    first, second = sweeps_of(PLANS, scores)
    assert_allclose(first.values["us", "error"], [[[1, 0], [1, 1]], [[2, 0], [2, 1]]])
    assert_allclose(second.values["us", "error"], [[[3, 0], [3, 1]]])
    assert_allclose(first.mean("us", "error"), [[1, 0.5], [2, 0.5]])


def test_exponents_of_powers():
    """A power of the setting gives its exponent, also from a part of the points."""
    sweep = Sweep(SweepPlan("", "x", "", (1, 10, 100), ()), {})
    assert sweep.exponent(4 * sweep.points**-0.5) == pytest.approx(-0.5)
    assert sweep.exponent(np.array([7.0, 10.0, 100.0]), least=10) == pytest.approx(1)


def test_processes_give_what_this_one_gives():
    """The random numbers hang on the run alone, and progress is told to the last run."""
    scenario = read_scenario("wu_turntable")
    plan = SweepPlan("once", "", "", (1,), (scenario,))
    told = []
    (sweep,) = run([plan], score, 2, lambda done, total: told.append((done, total)))
    here = score(scenario, 1)
    assert_allclose(sweep.values["before", "e_T held out"][0, 1], here["before", "e_T held out"], rtol=1e-12)
    assert told == [(1, 2), (2, 2)]
