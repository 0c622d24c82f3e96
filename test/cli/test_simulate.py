"""The command `tam simulate`."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.cli.main import main
from tam_calibration.files.text_files import configuration_folder
from tam_calibration.recordings import read_array, read_recording
from tam_calibration.results import read_calibration
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Return a function that runs `tam simulate` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *words: CliRunner().invoke(main, ["simulate", *words])


def test_csv_with_array_and_truth_beside_it(run):
    """The recording, its array file and the truth are written, and the next command is told."""
    result = run("wu_table_1", "-o", "run.csv")
    assert result.exit_code == 0, result.output
    assert {path.name for path in Path().iterdir()} == {"run.csv", "run.array.yaml", "run.truth.yaml"}
    assert "360 samples of 4 sensors with scalar in 359 s, field 54955.83 nT, seed 1" in result.output
    assert "next: tam calibrate run.csv --array run.array.yaml -o run.calibration.yaml" in result.output
    made = simulate(read_scenario("wu_table_1"))
    assert_allclose(read_recording(Path("run.csv")).readings_T, made.recording.readings_T, atol=1e-15)
    assert read_array(Path("run.array.yaml")).has_geometry_of(made.scenario.array)


@pytest.mark.parametrize("output", ["run", "run.mcap"])
def test_bags(run, output):
    """A bag has the same samples as the simulation, as a folder and as one file."""
    result = run("wu_turntable", "-o", output)
    assert result.exit_code == 0, result.output
    assert Path("run.truth.yaml").exists() and Path("run.array.yaml").exists()
    recording = read_recording(Path(output))
    made = simulate(read_scenario("wu_turntable")).recording
    assert_allclose(recording.readings_T, made.readings_T, atol=1e-18)
    assert_allclose(recording.scalar_T, made.scalar_T, atol=1e-18)
    assert_allclose(np.diff(recording.time_s), 20)


def test_seed_changes_the_noise_and_is_written_down(run):
    """--seed overrides the scenario's and stands in the result."""
    results = [run("wu_turntable", "-o", f"{name}.csv", "--seed", "7", "--json") for name in ("a", "b")]
    assert [json.loads(result.stdout)["seed"] for result in results] == [7, 7]
    assert Path("a.csv").read_bytes() == Path("b.csv").read_bytes()
    run("wu_turntable", "-o", "c.csv")
    assert Path("a.csv").read_bytes() != Path("c.csv").read_bytes()
    assert "seed: 7" in Path("a.truth.yaml").read_text()


def test_json_tells_what_was_made(run):
    """A program gets counts, channels and paths, and nothing else on its standard output."""
    made = json.loads(run("auv", "-o", "dive.csv", "--json").stdout)
    assert made["samples"] == 6000 and made["sensors"] == 4
    assert made["channels"] == ["scalar", "temperature", "current", "attitude"]
    assert [made[name] for name in ("recording", "array", "truth")] == [
        "dive.csv",
        "dive.array.yaml",
        "dive.truth.yaml",
    ]


def test_a_scenario_of_ones_own(run):
    """A scenario file is taken by its path."""
    Path("mine.yaml").write_text(
        "array: {positions_m: [[0, 0, 0]]}\nsite: {intensity_nT: 50000, inclination_deg: 60}\n"
        "motion: {kind: random}\nsamples: 30\nrate_hz: 5\n"
    )
    assert run("mine.yaml", "-o", "mine.csv").exit_code == 0
    recording = read_recording(Path("mine.csv"))
    assert_array_equal([recording.sample_count, recording.sensor_count], [30, 1])
    assert recording.scalar_T is None


def test_turned_sensors_are_simulated_and_turned_back(run):
    """What the drivers of a turned array would record is calibrated and imitated as that of one that is not turned."""
    text = (configuration_folder() / "scenarios" / "wu_table_1.yaml").read_text()
    rotations = "rotations_deg: [[0, 0, 0], [0, 0, 90], [180, 0, 30], [10, -20, 130]]"
    Path("turned.yaml").write_text(text.replace("{baseline_m: 0.5", f"{{{rotations}, baseline_m: 0.5"))
    matrices = []
    for name in ("wu_table_1", "turned.yaml"):
        assert run(name, "-o", "run.csv").exit_code == 0
        words = ["calibrate", "run.csv", "--array", "run.array.yaml", "-o", "calibration.yaml"]
        assert CliRunner().invoke(main, words).exit_code == 0
        matrices.append(read_calibration(Path("calibration.yaml")).errors.matrix)
    assert_allclose(matrices[1], matrices[0], atol=1e-9)
    drivers, array = read_recording(Path("run.csv")), read_array(Path("run.array.yaml"))
    assert run("--from-calibration", "calibration.yaml", "--recording", "run.csv", "-o", "twin.csv").exit_code == 0
    assert_allclose(read_recording(Path("twin.csv")).readings_T, drivers.readings_T, atol=2e-8)
    assert not np.allclose(array.mounting.turned(drivers).readings_T, drivers.readings_T, atol=1e-6)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("wu_table_2", "-o", "run.csv"), "no scenario of that name"),
        (("broken.yaml", "-o", "run.csv"), "the key 'samples' is missing"),
        (("wu_table_1", "-o", "nowhere/run.csv"), "nowhere"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(run, words, sentence):
    """What cannot be done exits 2 with the reason, and no file is left."""
    Path("broken.yaml").write_text(
        "array: {baseline_m: 1}\nsite: {intensity_nT: 1, inclination_deg: 6}\nmotion: {kind: random}\nrate_hz: 1\n"
    )
    result = run(*words)
    assert result.exit_code == 2
    assert sentence in result.stderr and len(result.stderr.strip().splitlines()) == 1
    assert {path.name for path in Path().iterdir()} == {"broken.yaml"}
