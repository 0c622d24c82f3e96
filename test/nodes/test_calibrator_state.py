"""What a calibrator leaves to the one that takes its place, and what becomes of it."""

import json
import os
import re
import resource
import signal
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from ros_bench import node_command

from tam_calibration.results.sample_file import SampleFile

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")


def with_fifty(bench, recording, path):
    """Return a calibrator that has saved fifty samples, the collector's samples, and what publishes readings."""
    first = bench.start_nodes(calibrator={"samples_file": path})
    bench.start_nodes(collector={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=50)
    bench.health("calibrator", lambda _, figures: figures["saved"] == "50", "all are saved")
    return first, samples, publish


def test_a_calibrator_that_is_killed_is_taken_up_where_it_was(bench, recording, tmp_path):
    """After SIGKILL while samples flow, the next one has all that was saved, to the bit, goes on and calibrates."""
    recording = recording.take(slice(0, 150))
    path, moment = tmp_path / "samples", 75 + int(np.random.default_rng().integers(50))
    first, samples, publish = with_fifty(bench, recording, path)
    bench.play(recording, publish, samples, first=50, last=moment)
    first.end_one("calibrator", signal.SIGKILL)

    second = bench.start_nodes(calibrator={"samples_file": path})
    bench.connect(collector={"samples": 2})
    _, figures = bench.health("calibrator", lambda _, figures: True, "it is there")
    kept = int(figures["samples"])
    assert 50 <= kept <= moment
    told = f"goes on with {kept} samples of {path}"
    bench.spin_until(lambda: told in second.log("calibrator"), "it says that it goes on")
    bench.play(recording, publish, samples, first=moment)
    stored = kept + recording.sample_count - moment
    bench.stored(stored)
    assert bench.call("calibrator/calibrate").success
    bench.health("calibrator", lambda _, figures: figures["saved"] == str(stored), "the others are saved")
    assert second.end_one("calibrator") == 0
    rows = np.array([sample.row for sample in _content(path)])
    sent = recording.readings_T.reshape(-1, 12)
    assert_array_equal(rows[:, 1:13], np.concatenate([sent[:kept], sent[moment:]]))


def test_samples_of_an_earlier_run_do_not_vanish_without_a_line(bench, recording, tmp_path):
    """Those that come two hours later are another run: how many are discarded is logged."""
    path = tmp_path / "samples"
    first, samples, publish = with_fifty(bench, recording, path)
    assert first.end_one("calibrator") == 0
    second = bench.start_nodes(calibrator={"samples_file": path})
    bench.connect(collector={"samples": 2})
    bench.play(replace(recording, time_s=recording.time_s + 7200), publish, samples, last=20)
    told = "50 samples of an earlier run are discarded"
    bench.spin_until(lambda: told in second.log("calibrator"), "it is told")
    assert re.search(r"goes on with 50 samples of .*, the last of \d+ days ago", second.log("calibrator"))
    bench.stored(20)


def test_a_reset_holds_on_disk(bench, recording, tmp_path):
    """A calibrator that starts after collector/reset has nothing to go on with."""
    path = tmp_path / "samples"
    first, _, _ = with_fifty(bench, recording, path)
    assert bench.call("collector/reset").success
    bench.health("calibrator", lambda _, figures: figures["saved"] == "0", "none is left")
    assert first.end_one("calibrator") == 0
    assert _content(path) == []


def test_samples_of_another_array_stay_where_they_are(bench, tmp_path):
    """They are set aside and named; without a samples_file they are kept in ROS's own folder, or nowhere."""
    path = tmp_path / "samples"
    path.write_text("no samples")
    log = log_of_calibrator(bench, samples_file=path)
    assert (tmp_path / "samples.1").read_text() == "no samples"
    assert f"{path} held no samples of this array: it is now {path}.1" in log
    log = log_of_calibrator(bench)
    [own] = (bench.logs / "tam_calibration").glob("*.calibrator.samples")
    assert f"keeps samples in {own}" in log
    assert "samples are not kept for a restart" in log_of_calibrator(bench, samples_file="none")


def log_of_calibrator(bench, **parameters):
    """Start a calibrator, end it when it has said that it is ready, and return what it logged."""
    children = bench.start_nodes(calibrator=parameters)
    bench.spin_until(lambda: "waits for samples" in children.log("calibrator"), "it is ready")
    assert children.end_one("calibrator") == 0
    return children.log("calibrator")


def test_a_disk_that_cannot_be_written_costs_no_calibration(bench, recording, tmp_path):
    """The calibrator says at WARN that samples are not kept and why, and works as ever."""
    (tmp_path / "file").touch()
    bench.start_nodes(collector={}, calibrator={"samples_file": tmp_path / "file" / "samples"})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=60)
    bench.stored(60)
    assert bench.call("calibrator/calibrate").success
    status, _ = bench.health("calibrator", lambda _, figures: figures["samples"] == "60", "it is told")
    assert status.level == b"\x01" and "name another samples_file, or none" in status.message


def _content(path):
    """Return the samples of a file, whatever they are of."""
    text = path.read_bytes().partition(b"\n")[0].partition(b"{")
    about = json.loads(text[1] + text[2])
    node = about.pop("node")
    samples, is_whole = SampleFile(path, node, about, len(about["columns"])).read()
    assert is_whole
    return samples


def test_a_damaged_file_is_gone_on_with(bench, recording, tmp_path):
    """A bit of a row, and the head of what was learned: both are set aside and told, the other samples are used."""
    path = tmp_path / "samples"
    first, samples, publish = with_fifty(bench, recording, path)
    assert first.end_one("calibrator") == 0
    content = bytearray(path.read_bytes())
    content[-1000] ^= 1
    path.write_bytes(content)
    archive = BytesIO()
    np.savez(archive, about=np.array("{}"))
    (tmp_path / "samples.live").write_bytes(archive.getvalue().replace(b"PK\x03\x04", b"PK\x03\x04\xff\xff\xff\xff", 1))

    second = bench.start_nodes(calibrator={"samples_file": path, "update": True})
    told = f"{path} is damaged: it is now {path}.1, and 49 samples of it are used"
    status, _ = bench.health("calibrator", lambda _, figures: figures["saved"] == "49", "it goes on")
    assert told in second.log("calibrator") and told in status.message and status.level == b"\x01"
    assert f"it is now {path}.live.1, and the update begins anew" in second.log("calibrator")
    assert (tmp_path / "samples.1").read_bytes() == content
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, first=50, last=100)
    bench.health("calibrator", lambda _, figures: figures["saved"] == "99", "the others are saved")
    assert second.end_one("calibrator") == 0
    assert len(_content(path)) == 99


def test_a_disk_that_is_full_for_a_while_costs_nothing(bench, recording, tmp_path):
    """What is not kept meanwhile is told with its number, at WARN, and kept as soon as there is room."""
    path = tmp_path / "samples"
    nodes, samples, publish = with_fifty(bench, recording, path)
    pid = nodes.pids["calibrator"]
    room = path.stat().st_size + 10  # less than a sample takes
    _, most = resource.prlimit(pid, resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
    bench.play(recording, publish, samples, first=50, last=150)
    told = "100 samples are not on disk, which is tried again: samples cannot be kept in"
    status, _ = bench.health("calibrator", lambda status, _: told in status.message, "it is told")
    assert status.level == b"\x01" and "File too large" in status.message
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (most, most))
    bench.play(recording, publish, samples, first=150, last=200)
    status, _ = bench.health("calibrator", lambda _, figures: figures["saved"] == "200", "all are saved")
    assert "not on disk" not in status.message
    bench.spin_until(lambda: f"samples are kept in {path} again" in nodes.log("calibrator"), "that is told too")
    assert nodes.end_one("calibrator") == 0
    rows = np.array([sample.row for sample in _content(path)])
    assert_array_equal(rows[:, 1:13], recording.readings_T[:200].reshape(-1, 12))


def test_two_nodes_with_one_file_have_one_each(bench, recording, tmp_path):
    """The second does not go on with the samples of the first, and says where it keeps its own."""
    path = tmp_path / "samples"
    first, _, _ = with_fifty(bench, recording, path)
    command = [*node_command("calibrator", {"samples_file": path}), "-r", "__ns:=/b"]
    second = bench.fork({"other": command})
    own = tmp_path / f"samples.{os.environ['ROS_DOMAIN_ID']}.b.calibrator"
    told = f"{path} is of another node: this one has {own}"
    bench.spin_until(lambda: "waits for samples" in second.log("other"), "it is ready")
    assert told in second.log("other") and "goes on with" not in second.log("other")
    assert second.end_one("other") == 0 and _content(own) == []
    assert first.end_one("calibrator") == 0 and len(_content(path)) == 50
