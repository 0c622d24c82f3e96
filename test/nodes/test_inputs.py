"""Inputs that carry something else than they should are named: other types of messages, and stamps that are none."""

import pytest

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")

INPUTS = {
    "collector": ("tam_2/magnetic_field", "sensor_msgs/msg/MagneticField"),
    "corrector": ("calibration", "std_msgs/msg/String"),
    "calibrator": ("samples", "sensor_msgs/msg/PointCloud2"),
    "localizer": ("field_gradient", "sensor_msgs/msg/PointCloud2"),
}
"""An input of each node, and its type."""


def test_what_cannot_be_read_is_named(bench, recording):
    """Another type, by every node, with both types and until the publisher goes; a driver whose stamps are all 0."""
    bench.start_nodes(collector={"silence_s": 0.3}, corrector={}, calibrator={}, localizer={})
    publishers = [bench.node.create_publisher(sensor_msgs.Imu, topic, 10) for topic, _ in INPUTS.values()]
    told = {
        name: f"{topic} is published as sensor_msgs/msg/Imu, not {kind}: look for the node that publishes it"
        for name, (topic, kind) in INPUTS.items()
    }
    wait_for_all(bench, lambda status: told[status.name] in status.message and status.level == b"\x02")
    for publisher in publishers:
        bench.node.destroy_publisher(publisher)
    wait_for_all(bench, lambda status: "is published as" not in status.message)

    others = bench.publish_sensors((2, 3, 4))
    unstamped = bench.node.create_publisher(sensor_msgs.MagneticField, "tam_1/magnetic_field", 100)
    bench.stream(recording, [others, lambda *_: unstamped.publish(sensor_msgs.MagneticField())])
    named = "the driver of tam_1 does not stamp its messages: all stamps are 0; samples go on without tam_1"
    status, figures = bench.health("collector", lambda status, _: named in status.message, "the driver is named")
    assert status.level == b"\x02" and int(figures["partial"]) > 0


@pytest.mark.parametrize("frames", ["abba", "aaaa", ["", "", "a", ""], ["é" * 300, "b", "c", "b"]])
def test_a_frame_that_changes_is_warned_of_once(frames):
    """Also where the array file states none."""
    from rclpy.serialization import serialize_message

    from tam_calibration.model.mounting import Mounting
    from tam_calibration.nodes.inputs import FrameCheck

    told = []
    check = FrameCheck(Mounting(), told.append)
    for frame in frames:
        message = sensor_msgs.MagneticField()
        message.header.frame_id = frame
        check.check("tam_2", serialize_message(message))
    before, after = frames[0], next((frame for frame in frames if frame != frames[0]), None)
    expected = f"the frame of tam_2 is {after} now, and was {before or 'without name'}: has its driver changed?"
    assert told == [expected] * (after is not None) and check.problems == {}


def wait_for_all(bench, condition):
    """Wait until the status of every node has fulfilled a condition."""
    waiting = set(INPUTS)

    def is_met(status, _):
        if status.name in waiting and condition(status):
            waiting.discard(status.name)
        return not waiting

    bench.health("", is_met, "all nodes say so")
