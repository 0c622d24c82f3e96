"""From the start of ROS in a process to its end."""

from collections.abc import Callable, Sequence

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from tam_calibration.model import signals
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.signals import Ending

_TURN_S = 0.1
"""Longest time without a look for the word to end, seconds: an executor that waits in C++ hears no signal."""

_BAD_ARGUMENTS = (rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError)


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
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except _BAD_ARGUMENTS as problem:
        raise InputError(f"the arguments of ROS cannot be used: {str(problem).partition(', at /')[0]}") from problem
    try:
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
