"""From the start of ROS in a process to its end."""

from collections.abc import Callable

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.utilities import ok, try_shutdown

from tam_calibration.nodes import signals
from tam_calibration.nodes.signals import Startup
from tam_calibration.problems import InputError

BAD_ARGUMENTS = (rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError)


def spin_node(startup: Startup, make_node: Callable[[], Node], make_executor: Callable[[], Executor]) -> None:
    """Spin a node until SIGINT, SIGTERM or the end of its context.

    Parameters
    ----------
    startup : Startup
        Of the process; over once ROS is initialised.
    make_node, make_executor : callable
        Called once ROS is initialised.

    Raises
    ------
    InputError
        When an argument or parameter is not usable.
    """
    try:
        rclpy.init()
        startup.over()
    except BAD_ARGUMENTS as problem:
        raise InputError(f"the arguments of ROS cannot be used: {str(problem).partition(', at /')[0]}") from problem
    try:
        _spin(make_node(), make_executor())
    except ParameterException as problem:
        raise InputError(str(problem)) from problem
    except Exception:  # after the end of the context anything fails, in many ways, because of that
        if ok():
            raise
    finally:
        signals.ignore()
        try_shutdown()


def _spin(node: Node, executor: Executor) -> None:
    try:
        executor.add_node(node)
        # The events executor's own spin() does not return on signals.
        while ok():
            executor.spin_once(timeout_sec=1.0)
    finally:
        signals.ignore()
        node.destroy_node()
