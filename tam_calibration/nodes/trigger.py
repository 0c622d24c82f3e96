"""One call of a std_srvs/Trigger service."""

import rclpy
from rclpy.node import Node
from std_srvs.srv import Trigger

from tam_calibration.exceptions import Refused

TURN_S = 1.0


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
        When nobody offers the service, its node ends before it answers, or it answers no, with its reason.
    """
    node = Node("tam_call")
    try:
        client = node.create_client(Trigger, service)
        if not client.wait_for_service(timeout_sec=find_s):
            raise Refused(f"nobody offers the service {service}: are the nodes running (tam nodes), in this namespace?")
        future = client.call_async(Trigger.Request())
        while not future.done() and client.service_is_ready():
            rclpy.spin_until_future_complete(node, future, timeout_sec=TURN_S)
        response = future.result() if future.done() else None
        if response is None:
            raise Refused(f"the node of {service} ended before it answered: its log says why")
        if not response.success:
            raise Refused(f"{service}: {response.message}")
        return str(response.message)
    finally:
        node.destroy_node()
