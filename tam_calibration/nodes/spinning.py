"""From the start of ROS in a process to its end."""

from collections.abc import Callable, Sequence

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.utilities import ok, try_shutdown

from tam_calibration.model.exceptions import InputError
from tam_calibration.nodes import signals
from tam_calibration.nodes.signals import Startup

_BAD_ARGUMENTS = (rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError)


def spin_nodes(startup: Startup, make_nodes: Sequence[Callable[[], Node]]) -> None:
    """Spin nodes in one executor until SIGINT, SIGTERM or the end of their context.

    Parameters
    ----------
    startup : Startup
        Of the process; over once ROS is initialised.
    make_nodes : sequence of callable
        Each makes a node; called once ROS is initialised.

    Raises
    ------
    InputError
        When an argument or parameter is not usable.
    """
    try:
        rclpy.init()
        startup.over()
    except _BAD_ARGUMENTS as problem:
        raise InputError(f"the arguments of ROS cannot be used: {str(problem).partition(', at /')[0]}") from problem
    try:
        _spin(make_nodes, _cheapest_executor())
    except ParameterException as problem:
        raise InputError(str(problem)) from problem
    except Exception:  # after the end of the context anything fails, in many ways, because of that
        if ok():
            raise
    finally:
        signals.ignore()
        try_shutdown()


def _spin(make_nodes: Sequence[Callable[[], Node]], executor: Executor) -> None:
    nodes: list[Node] = []
    try:
        for make_node in make_nodes:
            nodes.append(make_node())
            executor.add_node(nodes[-1])
        # The events executor's own spin() does not return on signals.
        while ok():
            executor.spin_once(timeout_sec=1.0)
    finally:
        signals.ignore()
        for node in nodes:
            node.destroy_node()


def _cheapest_executor() -> Executor:
    """Return the executor that costs a stream least: that of events where rclpy has it, else the default one."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()
