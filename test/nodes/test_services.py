"""The services of the nodes: what they do, and the reason that they give when they cannot."""

import pytest
from numpy.testing import assert_allclose

from tam_calibration.files import calibration_from_yaml, read_calibration

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")


def test_reset_starts_over(bench, recording):
    """collector/reset empties coverage, losses and the calibrator's store."""
    bench.start_nodes(collector={}, calibrator={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=200)
    _, figures = bench.health("collector", lambda status, _: True, "coverage is told")
    assert float(figures["fraction"]) > 0.3
    assert bench.call("collector/reset").success
    bench.play(recording, publish, samples, first=200, last=220)
    _, figures = bench.health("collector", lambda status, _: True, "coverage is told")
    assert float(figures["fraction"]) < 0.15 and figures["samples"] == "20"
    bench.health("calibrator", lambda status, _: "20 samples" in status.message, "20 samples are stored")


def test_save_writes_what_was_calibrated(bench, recording, tmp_path):
    """calibrator/save writes the file that it was given, which the next calibrator hands on from its start."""
    path = tmp_path / "calibration.yaml"
    first = bench.start_nodes(collector={}, calibrator={"calibration_file": path})
    answer = bench.call("calibrator/save")
    assert not answer.success and "calibrator/calibrate" in answer.message and not path.exists()
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples)
    assert bench.call("calibrator/calibrate").success
    answer = bench.call("calibrator/save")
    assert answer.success and str(path) in answer.message
    assert first.end_one("calibrator") == 0

    bench.start_nodes(calibrator={"calibration_file": path})
    latched = bench.listen(std_msgs.String, "calibration", latched=True)
    bench.spin_until(lambda: latched, "the loaded calibration is handed on")
    assert_allclose(
        calibration_from_yaml(latched[0].data, "topic").errors.to_vector(),
        read_calibration(path).errors.to_vector(),
        rtol=0,
        atol=1e-15,
    )


def test_services_answer_with_the_reason_when_there_is_nothing(bench):
    """Without samples, calibration or path the services say what is missing."""
    bench.start_nodes(calibrator={})
    answer = bench.call("calibrator/calibrate")
    assert not answer.success and "no samples" in answer.message
    answer = bench.call("calibrator/save")
    assert not answer.success and "no calibration" in answer.message
