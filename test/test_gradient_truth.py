"""What a uniform field cannot show: calibrated arrays near a dipole and a coil that others have written."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.model.array import Array
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import AttitudeChannel

BENCHMARK = runpy.run_path(str(Path(__file__).parents[1] / "benchmarks" / "gradient_truth.py"))
SOURCES, METHODS = BENCHMARK["SOURCES"], BENCHMARK["methods"]()
FIRST_ORDER = ("simplified_linear",)
"""Methods that leave out squares of the errors: a few per cent near a source, whatever the data."""


@pytest.fixture(scope="module")
def scenario():
    """Return Wu's Table 1 without noise, with attitude."""
    wu = read_scenario("wu_table_1")
    silent = replace(wu.array, vector_noise_T=None, scalar_noise_T=None)
    return replace(wu, array=silent, attitude=AttitudeChannel())


@pytest.fixture(scope="module")
def array():
    """Return its array with the noise stated."""
    return read_scenario("wu_table_1").array


@pytest.fixture(scope="module")
def run(scenario):
    """Return its recording."""
    return simulate(scenario)


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("method", METHODS)
def test_calibrated_array_reads_what_an_error_free_one_reads(run, array, method, source):
    """Centre vector, every component of the tensor and both invariants agree to 1e-9, except of first-order fits."""
    calibration = METHODS[method](run.recording, array)
    errors = BENCHMARK["judge"](calibration, run.errors, run.scenario.site_field_T, source)
    if method in FIRST_ORDER:
        assert 1e-3 < errors[:, :9].max() < 0.1
    else:
        assert errors.max() < 1e-9


@pytest.mark.parametrize("axis", BENCHMARK["AXES"].values(), ids=BENCHMARK["AXES"])
@pytest.mark.parametrize("source", SOURCES)
def test_a_turn_of_all_sensors_is_seen_near_a_source_only(scenario, array, source, axis):
    """Turned by 0.5° against the baselines: perfect in a uniform field, wrong by that angle near a source."""
    run = simulate(replace(scenario, errors=BENCHMARK["turned_together"](scenario.errors, axis)))
    calibration = METHODS["maximum_likelihood"](run.recording, array)
    assert calibration.in_sample.tensor_rmse_T_per_m < 1e-18
    errors = BENCHMARK["judge"](calibration, run.errors, scenario.site_field_T, source)
    components = errors[:, 1:7].max()
    assert 0.2 * BENCHMARK["TURN"] < components < 2 * BENCHMARK["TURN"]
    mended = METHODS[BENCHMARK["TURNED_BY_ATTITUDE"]](run.recording, array)
    assert BENCHMARK["judge"](mended, run.errors, scenario.site_field_T, source).max() < 1e-9


@pytest.mark.parametrize("source", SOURCES)
def test_a_small_array_approaches_the_truth_with_the_square_of_its_baseline(source):
    """The finite-baseline error of centre vector, tensor and invariants is of second order."""
    truth = BENCHMARK["truth"](source)
    errors = [
        BENCHMARK["relative_errors"](BENCHMARK["ideal"](source, Array.cross(baseline)), truth)[:, :9].max()
        for baseline in (0.5, 0.05)
    ]
    assert errors[0] < 0.05
    assert errors[1] == pytest.approx(errors[0] / 100, rel=0.05)


@pytest.mark.parametrize("source", SOURCES)
def test_the_truth_has_no_trace(source):
    """The tensor at the centre, by differences of another library's field, has no trace to 1e-9."""
    outputs = BENCHMARK["truth"](source)
    size = np.linalg.norm(outputs[:, 3:], axis=1)
    assert_allclose(outputs[:, [3, 6, 8]].sum(axis=1) / size, 0, atol=1e-9)


def test_invariants_do_not_depend_on_the_frame():
    """A diagonal tensor has the invariants of its diagonal, in every frame."""
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    for frame in (np.eye(3), turn):
        tensor = frame @ np.diag([3.0, -1.0, -2.0]) @ frame.T
        output = np.concatenate([np.zeros(3), tensor[np.triu_indices(3)]])
        assert_allclose(BENCHMARK["invariants"](output[None]), [[-7.0, 6.0]], atol=1e-12)
