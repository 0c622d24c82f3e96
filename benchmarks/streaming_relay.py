"""A bare rclpy node with the default executor that publishes what it receives: what `streaming.py` compares with.

Run ``python streaming_relay.py TYPE:TOPIC …``: each message of a topic goes out on the topic with ``_relayed`` behind.
"""

import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import MagneticField, PointCloud2

from tam_calibration.nodes.signals import Startup

TYPES = {"MagneticField": MagneticField, "PointCloud2": PointCloud2}
QUALITY = QoSProfile(depth=1000)


def main() -> None:
    """Relay until told to end."""
    startup = Startup()
    rclpy.init()
    startup.over()
    node = Node("relay")
    for argument in sys.argv[1:]:
        name, topic = argument.split(":")
        publisher = node.create_publisher(TYPES[name], f"{topic}_relayed", QUALITY)
        node.create_subscription(TYPES[name], topic, publisher.publish, QUALITY)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
