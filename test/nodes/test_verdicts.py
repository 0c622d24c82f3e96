"""calibrator/diagnose: what was collected against a model, told and written."""

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")

COUNT = 100


@pytest.fixture
def disturbed(recording):
    """Return a recording with a magnet at sensor 2 from its middle on."""
    recording = recording.take(slice(0, COUNT))
    readings = recording.readings_T.copy()
    readings[COUNT // 2 :, 1] += [20e-9, -10e-9, 15e-9]
    return replace(recording, readings_T=readings)


def test_a_gap_is_told_with_its_cause(board, disturbed, tmp_path):
    """A step of the bias is named in the answer and in /diagnostics, and the file that was named is written."""
    _, figures = board.bench.health("calibrator", lambda *_: True, "a status")
    assert figures["gap"] == "not diagnosed"
    path = tmp_path / "gap.json"
    board.play(disturbed, gap_file=path)
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


def test_no_file_is_written_over_another(board, recording, tmp_path):
    """The gap would take the place of the calibration."""
    path = tmp_path / "one.yaml"
    board.play(recording.take(slice(0, 20)), calibration_file=path, gap_file=path)
    answer = board.ask("diagnose")
    assert not answer.success and "would be overwritten" in answer.message
