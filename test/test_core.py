"""The core needs nothing but what Ubuntu 24.04 and rosdep have; a command that needs more says what to install."""

import json
import runpy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import setuptools
from core_only import CORE_ONLY
from scipy.spatial.transform import Rotation

from tam_calibration.model.libraries import EXTRAS
from tam_calibration.recordings import write_array
from tam_calibration.results import write_recording
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.sources.dipole import Dipole

ROOT = Path(__file__).parents[1]

DONE = (
    "simulate wu_turntable -o turntable.csv",
    "calibrate run.csv --array array.yaml -o calibration.yaml --json calibration.json",
    "correct run.csv --calibration calibration.yaml -o corrected.csv",
    "diagnose run.csv --array array.yaml --place 47.37,8.54,2025-06-30 --json gap.json",
    "compare other.csv run.csv --array array.yaml --json compare.json --mend mend.yaml",
    "plan --array array.yaml --place 47.37,8.54,2025-06-30 --pitch-limit-deg 30 --roll-limit-deg 30 --poses 9",
    "locate wreck.csv --calibration calibration.yaml",
    "inspect run.csv --json inspection.json --write-map map.yaml",
)
"""Commands of the core, with places of IGRF and every kind of file but bags and pages."""

NEEDS = {
    "calibrate run.mcap --array array.yaml": ("reading bags", "rosbags", "bags"),
    "inspect run.parquet": ("reading Parquet files", "pandas", "tables"),
    "diagnose run.mcap --array array.yaml": ("reading bags", "rosbags", "bags"),
    "compare run.csv run.mcap --array array.yaml": ("the recording: reading bags", "rosbags", "bags"),
    "batch run.mcap --array array.yaml --out results": ("the summary of a batch", "jinja2", "report"),
    "simulate wu_table_1 -o again.mcap": ("writing bags", "rosbags", "bags"),
    "correct run.csv --calibration calibration.yaml -o corrected": ("writing bags", "rosbags", "bags"),
    "play run.mcap": ("playing recordings", "rosbags", "bags"),
    "calibrate run.csv --array array.yaml --report page.html": ("--report", "jinja2", "report"),
    "diagnose run.csv --array array.yaml --report page.html": ("--report", "jinja2", "report"),
    "compare run.csv run.csv --array array.yaml --report page.html": ("--report", "jinja2", "report"),
    "locate run.csv --calibration calibration.yaml --report page.html": ("--report", "jinja2", "report"),
    "demo": ("the demonstration", "rosbags", "bags"),
}
"""Commands that need more: the subject of the sentence, the library that it names, and the extra."""

CODE = """
import json
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module
from io import StringIO

import tam_calibration
from tam_calibration.cli.main import main

answers = {}
for command in sys.argv[1:]:
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as said:
        code = main.main(command.split(), prog_name="tam", standalone_mode=False)
    answers[command] = code or 0, said.getvalue()
for name in tam_calibration.__all__:
    getattr(tam_calibration, name)
for name in ("calibrator_node", "collector_node", "corrector_node", "localizer_node", "session", "start"):
    import_module(f"tam_calibration.nodes.{name}")
print(json.dumps(answers))
"""


def beside_a_wreck(made):
    """Return the recording with a dipole that is there in its last tenth, 2 m from the array along the world's x."""
    recording, array = made.recording, made.scenario.array
    turns = Rotation.from_quat(made.attitude).as_matrix()
    points = np.einsum("nij,kj->nki", turns, array.positions_m)
    world = Dipole(np.array([2.0, 0.0, 0.0]), np.array([0.0, 300.0, 400.0])).field_T(points)
    world[: len(world) * 9 // 10] = 0
    added = np.einsum("kil,njl,nkj->nki", made.scenario.errors.matrix, turns, world)
    return replace(recording, readings_T=recording.readings_T + added, attitude=made.attitude)


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """Return exit code and stderr of each command, run in a process that has the core only and loads the nodes too."""
    folder = tmp_path_factory.mktemp("core")
    scenario = read_scenario("wu_table_1")
    made = simulate(scenario)
    write_recording(folder / "other.csv", simulate(replace(scenario, seed=5)).recording)
    write_recording(folder / "run.csv", made.recording)
    write_recording(folder / "run.mcap", made.recording)
    (folder / "run.parquet").write_bytes(b"PAR1")
    write_recording(folder / "wreck.csv", beside_a_wreck(made))
    write_array(folder / "array.yaml", made.scenario.array)
    command = [sys.executable, "-c", CORE_ONLY + CODE, *DONE, *NEEDS]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_core_needs_no_extra(answers):
    """Every command of the core works; the nodes and the names for Python load."""
    assert {command: answers[command][0] for command in DONE} == dict.fromkeys(DONE, 0), answers


@pytest.mark.parametrize("command", NEEDS)
def test_a_command_that_needs_an_extra_names_it(answers, command):
    """Exit code 2 and one sentence with the pip command, and with apt's where Ubuntu has the libraries."""
    subject, library, extra = NEEDS[command]
    code, sentence = answers[command]
    assert code == 2
    assert sentence.startswith(f"tam: {subject} needs {library}: "), sentence
    assert f"pip install 'tam_calibration[{extra}]' in a virtual environment" in sentence
    assert ("sudo apt install python3-jinja2 python3-matplotlib, or pip" in sentence) == (extra == "report")
    assert sentence.count("\n") == 1


def test_setup_py_brings_what_the_sentences_promise(monkeypatch):
    """Each extra that a sentence names has the libraries without which it is said."""
    given = {}
    monkeypatch.setattr(setuptools, "setup", lambda **arguments: given.update(arguments))
    monkeypatch.chdir(ROOT)
    runpy.run_path("setup.py")
    brought = {extra: {name.partition(">")[0] for name in names} for extra, names in given["extras_require"].items()}
    for extra, libraries in EXTRAS.items():
        assert set(libraries) <= brought[extra]
        assert brought[extra] <= brought["test"], f"make test does not install the extra {extra}"


def test_least_squares_are_those_of_every_numpy():
    """The smallest singular value that counts is stated, as its default is another in numpy 1 than in numpy 2."""
    sources = [path.read_text() for path in (ROOT / "tam_calibration").rglob("*.py")]
    calls = [line for source in sources for line in source.splitlines() if "lstsq(" in line]
    assert calls and [line for line in calls if "rcond=" not in line] == []
