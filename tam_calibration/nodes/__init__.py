"""The ROS 2 nodes: the only room that imports rclpy and message packages."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from tam_calibration.files.configuration import configuration_folder
from tam_calibration.model import signals
from tam_calibration.model.exceptions import InputError


def configure_fast_dds() -> None:
    """Have this process and those that it starts use our profile of Fast DDS, unless told otherwise.

    A profile of the user's, or a choice of transports, stays in force.
    """
    if "FASTDDS_BUILTIN_TRANSPORTS" not in os.environ:
        os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(configuration_folder() / "fastdds.xml"))


@contextmanager
def ros_session(exit_code: int = 0) -> Iterator[None]:
    """Use ROS 2 in this process until the block ends; Ctrl-C and SIGTERM end it in order, with an exit code.

    Raises
    ------
    InputError
        When rclpy is not installed.
    """
    if find_spec("rclpy") is None:
        raise InputError(
            "this needs ROS 2: source a Jazzy installation, "
            "or run pip install 'tam_calibration[ros]' in a virtual environment"
        )
    configure_fast_dds()

    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from rclpy.utilities import try_shutdown

    before = {number: signal.getsignal(number) for number in signals.ENDING}
    signals.raise_exit(exit_code)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield
    except SystemExit:  # no other signal changes that, nor the exit code
        signals.ignore()
        before.clear()
        raise
    finally:
        try_shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)
