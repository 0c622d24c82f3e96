"""ROS 2 in a process: whether it can begin there, and how it ends. Light: rclpy is loaded where it is used."""

import os
import resource
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec

from tam_calibration.files.text_files import configuration_folder
from tam_calibration.model import signals
from tam_calibration.model.exceptions import InputError, Refused, quoted
from tam_calibration.model.signals import Ending

_LAST_DOMAIN = 232
"""Domain beyond which the ports of DDS, 250 for each from 7400 on, exceed 65535: Fast DDS ends the process there."""

_FEWEST_FILES = 64
"""Files that a process with our nodes may have open, at least: it has 25, and its libraries do not end well without."""


def configure_fast_dds() -> None:
    """Have this process and those that it starts use our profile of Fast DDS by default.

    A profile of the user's, or a choice of transports, stays in force.
    """
    if "FASTDDS_BUILTIN_TRANSPORTS" not in os.environ:
        os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(configuration_folder() / "fastdds.xml"))


@contextmanager
def ros_session(exit_code: int | None = None) -> Iterator[None]:
    """Use ROS 2 in this process until the block ends; Ctrl-C and SIGTERM end it in order.

    Parameters
    ----------
    exit_code : int, optional
        Of the process when it is ended so: 0 where it would not end otherwise; by default that of shells, 130 or 143.

    Raises
    ------
    InputError
        When rclpy is not installed, cannot begin, or fails.
    """
    if find_spec("rclpy") is None:
        raise InputError(
            "this needs ROS 2: source a Jazzy installation, "
            "or run pip install 'tam_calibration[ros]' in a virtual environment"
        )
    configure_fast_dds()

    from rclpy.utilities import try_shutdown

    ending = Ending(exit_code)
    ending.loaded()
    try:
        initialise_ros([])
        yield
    except SystemExit:
        signals.ignore()  # no other signal changes that, nor the exit code
        raise
    except Refused:
        raise
    except RuntimeError as problem:
        if ending.told is None:
            raise InputError(f"ROS cannot go on: {_reason(problem)}") from problem
        signals.ignore()
        raise SystemExit(ending.told) from problem  # rclpy took the signal for a failure of its own
    finally:
        try_shutdown()
        ending.release()


def initialise_ros(arguments: Sequence[str]) -> None:
    """Begin to use ROS 2 in this process, which handles signals itself.

    Parameters
    ----------
    arguments : sequence of str
        Those of the command line, of which ROS takes what follows ``--ros-args``.

    Raises
    ------
    InputError
        When an argument, a parameter file, a variable of the environment or a limit of the process keeps it from that.
    """
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from rclpy.utilities import get_default_context

    _require_surroundings()
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
        domain = get_default_context().get_domain_id()
        if domain > _LAST_DOMAIN:
            raise InputError(f"ROS_DOMAIN_ID is {domain}: DDS has ports for 0 to {_LAST_DOMAIN} only")
    except UnicodeEncodeError as problem:
        raise InputError(f"ROS takes words in UTF-8 only, which {quoted(problem.object)} is not") from problem
    except RuntimeError as problem:  # as all errors of rclpy are
        raise InputError(
            f"ROS cannot begin: {_reason(problem)}; look at its arguments and its variables (ROS_…)"
        ) from problem


def _require_surroundings() -> None:
    """Check what Fast DDS would complain of in its own words, or not end well without."""
    try:
        os.getcwd()
    except FileNotFoundError:
        raise InputError("the folder in which this was called is gone: go to another one") from None
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if files < _FEWEST_FILES:
        raise InputError(f"ROS needs {_FEWEST_FILES} open files at once, and this process may have {files}: ulimit -n")


def _reason(problem: RuntimeError) -> str:
    """Return what rclpy says, without its place in the source."""
    return " ".join(str(problem).partition(", at /")[0].split())
