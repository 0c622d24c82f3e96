"""`tam play`: a bag into the nodes, as separate processes over DDS."""

import os
import signal
import sys
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.cli.main import main
from tam_calibration.recordings import read_recording
from tam_calibration.results import write_recording

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")

PLAY = ["-m", "tam_calibration", "play"]


@pytest.fixture(scope="module")
def bag(recording, tmp_path_factory):
    """Return a bag of the recording."""
    path = tmp_path_factory.mktemp("bag") / "run"
    write_recording(path, recording.take(slice(400)))
    return path


def rows_in(bag, topic):
    """Return the rows of the one-row clouds on a topic of a bag."""
    from tam_calibration.recordings.bag_reader import open_bag, raw_messages
    from tam_calibration.recordings.bag_writing import TYPESTORE

    with open_bag(bag) as reader:
        connections = [connection for connection in reader.connections if connection.topic == topic]
        clouds = [TYPESTORE.deserialize_cdr(data, each.msgtype) for each, _, data in raw_messages(reader, connections)]
    return np.array([np.frombuffer(cloud.data, "<f8") for cloud in clouds])


def play(bench, *arguments):
    """Play a bag to its end in a process, which must end well."""
    player = bench.fork({"player": [*PLAY, *arguments]})
    bench.spin_until(lambda: not player.is_running("player"), "the bag is played")
    assert player.end_one("player") == 0
    return player.log("player")


def test_played_bag_gives_what_offline_commands_give(bench, bag, tmp_path):
    """At 100 Hz no message is lost, the service calibrates, and field_gradient equals `tam correct` of the same bag."""
    from tam_calibration.nodes.topics import read_cloud

    path, offline = tmp_path / "calibration.yaml", tmp_path / "corrected.mcap"
    bench.start_nodes(collector={}, calibrator={"calibration_file": path}, corrector={})
    field_gradient = bench.listen(sensor_msgs.PointCloud2, "field_gradient")
    bench.connect(collector={"samples": 2}, corrector={"field_gradient": 1})
    play(bench, str(bag))
    _, figures = bench.health("collector", lambda _, figures: figures["samples"] == "400", "all samples are joined")
    assert figures["lost"] == figures["scalar.missing"] == "0"
    answer = bench.call("calibrator/calibrate")
    assert answer.success, answer.message
    assert bench.call("calibrator/save").success

    play(bench, str(bag), "--rate", "4")
    bench.spin_until(lambda: len(field_gradient) == 400, "every sample is corrected")
    result = CliRunner().invoke(main, ["correct", str(bag), "--calibration", str(path), "-o", str(offline)])
    assert result.exit_code == 0, result.output
    live = np.concatenate([read_cloud(cloud)[1] for cloud in field_gradient])
    assert_allclose(live, rows_in(offline, "/field_gradient"), rtol=1e-12)
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in field_gradient]
    assert_array_equal([stamp / 10**9 for stamp in stamps], read_recording(bag).time_s)


def test_loop_and_clock(bench, bag):
    """In a loop the samples begin anew, the bag's time is on /clock, and Ctrl-C ends the player well."""
    from rosgraph_msgs.msg import Clock

    bench.start_nodes(collector={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    bench.connect(collector={"samples": 1})
    player = bench.start({"player": [*PLAY, str(bag), "--rate", "5", "--loop", "--clock"]})
    clock = bench.listen(Clock, "/clock")
    bench.spin_until(lambda: len(samples) > 500, "the bag begins anew")
    assert player.end_one("player", signal.SIGINT) == 0
    assert 1.7e9 <= clock[-1].clock.sec <= 1.7e9 + 4

    def restarts():
        stamps = np.array([message.header.stamp.sec + message.header.stamp.nanosec / 1e9 for message in samples])
        return int((np.diff(stamps) < 0).sum())

    # A busy machine ends the player late: in another lap than the one that was waited for.
    bench.health("collector", lambda _, figures: int(figures["restarts"]) == restarts(), "all restarts are counted")
    assert restarts() >= 1


def test_use_sim_time(bench, bag):
    """A node with use_sim_time takes its time from the bag's /clock."""
    from diagnostic_msgs.msg import DiagnosticArray

    bench.start_nodes(collector={"use_sim_time": "true"})
    diagnostics = bench.listen(DiagnosticArray, "/diagnostics")
    bench.fork({"player": [*PLAY, str(bag), "--loop", "--clock"]})
    bench.spin_until(lambda: diagnostics and diagnostics[-1].header.stamp.sec > 0, "the clock arrives")
    assert 1.7e9 <= diagnostics[-1].header.stamp.sec <= 1.7e9 + 4


def test_nobody_listens_is_said(ros_domain, bag, monkeypatch):
    """Without a subscriber the bag is played all the same, and the player says who does not listen."""
    monkeypatch.setattr("tam_calibration.cli.nodes.PATIENCE_S", 0.1)
    result = CliRunner().invoke(main, ["play", str(bag), "--rate", "1000"])
    assert result.exit_code == 0, result.output
    assert "no subscriber for /tam_1/magnetic_field" in result.output and "2000 messages" in result.output


def test_damaged_bag_is_refused(ros_domain, bag, tmp_path):
    """What is no bag ends in one sentence and exit code 2."""
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    result = CliRunner().invoke(main, ["play", str(damaged)])
    assert result.exit_code == 2
    assert str(damaged) in result.output and len(result.output.splitlines()) == 1


def test_a_pause_of_centuries_is_no_traceback(ros_domain, tmp_path, recording, monkeypatch):
    """A clock that was set leaves one; no sleep lasts so long."""
    monkeypatch.setattr("tam_calibration.cli.nodes.PATIENCE_S", 0.1)
    monkeypatch.setattr("tam_calibration.nodes.player.DAY_S", 0.001)
    time_s = np.arange(20.0)
    time_s[10:] += 2e9
    write_recording(tmp_path / "bag.mcap", replace(recording.take(slice(20)), time_s=time_s))
    result = CliRunner().invoke(main, ["play", str(tmp_path / "bag.mcap"), "--rate", "0.001"])
    assert result.exit_code == 0 and "100 messages" in result.output
    result = CliRunner().invoke(main, ["play", str(tmp_path / "bag.mcap"), "--rate", "1e-320"])
    assert result.exit_code == 2 and "is not in the range" in result.stderr


def test_a_name_that_is_no_utf8_is_no_matter_of_ros(ros_domain, bag, tmp_path, monkeypatch):
    """ROS is not told the words of the command line, in which it would stumble over it."""
    monkeypatch.setattr("tam_calibration.cli.nodes.PATIENCE_S", 0.1)
    odd = tmp_path / os.fsdecode(b"\xff.db3")
    odd.write_bytes(next(bag.glob("*.db3")).read_bytes())
    monkeypatch.setattr(sys, "argv", ["tam", "play", str(odd)])
    result = CliRunner().invoke(main, ["play", str(odd), "--rate", "1000"])
    assert result.exit_code == 0, result.output


STRANGE_MAP = """
sensors: [{topic: /mag1}, {topic: /mag2}, {topic: /mag3}, {topic: /mag4}]
scalar: {topic: /overhauser, field: data, unit: nT}
"""


@pytest.mark.parametrize("way", ["map", "text"])
def test_any_recording_is_played_onto_the_topics_of_the_collector(bench, recording, tmp_path, way):
    """A bag of strange names by a map, and a text: the samples are those off line."""
    from inspected import fields, numbers, write_bag

    from test.nodes.test_streaming import rows_of

    part, options = recording.take(slice(100)), []
    path = tmp_path / ("run.csv" if way == "text" else "strange")
    if way == "text":
        write_recording(path, part)
    else:
        stamps_ns = np.round(part.time_s * 1e9).astype(np.int64)
        topics = {f"/mag{n + 1}": (fields(part.readings_T[:, n], stamps_ns), stamps_ns) for n in range(4)}
        write_bag(path, {"/overhauser": (numbers(part.scalar_T * 1e9), stamps_ns), **topics})
        (tmp_path / "map.yaml").write_text(STRANGE_MAP)
        options = ["--map", str(tmp_path / "map.yaml")]
    bench.start_nodes(collector={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    bench.connect(collector={"samples": 1})
    assert ("taken" in play(bench, str(path), "--rate", "2", *options)) == (way != "text")
    bench.spin_until(lambda: len(samples) == 100, "the samples")
    rows = rows_of(samples)
    assert_allclose(rows[:, 0], part.time_s, rtol=1e-15)
    assert_allclose(rows[:, 1:13], part.readings_T.reshape(100, 12), rtol=1e-12)
    assert np.isfinite(rows[:, 13]).mean() > 0.9
    assert set(np.round(rows[:, 13][np.isfinite(rows[:, 13])], 17)) <= set(np.round(part.scalar_T, 17))
