"""What a command asks of the nodes: the answer of a service, and what they publish."""

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.nodes.cloud import read_cloud
from tam_calibration.nodes.listening import RELIABLE_STREAM

_CALL_TURN_S = 1.0
"""Time for which the executor waits before Ctrl-C is looked at again."""


def call(service: str, find_s: float) -> str:
    """Call a service and return its message.

    Parameters
    ----------
    service : str
        Name, relative or absolute.
    find_s : float
        Longest time to find the service, seconds; its answer takes as long as its node lives.

    Raises
    ------
    Refused
        When no one offers the service, its node ends before it answers, or it answers no, with its reason.
    """
    node = Node("tam_call")
    try:
        client = node.create_client(Trigger, service)
        if not client.wait_for_service(timeout_sec=find_s):
            raise Refused(
                f"the service {service} is not offered: are the nodes running (tam nodes), in this namespace?"
            )
        future = client.call_async(Trigger.Request())
        while not future.done() and client.service_is_ready():
            rclpy.spin_until_future_complete(node, future, timeout_sec=_CALL_TURN_S)
        response = future.result() if future.done() else None
        if response is None:
            raise Refused(f"the node of {service} ended before it answered: its log says why")
        if not response.success:
            raise Refused(f"{service}: {response.message}")
        return str(response.message)
    finally:
        node.destroy_node()


def rows_of(node: Node, topic: str) -> list[FloatArray]:
    """Return the rows of the clouds of a topic: a list that grows while the node spins.

    Parameters
    ----------
    node : Node
        That hears them.
    topic : str
        Name, relative or absolute.
    """
    rows: list[FloatArray] = []
    node.create_subscription(PointCloud2, topic, lambda cloud: rows.extend(read_cloud(cloud)[1]), RELIABLE_STREAM)
    return rows
