"""The life of a process of nodes: signals end it well even while the executor takes on its nodes."""

import subprocess
import sys

_TOLD_WHILE_A_NODE_IS_TAKEN_ON = """
import os, signal, time
import rclpy
from rclpy.event_handler import EventHandler
from std_msgs.msg import String
from tam_calibration.model.signals import Ending
from tam_calibration.nodes.session import spin_nodes

take_on = EventHandler.add_to_wait_set

def take_on_and_tell(handler, wait_set):
    take_on(handler, wait_set)
    os.kill(os.getpid(), signal.SIGINT)
    limit = time.monotonic() + 0.3
    while rclpy.ok() and time.monotonic() < limit:
        pass

def listener():
    node = rclpy.create_node("listener")
    node.create_subscription(String, "topic", print, 1)
    return node

EventHandler.add_to_wait_set = take_on_and_tell
spin_nodes(Ending(), [listener])
"""


def test_signal_while_the_executor_takes_on_a_node_ends_well(ros_domain):
    """With rclpy's own handlers the context ended amid that, and the executor of events aborted the process."""
    ended = subprocess.run(
        [sys.executable, "-c", _TOLD_WHILE_A_NODE_IS_TAKEN_ON], capture_output=True, text=True, timeout=60
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
