"""A driver of one sensor in a process of its own: each reading is published when its time has come, with its stamp.

``python sensor_driver.py TOPIC FILE``: FILE holds ``stamps_s`` and ``readings_T`` (N, 3), and by what ``speed`` it
publishes faster than the stamps. It begins at the time of day that arrives on the topic ``begin``, NaN being none, once
somebody listens, leaves out what was to come before it was started, and ends with SIGINT.
"""

import signal
import sys
import time

import numpy as np
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from sensor_msgs.msg import MagneticField
from std_msgs.msg import Float64

from tam_calibration.nodes.session import ros_session


def main():
    """Publish the readings."""
    topic, path = sys.argv[1:]
    with np.load(path) as file:
        stamps_s, readings, speed = file["stamps_s"].tolist(), file["readings_T"].tolist(), float(file["speed"])
    node = rclpy.create_node(f"driver_{topic.replace('/', '_')}")
    publisher = node.create_publisher(MagneticField, topic, 10_000)
    begin = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(Float64, "begin", lambda message: begin.append(message.data), latched)
    while not (begin and np.isfinite(begin[-1]) and publisher.get_subscription_count()):
        rclpy.spin_once(node, timeout_sec=0.1)
    message = MagneticField()
    present_s = time.time() - begin[-1]
    for stamp_s, (x, y, z) in zip(stamps_s, readings, strict=True):
        if stamp_s / speed < present_s:
            continue
        # A sensor has no condition to wait for but its own clock.
        time.sleep(max(0.0, begin[-1] + stamp_s / speed - time.time()))
        message.header.stamp = Time(nanoseconds=round((begin[-1] + stamp_s) * 1e9)).to_msg()
        message.magnetic_field.x, message.magnetic_field.y, message.magnetic_field.z = x, y, z
        publisher.publish(message)
    signal.pause()


with ros_session(exit_code=0):
    main()
