"""Reading topics: nothing is lost while a process waits for its turn, and what waits comes in the order of arrival."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from test.nodes.test_streaming import rows_of

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")


def test_a_collector_that_waits_for_its_turn_loses_nothing(bench, recording):
    """What five topics bring in half a second at 1000 Hz waits for a collector that the machine gives no time."""
    children = bench.start_nodes(collector={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 1})
    fast = replace(recording, time_s=1.7e9 + np.arange(recording.sample_count) / 1000)
    os.kill(children.pids["collector"], signal.SIGSTOP)
    for index in range(500):
        publish(fast, index)
    os.kill(children.pids["collector"], signal.SIGCONT)
    bench.spin_until(lambda: len(samples) == 500, "every sample")
    assert_array_equal(rows_of(samples)[:, 1:13], recording.readings_T[:500].reshape(500, 12))
    _, figures = bench.health("collector", lambda _, figures: figures.get("samples") == "500", "they are counted")
    assert figures["lost"] == "0"


def test_messages_that_wait_come_in_the_order_of_their_arrival(ros_domain):
    """Whichever topic wakes the node: messages of two topics come as they were published."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import Float64

    from tam_calibration.messages.cdr import read_float64
    from tam_calibration.nodes.listening import RELIABLE_STREAM, ListeningNode

    context = rclpy.Context()
    rclpy.init(context=context)
    node, came = ListeningNode("ears", context=context), []
    topics, arrived = ["first", "second"], []

    def take(message, arrived_ns):
        came.append(read_float64(message))
        arrived.append(arrived_ns)

    for topic in topics:
        node.listen_in_order(Float64, topic, take, RELIABLE_STREAM)
    publishers = [node.create_publisher(Float64, topic, RELIABLE_STREAM) for topic in topics]
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    while not all(each.get_subscription_count() for each in publishers):
        executor.spin_once(timeout_sec=0.01)
    for number in range(200):
        publishers[number // 3 % 2].publish(Float64(data=float(number)))
    while len(came) < 200:
        executor.spin_once(timeout_sec=1.0)
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()
    assert came == list(range(200)) and sorted(arrived) == arrived and 0 <= arrived[-1] - arrived[0] < 60e9
