"""The command that writes a recording of the vehicle."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from mujoco_vehicle import main
from numpy.testing import assert_allclose

from tam_calibration.cli.main import main as tam
from tam_calibration.recordings import read_array, read_recording
from tam_calibration.results import read_calibration

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: .venv/bin/pip install -e '.[compare]'")

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Return a function that runs the command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *words: CliRunner().invoke(main, words)


@pytest.mark.parametrize("output", ["run.csv", "run.mcap", "run"])
def test_recording_with_array_and_model_beside_it(run, output):
    """In each format: the samples, the array that goes with them, and a model that MuJoCo opens."""
    result = run(output, "--samples", "50", "--baseline", "0.8", "--field", "0,2e4,-4e4")
    assert result.exit_code == 0, result.output
    assert {path.name for path in Path().iterdir()} == {output, "run.array.yaml", "run.model.xml"}
    recording, array = read_recording(Path(output)), read_array(Path("run.array.yaml"))
    assert recording.readings_T.shape == (50, 4, 3)
    assert recording.temperature_C is not None and recording.current_A is not None and recording.attitude is not None
    assert_allclose(recording.scalar_T, np.hypot(2e4, 4e4) * 1e-9, rtol=0, atol=1e-9)
    assert_allclose(array.positions_m[0], [0.4, 0, 0])
    model = mujoco.MjModel.from_xml_path("run.model.xml")
    assert_allclose(model.opt.magnetic, [0, 2e-5, -4e-5])
    assert_allclose(model.site("tam_1").pos, [0.4, 0, 0])


def test_script_runs_by_itself_and_names_the_command_that_follows(tmp_path):
    """As the README says it; what it says to type then calibrates the run."""
    script = [sys.executable, EXAMPLES / "mujoco_vehicle.py", "run.csv", "--samples", "1000"]
    done = subprocess.run(script, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    words = [tmp_path / word if "." in word else word for word in shlex.split(done.stdout.removeprefix("next: tam "))]
    result = CliRunner().invoke(tam, [str(word) for word in words])
    assert result.exit_code == 0, result.output


def test_biases_are_those_of_the_vehicle_in_every_run(run):
    """They follow the seed of the errors, and not that of the run."""

    def biases(*options):
        Path("run.csv").unlink(missing_ok=True)  # no recording is overwritten
        assert run("run.csv", "--samples", "1000", "--bias-nT", "300", *options).exit_code == 0
        result = CliRunner().invoke(tam, ["calibrate", "run.csv", "--array", "run.array.yaml", "-o", "out.yaml"])
        assert result.exit_code == 0, result.output
        return read_calibration(Path("out.yaml")).errors.bias_T

    first, again, other = biases(), biases("--seed", "3"), biases("--errors-seed", "1")
    assert_allclose(first, again, rtol=0, atol=1e-9)
    assert np.abs(first - other).max() > 100e-9
    assert 150e-9 < first.std() < 450e-9


def test_an_imu(run):
    """One sensor and attitude."""
    assert run("imu.csv", "--imu", "--samples", "50", "--rate", "142.857", "--noise-nT", "170").exit_code == 0
    recording = read_recording(Path("imu.csv"))
    assert recording.sensor_count == 1
    assert recording.scalar_T is recording.temperature_C is recording.current_A is None
    assert recording.attitude is not None
    assert_allclose(np.diff(recording.time_s), 0.007, rtol=1e-3)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["run.csv", "--field", "1,2"], "'1,2' must be the numbers EAST,NORTH,UP."),
        (["run.csv", "--field", "1,2,nan"], "'1,2,nan' must be the numbers EAST,NORTH,UP."),
        (["run.csv", "--temperature", "warm"], "'warm' must be the numbers START,END."),
        (["run.csv", "--noise-nT", "0"], "every vector noise must be a positive number"),
        (["run.csv", "--samples", "1"], "1 is not in the range"),
        (["run.csv", "--baseline", "1e9"], "the baseline"),
        (["/nowhere/run.csv"], "/nowhere"),
        ([], "Missing argument 'OUTPUT'"),
    ],
)
def test_bad_input_ends_with_one_sentence(run, words, sentence):
    """Exit code 2, and nothing is written."""
    result = run(*words)
    assert result.exit_code == 2
    (said,) = re.findall(r"Error: (.*)\n", result.output)
    assert sentence in said
    assert list(Path().iterdir()) == []
