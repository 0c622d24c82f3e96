"""The main function of a node's process: it ends with exit code 0 whenever it is told to."""

import signal
import sys
from collections.abc import Callable

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.utilities import ok, try_shutdown

from tam_calibration.problems import InputError

RCLError = rclpy_implementation.RCLError
BAD_ARGUMENTS = (RCLError, rclpy_implementation.RCLInvalidROSArgsError, rclpy_implementation.UnknownROSArgsError)


def run(make_node: Callable[[], Node], make_executor: Callable[[], Executor]) -> int:
    """Spin a node until SIGINT, SIGTERM or the end of its context.

    Parameters
    ----------
    make_node, make_executor : callable
        Called once ROS is initialised.

    Returns
    -------
    int
        The exit code: 0 when it was told to end, 2 when a parameter or file is not usable (said on stderr).
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        _initialise()
        _spin(make_node(), make_executor())
    except (InputError, ParameterException, OSError) as problem:
        print(f"tam: {problem}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        try_shutdown()
    return 0


def _initialise() -> None:
    try:
        rclpy.init()
    except BAD_ARGUMENTS as problem:
        raise InputError(f"the arguments of ROS cannot be used: {str(problem).partition(', at /')[0]}") from problem


def _spin(node: Node, executor: Executor) -> None:
    try:
        executor.add_node(node)
        # The events executor's own spin() does not return on signals.
        while ok():
            executor.spin_once(timeout_sec=1.0)
    except RCLError:
        if ok():
            raise
    finally:
        node.destroy_node()
