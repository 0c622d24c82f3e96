"""`tam simulate --from-comparison`: a simulated run gets what a comparison found missing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from mends import EFFECTS, mend_of, run_of
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.cli.main import main
from tam_calibration.comparison.additions import mended
from tam_calibration.comparison.mend import NoiseTerm
from tam_calibration.files.text_files import to_json
from tam_calibration.model.mounting import Mounting
from tam_calibration.recordings import read_array, read_recording
from tam_calibration.results import write_recording
from tam_calibration.results.comparison_json import mend_to_mapping, write_mend


@pytest.fixture(scope="module")
def run():
    """Return what a simulator made."""
    return run_of(200)


@pytest.fixture(scope="module")
def mend(run):
    """Return a mend with a drift, and noise of one axis."""
    return mend_of(run, [EFFECTS["temperature_drift"]], [NoiseTerm(1, "x", 1e-9, 2e-9)], ["time_skew"])


@pytest.fixture
def simulate(tmp_path, monkeypatch, run, mend):
    """Return a function that runs `tam simulate` in a folder with a mend, a comparison and a run."""
    monkeypatch.chdir(tmp_path)
    write_mend("mend.yaml", mend)
    content = {"schema": "tam_calibration/compare/1", "mend": {"parameters": mend_to_mapping(mend)}}
    Path("compare.json").write_text(to_json(content))
    write_recording(Path("sim.csv"), run)
    return lambda *words: CliRunner().invoke(main, ["simulate", *words])


@pytest.mark.parametrize("source", ["mend.yaml", "compare.json"])
def test_a_simulated_run_gets_what_it_lacks(simulate, run, mend, source):
    """The readings are those of the same mend in Python, times and channels are the run's, an array file is beside."""
    made = simulate("--from-comparison", source, "--recording", "sim.csv", "-o", "mended.csv", "--seed", "4")
    assert made.exit_code == 0, made.output
    recording = read_recording(Path("mended.csv"))
    assert_allclose(recording.readings_T, mended(run, mend, 4).readings_T, atol=1e-15)
    assert_array_equal(recording.time_s, run.time_s)
    assert_allclose(recording.temperature_C, run.temperature_C)
    assert read_array(Path("mended.array.yaml")).has_geometry_of(mend.calibration.array)
    assert f"{source}  what was added\nnext: tam compare mended.csv RECORDING --array mended.array.yaml" in made.output


def test_a_scenario_gets_what_it_lacks(simulate):
    """Its run is simulated and the mend is added to it; the truth has the effect, and the array the mend's noise."""
    assert simulate("auv", "-o", "plain.csv").exit_code == 0
    made = simulate("auv", "--from-comparison", "mend.yaml", "-o", "run.csv")
    assert made.exit_code == 0, made.output
    plain, full = (read_recording(Path(name)) for name in ("plain.csv", "run.csv"))
    added = full.readings_T - plain.readings_T
    drift = 7e-9 * (plain.temperature_C - 20)
    assert_allclose(np.std(added[:, 0, 0] - drift), 2e-9, rtol=0.1)
    assert_array_equal(added[:, 1:], 0)
    assert "temperature_drift" in Path("run.truth.yaml").read_text()
    assert_allclose(read_array(Path("run.array.yaml")).vector_noise_T, 1e-9)


def test_turned_sensors_stay_turned(simulate, run, mend):
    """A run of drivers that read turned sensors is mended in the array frame, and turned back."""
    turns = Mounting(np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.6, 0.8], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]))
    array = replace(mend.calibration.array, mounting=turns)
    turned = replace(mend, calibration=replace(mend.calibration, array=array))
    write_mend("turned.yaml", turned)
    write_recording(Path("drivers.csv"), array.mounting.inverse.turned(run))
    made = simulate("--from-comparison", "turned.yaml", "--recording", "drivers.csv", "-o", "mended.csv")
    assert made.exit_code == 0, made.output
    back = array.mounting.turned(read_recording(Path("mended.csv")))
    assert_allclose(back.readings_T, mended(run, mend, 0).readings_T, atol=1e-15)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--from-comparison", "mend.yaml", "-o", "o.csv"), "say what to simulate"),
        (("--recording", "sim.csv", "-o", "o.csv"), "needs --from-calibration or --from-comparison"),
        (("auv", "--recording", "sim.csv", "--from-comparison", "mend.yaml", "-o", "o.csv"), "takes the place"),
        (("auv", "--from-comparison", "mend.yaml", "--from-calibration", "mend.yaml", "-o", "o.csv"), "exclude each"),
        (("--from-comparison", "mend.yaml", "--recording", "sim.csv", "-o", "sim.csv"), "sim.csv"),
        (("--from-comparison", "mend.yaml", "--recording", "sim.csv", "-o", "mend.yaml"), "mend.yaml"),
        (("--from-comparison", "sim.csv", "--recording", "sim.csv", "-o", "o.csv"), "sim.csv"),
        (("wu_table_1", "--from-comparison", "mend.yaml", "-o", "o.csv"), "temperature_drift follows the temperature"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(simulate, words, sentence):
    """What cannot be done exits 2 with the reason; inputs stay, and no output is left."""
    before = {path.name: path.read_bytes() for path in Path().iterdir()}
    made = simulate(*words)
    assert made.exit_code == 2
    assert sentence in made.stderr and len(made.stderr.strip().splitlines()) == 1
    assert {path.name: path.read_bytes() for path in Path().iterdir()} == before
