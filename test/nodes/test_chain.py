"""The nodes as separate processes over DDS: what they make of good data, and how they survive bad ones."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ros_bench import rows_of

from tam_calibration.correction.streaming import correct
from tam_calibration.fit import calibrate
from tam_calibration.messages.point_cloud import FIELD_GRADIENT_COLUMNS, GRADIENT_ROW_MAJOR
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.results import calibration_from_yaml, calibration_to_yaml, read_calibration, write_calibration

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
visualization_msgs = pytest.importorskip("visualization_msgs.msg", reason="the ROS message packages are not installed")
std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")

RELATIVE = 1e-12


def stamps_of(messages):
    """Return the stamps of messages, nanoseconds."""
    return [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in messages]


def publisher_of(bench, text):
    """Publish a string on the latched topic `calibration`, as another calibrator would."""
    from tam_calibration.nodes.topics import LATCHED

    publisher = bench.node.create_publisher(std_msgs.String, "calibration", LATCHED)
    publisher.publish(std_msgs.String(data=text))


@pytest.fixture(scope="module")
def calibration(recording, cross):
    """Return the calibration of the recording."""
    return calibrate(recording, cross)


@pytest.fixture
def calibration_file(calibration, tmp_path):
    """Return the path of the calibration's file."""
    path = tmp_path / "calibration.yaml"
    write_calibration(path, calibration)
    return path


def test_service_calibrates_what_the_sensors_published(bench, recording, cross):
    """Every sample is synchronised, and the latched calibration equals the fit of the same recording offline."""
    recording = recording.take(slice(0, 150))
    bench.start_nodes(collector={}, calibrator={}, corrector={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 3})
    bench.play(recording, publish, samples)
    bench.health("calibrator", lambda status, _: "150 samples" in status.message, "every sample is stored")
    answer = bench.call("calibrator/calibrate")
    assert answer.success, answer.message
    assert "noise floor" in answer.message and "\n" not in answer.message
    assert_array_equal(rows_of(samples)[:, 1:13], recording.readings_T.reshape(-1, 12))
    assert_allclose(rows_of(samples)[:, 13], recording.scalar_T, rtol=1e-15)

    late = bench.listen(std_msgs.String, "calibration", latched=True)
    bench.spin_until(lambda: late, "a late joiner gets the calibration")
    assert_allclose(
        calibration_from_yaml(late[0].data, "topic").errors.to_vector(),
        calibrate(recording, cross).errors.to_vector(),
        rtol=0,
        atol=1e-12,
    )
    bench.health("corrector", lambda status, _: "calibration" not in status.message, "the corrector has it too")


def test_a_sensor_that_contradicts_the_others_is_left_out(bench, recording, calibration_file):
    """Without a scalar too, from its first wrong sample on; status and log name it, and both end where it agrees."""
    children = bench.start_nodes(collector={}, corrector={"calibration_file": calibration_file})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    field_gradient = bench.listen(sensor_msgs.PointCloud2, "field_gradient")
    publish = bench.publish_sensors(scalar=False)
    bench.connect(collector={"samples": 2}, corrector={"field_gradient": 1})
    readings_T = recording.readings_T.copy()
    readings_T[20:40, 1] *= -1
    wrong = Recording(recording.time_s, readings_T)
    bench.play(wrong, publish, samples, last=40)
    told = "sensor 2 contradicts the others: outputs are those of the others"
    status, figures = bench.health("corrector", lambda status, _: told in status.message, "it is named")
    assert status.level == b"\x01" and figures["contradicting_sensors"] == "2"
    bench.play(wrong, publish, samples, first=40, last=60)
    bench.spin_until(lambda: len(field_gradient) == 60, "all are corrected")
    offline = correct(wrong.take(slice(0, 60)), read_calibration(calibration_file))
    assert_allclose(rows_of(field_gradient)[:, :9], offline.outputs, rtol=1e-9, atol=1e-18)
    assert offline.remarks == (
        "20 of 60 readings of sensor 2 contradict the others and are left out, first at 0.20, 0.21, 0.22 s",
    )
    bench.health("corrector", lambda status, _: told not in status.message, "it agrees again")
    assert f"sensor 2 contradicts the others at {recording.time_s[20]:.2f} s" in children.log("corrector")


def test_outputs_equal_those_offline(bench, recording, calibration_file):
    """Each sample's centre and gradient are those of `Calibration.correct`, at the sample's stamp."""
    bench.start_nodes(collector={}, corrector={"calibration_file": calibration_file})
    offline = read_calibration(calibration_file).correct(recording)
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    center = bench.listen(sensor_msgs.MagneticField, "center")
    gradient = bench.listen(std_msgs.Float64MultiArray, "gradient")
    field_gradient = bench.listen(sensor_msgs.PointCloud2, "field_gradient")
    arrows = bench.listen(visualization_msgs.Marker, "center_marker")
    coverages = bench.listen(visualization_msgs.MarkerArray, "coverage_markers")
    publish = bench.publish_sensors()
    outputs_heard = {"center": 1, "gradient": 1, "field_gradient": 1, "center_marker": 1}
    bench.connect(collector={"samples": 2, "coverage_markers": 1}, corrector=outputs_heard)
    bench.play(recording, publish, samples, last=60)
    bench.spin_until(lambda: min(len(center), len(gradient), len(field_gradient)) == 60, "all are corrected")

    outputs = offline.outputs[:60]
    errors = np.tile(offline.standard_errors, (60, 1))
    assert_allclose(rows_of(field_gradient), np.hstack([outputs, errors]), rtol=RELATIVE)
    assert [field.name for field in field_gradient[0].fields] == list(FIELD_GRADIENT_COLUMNS)
    assert stamps_of(field_gradient) == stamps_of(center) == stamps_of(samples)
    assert_allclose(
        [[m.magnetic_field.x, m.magnetic_field.y, m.magnetic_field.z] for m in center], outputs[:, :3], rtol=RELATIVE
    )
    assert_allclose(np.sqrt(np.diag(np.reshape(center[0].magnetic_field_covariance, (3, 3)))), errors[0, :3])
    assert_allclose([message.data for message in gradient], outputs[:, GRADIENT_ROW_MAJOR], rtol=RELATIVE)
    assert center[0].header.frame_id == field_gradient[0].header.frame_id == "tam_array"
    assert 0 < len(arrows) < 60 and {arrow.header.frame_id for arrow in arrows} == {"tam_array"}
    tips = [[arrow.points[1].x, arrow.points[1].y, arrow.points[1].z] for arrow in arrows]
    shown = [stamps_of(center).index(stamp) for stamp in stamps_of(arrows)]
    assert_allclose(tips, 1e4 * outputs[shown, :3], rtol=RELATIVE)
    bench.health(
        "corrector", lambda status, _: "noise floor" in status.message, "the residual is compared with the floor"
    )
    coverages.clear()
    bench.spin_until(lambda: len(coverages) == 2, "the coverage is shown every second")
    first, second = stamps_of([message.markers[0] for message in coverages])
    assert 0.5e9 < second - first < 1.5e9
    covered, missing = coverages[-1].markers
    _, figures = bench.health("collector", lambda *_: True, "it tells the coverage")
    assert len(covered.points) / (len(covered.points) + len(missing.points)) == float(figures["fraction"])
    assert covered.header.frame_id == "tam_array"


def test_new_calibration_switches_without_a_gap(bench, recording, calibration):
    """Every sample is corrected by the old or the new calibration; one that cannot be used leaves the old in force."""
    bench.start_nodes(collector={}, corrector={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    outputs = bench.listen(sensor_msgs.PointCloud2, "field_gradient")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2}, corrector={"field_gradient": 1})
    publisher_of(bench, calibration_to_yaml(calibration))
    bench.health("corrector", lambda status, _: "no calibration yet" not in status.message, "the first is taken")
    bench.play(recording, publish, samples, last=20)

    other = replace(calibration, errors=replace(calibration.errors, bias_T=calibration.errors.bias_T + 1e-7))
    publisher_of(bench, calibration_to_yaml(other))
    bench.play(recording, publish, samples, first=20, last=60)
    publisher_of(bench, "method: [")
    status, _ = bench.health("corrector", lambda status, _: "was not taken" in status.message, "the broken one is told")
    assert status.level == b"\x01"
    publisher_of(bench, calibration_to_yaml(replace(calibration, array=Array.cross(0.7, 1e-9, 1e-10))))
    bench.health("corrector", lambda status, _: "another array" in status.message, "that of another array is told too")
    bench.play(recording, publish, samples, first=60, last=80)
    bench.spin_until(lambda: len(outputs) == 80, "all are corrected")

    live = rows_of(outputs)[:, :9]
    by_old, by_new = (each.apply(recording.readings_T[:80]) for each in (calibration, other))
    is_old, is_new = (np.isclose(live, each, rtol=1e-10, atol=0).all(axis=1) for each in (by_old, by_new))
    assert (is_old ^ is_new).all()
    assert is_old[:20].all() and is_new[60:].all()
    assert (np.diff(is_new.astype(int)) >= 0).all()


def test_silent_sensor_is_named_until_it_restarts(bench, recording):
    """A sensor that stops is named at ERROR, the service still answers, and whole samples go on when it restarts."""
    bench.start_nodes(collector={"silence_s": 0.5}, calibrator={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    others, second = bench.publish_sensors((1, 3, 4)), bench.publish_sensors((2,), scalar=False)
    bench.connect(collector={"samples": 2})
    active = [others, second]
    bench.stream(recording, active)
    bench.spin_until(lambda: len(samples) >= 5, "samples arrive")
    active.remove(second)
    status, figures = bench.health(
        "collector",
        lambda status, _: status.level == b"\x02" and "tam_2" in status.message,
        "the silent sensor is named",
    )
    assert "tam_3" not in status.message
    assert int(figures["tam_2.missing"]) > 0
    answer = bench.call("calibrator/calibrate")
    assert not answer.success and "samples" in answer.message
    active.append(second)
    bench.health("collector", lambda status, _: "nothing from" not in status.message, "nothing is silent")
    before = len(samples)
    bench.spin_until(lambda: len(samples) > before + 20, "samples go on")
    assert np.isfinite(rows_of(samples[before:])[:, 1:13]).all()


def test_stamps_backwards_start_over(board, recording):
    """When a bag loops, samples go on from its start, and the calibrator stores those of the new run only."""
    board.play(recording.take(slice(0, 60)))
    before = len(board.samples)
    board.bench.play(recording, board.publish, board.samples, last=30)
    assert_array_equal(rows_of(board.samples[before:])[:, 1:13], recording.readings_T[:30].reshape(-1, 12))
    _, figures = board.bench.health("collector", lambda *_: True, "the restart is told")
    assert figures["restarts"] == "1" and figures["lost"] == "0"
    board.bench.health("calibrator", lambda status, _: "30 samples" in status.message, "30 samples are stored")


def test_losses_are_counted(board, recording):
    """Samples in an outage of one sensor, too long to be told by what it read before and after, are told in words."""
    board.start_over()
    before = len(board.samples)
    for index in range(60):
        board.others(recording, index)
        if not 25 <= index < 35:
            board.third(recording, index)
    board.bench.spin_until(lambda: len(board.samples) == before + 50, "50 samples")
    _, figures = board.bench.health("collector", lambda _, figures: figures["samples"] == "50", "they are counted")
    assert figures["tam_3.missing"] == figures["tam_1.unmatched"] == "10"
    assert "tam_3" in figures["losses"]


def test_other_scalar_type_is_told(bench, recording):
    """A scalar of the other message type is not silently missed: /diagnostics and the log name it."""
    children = bench.start_nodes(collector={})
    publisher = bench.node.create_publisher(std_msgs.Float64, "scalar/intensity", 10)
    bench.stream(recording, [bench.publish_sensors(scalar=False)])
    status, _ = bench.health("collector", lambda status, _: "std_msgs/Float64" in status.message, "the type is told")
    assert "scalar_type:=std_msgs/Float64" in status.message
    assert "scalar/intensity is published as std_msgs/msg/Float64, not sensor_msgs/msg/MagneticField" in status.message
    told = "]: scalar/intensity is published as std_msgs/msg/Float64"
    lines = [line for line in children.log("collector").splitlines() if told in line]
    assert len(lines) == 1 and "[WARN]" in lines[0]
    bench.node.destroy_publisher(publisher)


def test_unstamped_scalar_joins_the_next_sample(bench, recording):
    """A Float64 scalar has no stamp: its value joins one sample, the next after it."""
    bench.start_nodes(collector={"scalar_type": "std_msgs/Float64"})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publisher = bench.node.create_publisher(std_msgs.Float64, "scalar/intensity", 10)
    bench.spin_until(publisher.get_subscription_count, "the scalar is subscribed")
    publish = bench.publish_sensors(scalar=False)
    bench.connect(collector={"samples": 1})
    publish(recording, 0)
    publisher.publish(std_msgs.Float64(data=4.9e-5))
    bench.spin_until(lambda: samples, "the first sample")
    bench.play(recording, publish, samples, first=1, last=20)
    scalar_T = rows_of(samples)[:, 13]
    assert scalar_T[np.isfinite(scalar_T)].tolist() == [4.9e-5] and np.isfinite(scalar_T[:2]).any()
