"""calibrator/diagnose: the verdict on what was collected, in the answer, in /diagnostics and in files."""

import json

import numpy as np
import pytest

from tam_calibration.model.recording import Recording

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")


@pytest.fixture
def disturbed(recording):
    """Return the recording with a magnet at sensor 2 from its middle on."""
    recording = recording.take(slice(0, 300))
    readings = recording.readings_T.copy()
    readings[150:, 1] += [20e-9, -10e-9, 15e-9]
    return Recording(recording.time_s, readings, recording.scalar_T)


def ask(bench, meanwhile=lambda: None):
    """Call calibrator/diagnose, do something while it works, and return its response."""
    from std_srvs.srv import Trigger

    client = bench.node.create_client(Trigger, "calibrator/diagnose")
    bench.spin_until(client.service_is_ready, "calibrator/diagnose is there")
    future = client.call_async(Trigger.Request())
    meanwhile()
    bench.spin_until(future.done, "calibrator/diagnose answers", timeout_s=120.0)
    return future.result()


def test_a_gap_is_told_with_its_cause(bench, disturbed, tmp_path):
    """A step of the bias is named in the answer and in /diagnostics, and the files that were named are written."""
    files = {"gap_file": tmp_path / "gap.json", "gap_report_file": tmp_path / "gap.html"}
    bench.start_nodes(collector={}, calibrator=files)
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    _, figures = bench.health("calibrator", lambda status, figures: True, "a status")
    assert figures["gap"] == "not diagnosed"
    bench.play(disturbed, publish, samples)
    answer = ask(bench)
    assert answer.success, answer.message
    assert answer.message.startswith("Explained: ") and "sensor 2" in answer.message
    assert "\n" not in answer.message
    status, figures = bench.health(
        "calibrator", lambda _, figures: figures["gap"] == "explained", "the verdict is told"
    )
    assert status.level == b"\x01" and "sensor 2" in status.message
    assert figures["gap_causes"] == "bias_jump"
    assert figures["set_95"] == " ".join(json.loads(files["gap_file"].read_text())["set_95"])
    assert float(figures["gap_after_T"]) < float(figures["gap_before_T"])
    assert json.loads(files["gap_file"].read_text())["causes"][0]["effect"] == "bias_jump"
    assert files["gap_report_file"].read_text().startswith("<!DOCTYPE html>")


def test_samples_are_stored_during_a_diagnosis(bench, recording):
    """What arrives while the diagnosis works is not lost."""
    bench.start_nodes(collector={}, calibrator={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=300)
    assert ask(bench, lambda: bench.play(recording, publish, samples, first=300, last=400)).success
    _, figures = bench.health("calibrator", lambda _, figures: figures["samples"] == "400", "all samples are stored")
    assert np.isfinite(float(figures["gap_floor_T"]))


def test_nothing_to_diagnose_is_said(bench):
    """Without samples the answer is no, with what would mend it."""
    bench.start_nodes(calibrator={})
    answer = bench.call("calibrator/diagnose")
    assert not answer.success and "no samples" in answer.message
