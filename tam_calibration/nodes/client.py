"""A client of the nodes: watches them, calls their services, and keeps what they publish."""

import time
from collections.abc import Callable

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.nodes.children import NODES, Children
from tam_calibration.nodes.cloud import read_cloud
from tam_calibration.nodes.listening import RELIABLE_STREAM
from tam_calibration.nodes.monitor import TURN_S, Monitor

_CALL_TURN_S = 1.0


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
            rclpy.spin_until_future_complete(node, future, timeout_sec=_CALL_TURN_S)
        response = future.result() if future.done() else None
        if response is None:
            raise Refused(f"the node of {service} ended before it answered: its log says why")
        if not response.success:
            raise Refused(f"{service}: {response.message}")
        return str(response.message)
    finally:
        node.destroy_node()


class Client(Monitor):
    """Waits on the nodes, and fails at once when one of them ends.

    Parameters
    ----------
    children : Children
        Their processes.
    on_turn : callable
        Called with the client some times a second while it waits.
    """

    def __init__(self, children: Children, on_turn: Callable[[Monitor], None]) -> None:
        super().__init__(NODES)
        self._children, self._on_turn = children, on_turn
        self._corrected: list[FloatArray] = []
        self.create_subscription(PointCloud2, "field_gradient", self._take_corrected, RELIABLE_STREAM)

    @property
    def corrected(self) -> FloatArray:
        """(N, 18) rows of ``field_gradient`` so far."""
        return np.array(self._corrected)

    def wait_until(self, condition: Callable[[], object], what: str, timeout_s: float) -> None:
        """Wait until a condition holds.

        Parameters
        ----------
        condition : callable
            Called without arguments; what it returns is taken as true or false.
        what : str
            Name of what is waited for, for the message of `Refused`.
        timeout_s : float
            Longest time to wait, seconds.

        Raises
        ------
        Refused
            When it does not hold in time, or a node ends.
        """
        limit, shown = time.monotonic() + timeout_s, 0.0
        while not condition():
            self._children.check()
            if time.monotonic() > limit:
                raise Refused(f"{what} did not happen within {timeout_s:g} s; the nodes say: {' | '.join(self.news())}")
            self.turn()
            if time.monotonic() > shown + TURN_S:
                shown = time.monotonic()
                self._on_turn(self)

    def call(self, service: str, timeout_s: float) -> str:
        """Call a service and return its message.

        Parameters
        ----------
        service : str
            Name, relative or absolute, of a ``Trigger`` service.
        timeout_s : float
            Longest time to wait for the service, and again for its answer, seconds.

        Raises
        ------
        Refused
            When it does not answer in time, or answers no, with its reason.
        """
        client = self.create_client(Trigger, service)
        self.wait_until(client.service_is_ready, f"the start of {service}", timeout_s)
        future = client.call_async(Trigger.Request())
        self.wait_until(future.done, f"the answer of {service}", timeout_s)
        response = future.result()
        if not response.success:
            raise Refused(f"{service}: {response.message}")
        return str(response.message)

    def _take_corrected(self, cloud: PointCloud2) -> None:
        self._corrected.extend(read_cloud(cloud)[1])
