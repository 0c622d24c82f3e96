"""Nodes on a robot that has nothing but the packages of Ubuntu that rosdep installs."""

import os

import pytest
from core_only import CORE_ONLY
from ros_bench import node_command

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")


@pytest.fixture
def core_only(tmp_path, monkeypatch):
    """Let every process that the test starts have the core only."""
    (tmp_path / "sitecustomize.py").write_text(CORE_ONLY)  # every Python loads it when it starts
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))


def test_the_nodes_need_no_extra(core_only, bench, recording, tmp_path):
    """The chain calibrates and corrects, with a field of IGRF, and diagnoses."""
    parameters = {
        "collector": {},
        "corrector": {},
        "calibrator": {"gap_file": tmp_path / "gap.json"},
        "localizer": {"regional": "47.37,8.54,2025-06-30"},
    }
    bench.start({name: node_command(name, own) for name, own in parameters.items()})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    centers = bench.listen(sensor_msgs.MagneticField, "center")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 4}, corrector={"center": 1})
    bench.play(recording, publish, samples, last=60)
    bench.stored(60)
    answer = bench.call("calibrator/calibrate")
    assert answer.success, answer.message
    bench.health("corrector", lambda _, figures: "calibration_age_s" in figures, "the corrector has the calibration")
    bench.play(recording, publish, samples, first=60, last=70)
    bench.spin_until(lambda: len(centers) == 10, "the others come corrected")
    bench.stored(70)
    answer = bench.call("calibrator/diagnose")
    assert answer.success, answer.message
    assert (tmp_path / "gap.json").is_file()
