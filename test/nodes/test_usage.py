"""How many of sensor 1's samples were used: the calibrator's answers over DDS, with what the collector counted."""

import re
from dataclasses import replace

import pytest

from tam_calibration.results import calibration_from_yaml

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")

COUNT = 160


def play(board, recording, lost=0, of=20):
    """Play a part of the recording, of which so many readings of sensor 3 in so many are lost."""
    bench, samples = board.bench, board.samples
    board.start_over()
    before, used = len(samples), 0
    for index in range(COUNT):
        board.others(recording, index)
        if index % of >= lost:
            board.third(recording, index)
            used += 1
        bench.spin_until(lambda wanted=before + used - 20: len(samples) >= wanted, f"sample {index} comes back")
    is_heard = {"tam_1.received": str(COUNT), "tam_3.received": str(used)}.items()
    bench.health("collector", lambda _, figures: is_heard <= figures.items(), "all is received")
    bench.spin_until(lambda: len(samples) == before + used, "all samples come back")
    bench.stored(used)


def test_an_answer_tells_that_all_were_used(board, recording):
    """Without losses there is nothing else to tell."""
    play(board, recording)
    answer = board.ask("calibrate")
    assert answer.success and answer.message.endswith("160 samples; 160 of 160 samples of sensor 1 used")


def test_below_nine_tenths_is_a_warning(board, recording):
    """In the answer, and in the calibration that is handed on."""
    play(board, recording, lost=10, of=40)
    answer = board.ask("calibrate")
    warning = "only 120 of 160 samples of sensor 1 used: 40 found none of tam_3, of which 120 messages came"
    assert answer.success and warning in answer.message
    latched = board.bench.listen(std_msgs.String, "calibration", latched=True)
    board.bench.spin_until(lambda: latched, "the calibration is handed on")
    assert warning in calibration_from_yaml(latched[0].data, "topic").warnings[0]


def test_below_half_is_refused(board, recording):
    """By every service, with the cause; after a reset nothing of it is left."""
    play(board, recording, lost=12, of=20)
    for service in ("calibrate", "diagnose"):
        answer = board.ask(service)
        assert not answer.success
        assert "only 64 of 160 samples of sensor 1 used: 96 found none of tam_3" in answer.message
    board.start_over()
    assert '"used": 0, "received": 0' in board.bench.call("collector/usage").message


def test_a_run_that_has_just_begun_is_no_fault_of_the_load(board, recording):
    """Too few readings have come to join any: the answer is to go on."""
    board.start_over()
    for index in range(3):
        board.others(recording, index)
    board.bench.health("collector", lambda _, figures: figures.get("tam_1.received") == "3", "they have come")
    answer = board.ask("calibrate")
    told = "just started: 3 readings of each sensor have come, keep turning"
    assert not answer.success and answer.message == told


def test_readings_in_another_unit_are_missing_from_the_first_on(board, recording):
    """Neither coverage nor fit see them, be they the first of a run; the answer has one reason for them."""
    wrong = replace(recording, readings_T=1e9 * recording.readings_T, time_s=recording.time_s - 1.0)
    board.start_over()
    for index in range(15):
        board.publish(wrong, index)
    board.go_on(recording.take(slice(0, COUNT)))
    answer = board.ask("calibrate")
    assert answer.success and answer.message.startswith("Good")
    reason = "15 are beyond what any sensor reads: look at the driver of tam_1"
    assert f"160 of 175 samples of sensor 1 used: {reason}" in answer.message and "damaged" not in answer.message


def test_a_clock_that_differs_names_the_parameter(board, recording):
    """Where nothing is joined the reason is the stamps, not that no sample is stored."""
    board.start_over()
    late = replace(recording, time_s=recording.time_s - 1.0)
    for index in range(COUNT):
        board.others(recording, index)
        board.third(late, index)
    count = str(COUNT)
    board.bench.health("collector", lambda _, figures: figures.get("tam_3.received") == count, "readings have come")
    answer = board.ask("calibrate")
    assert not answer.success and answer.message.startswith("only 0 of ")
    assert re.search(
        r"found none of tam_3, whose newest stamp is (1|1\.01|0\.99) s behind that of tam_", answer.message
    )
    assert "delay_s in the array file" in answer.message


def test_without_collector_the_usage_is_not_known(bench, recording):
    """Samples of another origin are calibrated, and the answer says what it does not know."""
    from std_msgs.msg import Header

    from tam_calibration.messages.point_cloud import SampleLayout
    from tam_calibration.messages.samples import stamps_of
    from tam_calibration.nodes.topics import RELIABLE_STREAM, make_cloud

    bench.start_nodes(calibrator={})
    publisher = bench.node.create_publisher(sensor_msgs.PointCloud2, "samples", RELIABLE_STREAM)
    bench.health("calibrator", lambda _, figures: figures.get("publishers./samples") == "1", "it is connected")
    recording = recording.take(slice(0, COUNT))
    layout = SampleLayout.of(recording)
    for stamp_ns, row in zip(stamps_of(recording.time_s).tolist(), layout.rows(recording).tolist(), strict=True):
        cloud = make_cloud(Header(), layout.columns, row)
        cloud.header.stamp.sec, cloud.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        publisher.publish(cloud)
    bench.stored(COUNT)
    answer = bench.call("calibrator/calibrate")
    assert answer.success and answer.message.endswith("no collector says how many samples of sensor 1 were used")
