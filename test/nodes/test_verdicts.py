"""calibrator/diagnose and calibrator/compare: what was collected against a model or a simulation, told and written."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.model.recording import Recording
from tam_calibration.recordings import write_array
from tam_calibration.results import write_recording

pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")

COUNT = 100


@pytest.fixture(scope="module")
def simulation(true_errors, tmp_path_factory):
    """Return the path of a simulator's recording: another path of the same array, in the same field."""
    rng = np.random.default_rng(2)
    direction = rng.normal(size=(COUNT, 3))
    field = 50e-6 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    readings = true_errors.distort(field) + 1e-9 * rng.normal(size=(COUNT, 4, 3))
    path = tmp_path_factory.mktemp("simulation") / "simulation.csv"
    write_recording(path, Recording(np.arange(COUNT) / 100, readings, 50e-6 + 1e-10 * rng.normal(size=COUNT)))
    return path


@pytest.fixture
def disturbed(recording):
    """Return a recording with a magnet at sensor 2 from its middle on."""
    recording = recording.take(slice(0, COUNT))
    readings = recording.readings_T.copy()
    readings[COUNT // 2 :, 1] += [20e-9, -10e-9, 15e-9]
    return replace(recording, readings_T=readings)


def test_a_gap_is_told_with_its_cause(board, disturbed, tmp_path):
    """A step of the bias is named in the answer and in /diagnostics, and the files that were named are written."""
    _, figures = board.bench.health("calibrator", lambda *_: True, "a status")
    assert figures["gap"] == "not diagnosed"
    path, page = tmp_path / "gap.json", tmp_path / "gap.html"
    board.play(disturbed, gap_file=path, gap_report_file=page)
    answer = board.ask("diagnose")
    assert answer.success, answer.message
    assert answer.message.startswith("Explained: ") and "sensor 2" in answer.message
    assert "\n" not in answer.message
    status, figures = board.bench.health(
        "calibrator", lambda _, figures: figures["gap"] == "explained", "the verdict is told"
    )
    assert status.level == b"\x01" and "sensor 2" in status.message
    content = json.loads(path.read_text())
    assert figures["gap_causes"] == content["causes"][0]["effect"] == "bias_jump"
    assert figures["set_95"] == " ".join(content["set_95"])
    assert float(figures["gap_after_T"]) < float(figures["gap_before_T"])
    assert np.isfinite(float(figures["gap_floor_T"]))
    assert page.read_text().startswith("<!DOCTYPE html>")


def test_what_the_simulation_lacks_is_told(board, disturbed, simulation, tmp_path):
    """A step of the bias is named in the answer, on one line, and the files that were named are written."""
    files = {
        "comparison_file": tmp_path / "compare.json",
        "comparison_report_file": tmp_path / "compare.html",
        "mend_file": tmp_path / "mend.yaml",
    }
    board.play(disturbed, simulation=simulation, **files)
    answer = board.ask("compare")
    assert answer.success, answer.message
    assert answer.message.startswith("Different: ") and "sensor 2" in answer.message and "\n" not in answer.message
    content = json.loads(files["comparison_file"].read_text())
    (missing,) = content["missing_in_simulation"]
    assert (missing["effect"], missing["sensors"]) == ("bias_jump", [2])
    assert content["simulation"]["name"] == "simulation.csv" and content["recording"] is None
    assert files["comparison_report_file"].read_text().startswith("<!DOCTYPE html>")
    assert "bias_jump" in files["mend_file"].read_text()


def test_no_file_that_is_read_is_overwritten(board, recording, simulation):
    """The mend would take the place of the simulation; without samples there is nothing to compare at all."""
    board.start_over(simulation=simulation)
    answer = board.ask("compare")
    assert not answer.success and "no samples" in answer.message
    board.play(recording.take(slice(0, 20)), simulation=simulation, mend_file=simulation)
    answer = board.ask("compare")
    assert not answer.success and "would be overwritten" in answer.message


def test_a_simulation_that_cannot_be_used_is_told(board, recording, cross, tmp_path):
    """One of three sensors, by its side."""
    write_recording(tmp_path / "three.csv", replace(recording, readings_T=recording.readings_T[:, :3]))
    write_array(tmp_path / "array.yaml", cross)
    files = {"simulation": tmp_path / "three.csv", "simulation_array_file": tmp_path / "array.yaml"}
    board.play(recording.take(slice(0, 20)), **files)
    answer = board.ask("compare")
    assert not answer.success
    assert answer.message.startswith("the simulation: ") and "3 sensors, not 4" in answer.message
