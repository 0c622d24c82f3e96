"""Shared fixtures: recordings with a known truth, a gap, sweeps; others are imported."""

import gc
import os
from dataclasses import replace
from pathlib import Path

# As the command and the nodes have it: else what multiplies matrices takes three times the processor time without make.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from comparisons import comparison, mistaken  # noqa: F401  fixtures are found by their names here
from ros_bench import bench, board, fork_server, ros_domain  # noqa: F401
from ros_domains import remove_leftovers

from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import from_degrees, from_nanotesla

# Messages read this when they are imported: a field of the wrong type is then refused, not sent as rubbish.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"


def pytest_configure(config):
    """Let pass what ROS's message packages warn of, an old parser of theirs; collect tests without looking for garbage.

    Else a third of the time of collecting them goes into looking through what has been collected. The shared memory of
    an earlier run that was killed goes: a node that waits for one of its locks would never end.
    """
    if not hasattr(config, "workerinput"):
        remove_leftovers()
    config.addinivalue_line("filterwarnings", "ignore:module 'sre_:DeprecationWarning")
    gc.disable()


def pytest_collection_finish():
    """Look for garbage again, but not among the thousands of tests and the modules, which stay to the end."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session")
def cross():
    """Return the array that the nodes have without an array file."""
    return Array.cross(0.5, vector_noise_T=1e-9, scalar_noise_T=1e-10)


@pytest.fixture(scope="session")
def true_errors():
    """Return errors of the size of Wu 2025 Table 1."""
    rng = np.random.default_rng(2025)
    misalignment = from_degrees(rng.uniform(-2, 2, (4, 3)))
    misalignment[0] = 0
    return SensorErrors(
        1 + rng.uniform(-0.02, 0.02, (4, 3)),
        from_degrees(rng.uniform(-1, 1, (4, 3))),
        from_nanotesla(rng.uniform(-900, 900, (4, 3))),
        misalignment,
    )


@pytest.fixture(scope="session")
def recording(true_errors):
    """Return 600 samples at 100 Hz of a cross that is turned through all directions in 50 µT, with 1 nT of noise."""
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(600, 3))
    intensity = 50e-6 + 5e-9 * np.sin(np.linspace(0, 6, 600))
    field = direction / np.linalg.norm(direction, axis=1, keepdims=True) * intensity[:, None]
    readings = true_errors.distort(field) + 1e-9 * rng.normal(size=(600, 4, 3))
    return Recording(1.7e9 + np.arange(600) / 100, readings, intensity + 1e-10 * rng.normal(size=600))


@pytest.fixture(scope="session")
def wu_scenario():
    """Return Wu's Table 1 scenario: 360 random attitudes, 1 nT and 0.1 nT of noise."""
    from tam_calibration.results.scenario import read_scenario

    return read_scenario("wu_table_1")


@pytest.fixture(scope="session")
def wu_run(wu_scenario):
    """Return one simulated run of it."""
    from tam_calibration.simulation import simulate

    return simulate(wu_scenario)


@pytest.fixture(scope="session")
def noise_free(wu_scenario):
    """Return the same run without noise; its array still states the noise."""
    from tam_calibration.simulation import simulate

    silent = replace(wu_scenario, array=replace(wu_scenario.array, vector_noise_T=None, scalar_noise_T=None))
    return simulate(silent)


@pytest.fixture(scope="session")
def passing(true_errors, cross):
    """Return 600 samples of a platform that passes a dipole at 1.5 m/s eastwards while it turns, 3.4 m away at best."""
    from scipy.spatial.transform import Rotation

    from tam_calibration.sources.dipole import Dipole

    time = np.arange(600) / 20
    place = np.outer(time, [1.5, 0, 0])
    turns = Rotation.from_euler("zyx", np.stack([0.6 * np.sin(time / 3), 0.1 * np.sin(time), 0.2 * np.cos(time)], 1))
    dipole = Dipole(np.array([30.0, 2.5, -2.3]), np.array([40.0, -60.0, 150.0]))
    sensors = place[:, None] + np.einsum("nij,kj->nki", turns.as_matrix(), cross.positions_m)
    world = np.array([1e-6, 21e-6, -43e-6]) + dipole.field_T(sensors)
    fields = np.einsum("nji,nkj->nki", turns.as_matrix(), world)
    noise = 1e-9 * np.random.default_rng(30).normal(size=fields.shape)
    return Recording(1.7e9 + time, true_errors.distort(fields) + noise, attitude=turns.as_quat())


@pytest.fixture(scope="session")
def gap():
    """Return the gap of 400 samples of a cross whose sensor 2 drifts with a temperature that rises by 10 °C."""
    from tam_calibration.gap.laws.law import Signature
    from tam_calibration.gap.result import Cause, Considered, Gap, Residue, Size, Where
    from tam_calibration.model.fitted_effect import Contribution, FittedEffect

    rng = np.random.default_rng(8)
    direction = rng.normal(size=(400, 3))
    temperature = np.linspace(15.0, 25.0, 400)
    floor = np.append(np.full(12, 1e-9), 1e-10)
    after, twin = floor * rng.normal(size=(400, 13)), floor * rng.normal(size=(400, 13))
    before = after.copy()
    before[:, 3:6] += 1e-9 * (temperature - 20)[:, None]
    residue = Residue(
        np.arange(400) / 100,
        direction / np.linalg.norm(direction, axis=1, keepdims=True),
        before,
        after,
        twin,
        floor,
        temperature,
    )
    offsets = [Contribution(1, axis, "offset", {"offset": 1e-9 * (axis + 1)}, {"offset": 2e-11}) for axis in range(3)]
    fitted = FittedEffect("temperature_drift", {"time constant": 60.0}, tuple(offsets), {"time constant": 5.0})
    units = {"offset": "T/K", "time constant": "s"}
    law = Signature("offset", "channel", (2,), ("x", "y", "z"), 1.0, ((2,),), "temperature", (), 320.0)
    cause = Cause(fitted, units, (2,), ("x", "y", "z"), law, 0.98, 1.0, 640.0, 0.97, ("bias_jump",))
    return Gap(
        "explained",
        Size(1.9, 0.08, 1.9e-9, 8e-11, 5.4e-9, 2.2e-10, 1e-9, 0.998, (0.99, 1.0)),
        Where((2,), ("x", "y", "z"), None, (0.0, 0.5), {"differential": 1.9, "common_mode": float("nan")}),
        (cause,),
        (
            Considered("temperature_drift", "supported", "explains 97 % of the gap out of sample", 640.0, 0.97),
            Considered("hysteresis", "not_supported", "explains 2 % of the gap out of sample", -12.0, 0.02),
            Considered("flexure", "channel_missing", "needs the attitude"),
            Considered("eddy_current", "not_identifiable", "the array was at rest"),
        ),
        {"no_gap": 0.0, "temperature_drift": 0.98, "bias_jump": 0.015, "none_of_these": 0.005},
        "Record 20 min at rest while it warms up: that tells temperature_drift from bias_jump.",
        "The readings of sensor 2 drift with its temperature, which explains the gap.",
        residue,
    )


@pytest.fixture
def undrawn(monkeypatch):
    """Leave the figures, which are dear, out of the page of a calibration or a gap whose words alone are looked at."""
    from tam_calibration.report import calibration_report, gap_report, page

    def embed(figure, alternative, caption=""):
        return page.Image("data:image/svg+xml;base64,", alternative, caption)

    for module in (calibration_report, gap_report, page):
        for name in vars(module).keys() & {"embed"} | {name for name in vars(module) if name.startswith("plot_")}:
            monkeypatch.setattr(module, name, embed if name == "embed" else lambda *arguments, **given: None)


@pytest.fixture
def undiagnosed(monkeypatch):
    """Leave out the diagnosis of a residual that a calibration leaves, where the calibration alone is looked at."""
    monkeypatch.setattr("tam_calibration.fit.consistency.is_unexplained", lambda sentences: False)


@pytest.fixture(scope="session")
def kept_numbers():
    """Return a function that gives the numbers of a paper in the CSV file that is kept, by name."""
    import csv

    results = Path(__file__).parents[1] / "benchmarks" / "results"

    def read(paper):
        _, *lines = (results / f"reproduce_{paper}.csv").read_text(encoding="utf-8").splitlines()
        return {row["number"]: row for row in csv.DictReader(lines)}

    return read


@pytest.fixture(scope="session")
def simulated_numbers():
    """Return a function that gives the numbers of a paper by name, from some seeds."""
    from importlib import import_module

    from tam_validation.papers.row import rows_of

    def simulate(paper, seeds=40, as_published=False):
        module = import_module(f"tam_validation.papers.{paper}")
        results = [module.simulate(seed, as_published) for seed in range(seeds)]
        draws = {name: np.array([np.ravel(result[name]) for result in results]) for name in results[0]}
        return {row.name: row for row in rows_of(paper, draws)}

    return simulate
