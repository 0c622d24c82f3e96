"""A bare rclpy node with the default executor that publishes what it receives: what `streaming.py` compares with.

Run ``python streaming_relay.py TYPE:TOPIC …``: each message of a topic goes out on the topic with ``_relayed`` behind.
"""

import sys

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import MagneticField, PointCloud2

from tam_calibration.nodes.session import ros_session

TYPES = {"MagneticField": MagneticField, "PointCloud2": PointCloud2}
QUALITY = QoSProfile(depth=1000)


def main() -> None:
    """Relay until told to end."""
    node = Node("relay")
    for argument in sys.argv[1:]:
        name, topic = argument.split(":")
        publisher = node.create_publisher(TYPES[name], f"{topic}_relayed", QUALITY)
        node.create_subscription(TYPES[name], topic, publisher.publish, QUALITY)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while True:
        executor.spin_once(timeout_sec=1.0)


if __name__ == "__main__":
    with ros_session(exit_code=0):
        main()
