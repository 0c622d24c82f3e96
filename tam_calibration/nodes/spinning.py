"""From the start of ROS in a process to its end."""

import sys
from collections.abc import Callable, Sequence

from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import try_shutdown

from tam_calibration.model import signals
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.signals import Ending
from tam_calibration.nodes.session import initialise_ros

_TURN_S = 0.1
"""Longest time without a look for the word to end, seconds: an executor that waits in C++ hears no signal."""


def spin_nodes(ending: Ending, make_nodes: Sequence[Callable[[], Node]]) -> None:
    """Spin nodes in one executor until SIGINT, SIGTERM or SIGHUP.

    Parameters
    ----------
    ending : Ending
        Of the process.
    make_nodes : sequence of callable
        Each makes a node; called once ROS is initialised.

    Raises
    ------
    InputError
        When an argument or parameter is not usable.
    """
    ending.loaded()
    try:
        initialise_ros(sys.argv)
        _spin(ending, make_nodes)
    except ParameterException as problem:
        raise InputError(str(problem)) from problem
    finally:
        signals.ignore()
        try_shutdown()


def _spin(ending: Ending, make_nodes: Sequence[Callable[[], Node]]) -> None:
    executor, nodes = _cheapest_executor(), list[Node]()
    try:
        for make_node in make_nodes:
            nodes.append(make_node())
            executor.add_node(nodes[-1])
        ending.made()
        while ending.told is None:
            executor.spin_once(timeout_sec=_TURN_S)
    finally:
        signals.ignore()
        executor.shutdown()
        for node in nodes:
            node.destroy_node()


def _cheapest_executor() -> Executor:
    """Return the executor that costs a stream least: that of events where rclpy has it, else the default one."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()
