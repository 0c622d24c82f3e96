"""ROS 2 in this process and in those that it starts, watches and ends. Light: rclpy is loaded where it is used."""

import json
import os
import resource
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from tam_calibration.files.text_files import configuration_folder
from tam_calibration.model import signals
from tam_calibration.model.exceptions import InputError, Refused, quoted
from tam_calibration.model.signals import Ending
from tam_calibration.nodes import bound

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rclpy.node import Node

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


def spin_nodes(ending: Ending, make_nodes: Sequence[Callable[[], "Node"]]) -> None:
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
    from rclpy.exceptions import ParameterException
    from rclpy.utilities import try_shutdown

    ending.loaded()
    try:
        initialise_ros(sys.argv)
        _spin(ending, make_nodes)
    except ParameterException as problem:
        raise InputError(str(problem)) from problem
    finally:
        signals.ignore()
        try_shutdown()


def _spin(ending: Ending, make_nodes: Sequence[Callable[[], "Node"]]) -> None:
    executor, nodes = _cheapest_executor(), list["Node"]()
    try:
        for make_node in make_nodes:
            nodes.append(make_node())
            executor.add_node(nodes[-1])
        ending.made()
        while ending.told is None:
            executor.spin_once(timeout_sec=0.1)  # in which an executor that waits in C++ hears no signal
    finally:
        signals.ignore()
        executor.shutdown()
        for node in nodes:
            node.destroy_node()


def _cheapest_executor() -> "Executor":
    """Return the executor that costs a stream least: that of events where rclpy has it, else the default one."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        from rclpy.executors import SingleThreadedExecutor

        return SingleThreadedExecutor()
    return EventsExecutor()


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


_CREDENTIALS = struct.Struct("3i")
"""Number, user and group of the process at the other end of a socket."""


def take_name(name: str, domain: int) -> None:
    """Take the name of a node for this process; on other systems than Linux every name is free.

    The kernel keeps it, as the address of a socket in no folder: nothing is left behind by a process that is killed.

    Parameters
    ----------
    name : str
        With its namespace.
    domain : int
        Number of the ROS domain in which nodes meet.

    Raises
    ------
    InputError
        When another process has it, with its number.
    """
    if sys.platform != "linux":
        return
    address = "\0" + sha256(f"tam_calibration {domain} {name}".encode()).hexdigest()
    own = socket.socket(socket.AF_UNIX)
    try:
        own.bind(address)
        own.listen()
    except OSError:
        own.close()
        raise InputError(
            f"{name} runs already in ROS domain {domain}, as process {_holder(address)}: end that one first, or start "
            "this one in another namespace (--ros-args -r __ns:=/NAME)"
        ) from None
    own.detach()  # open for as long as the process lives


def _holder(address: str) -> str:
    """Return the number of the process that has an address; unknown where it does not answer."""
    with socket.socket(socket.AF_UNIX) as asking:
        asking.setblocking(False)
        try:
            asking.connect(address)
        except OSError:
            return "unknown"
        credentials = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return str(_CREDENTIALS.unpack(credentials)[0])


def precede() -> str:
    """Have the threads of this process, and those that they start, run before all that are not real-time.

    Returns
    -------
    str
        How the process is scheduled, for /diagnostics: as before where its user has no right to more.
    """
    lowest = os.sched_get_priority_min(os.SCHED_RR)  # above all that is not real-time, below all else that is
    try:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_RR, os.sched_param(lowest))
    except PermissionError:
        return "normal: this user may not use real-time priorities"
    return f"real-time, priority {lowest}"


PERIOD_S = 0.1
"""Time between two pictures of what goes on: ten a second are more than eyes follow, and cost little at any rate."""

PATIENCE_S = 10.0
"""Time for which others are waited for: late joiners are discovered within 3 s, and robots start in any order."""

_GRACE_S = 5.0
"""Time that a process has to end after SIGINT before it is killed."""

_ENDED = (-signal.SIGINT, signals.CODE_OF_SHELLS + signal.SIGINT, -signal.SIGKILL)
"""Exit codes of a process that was told to end while it began, or ended already."""

NODES = ("collector", "calibrator", "corrector", "localizer")

START = ("-m", "tam_calibration.nodes.start")


def node_commands(
    array: Path | None = None,
    calibration: Path | None = None,
    method: str | None = None,
    params_file: Path | None = None,
    map_file: Path | None = None,
) -> dict[str, list[str]]:
    """Return the command of each process that the nodes run in, with the parameters that a user set.

    Parameters
    ----------
    array : Path, optional
        Array file, given to every node.
    calibration : Path, optional
        Calibration file, which every node loads where it exists, and the calibrator saves.
    method : str, optional
        Method of the calibrator's fit.
    params_file : Path, optional
        ROS parameter file, read by every node.
    map_file : Path, optional
        Map of the topics that the collector reads.

    Returns
    -------
    dict of str to list of str
        Arguments of the Python interpreter, by the name of the process.
    """
    there = calibration if calibration and calibration.is_file() else None  # else the calibrator will write it
    entry_points: dict[str, dict[str, Path | str | None]] = {
        "stream": {"corrector:calibration_file": there, "collector:map_file": map_file},
        "calibrator": {"calibration_file": calibration, "method": method},
        "localizer": {"calibration_file": there},
    }
    shared = ["--params-file", str(params_file)] if params_file else []
    return {
        name: [*START, name, "--ros-args", *shared, *_settings({"array_file": array} | own)]
        for name, own in entry_points.items()
    }


def _settings(values: Mapping[str, Path | str | None]) -> list[str]:
    """Return parameters as ROS takes them: the value is YAML, so quoted."""
    given = {name: str(value) for name, value in values.items() if value is not None}
    return [part for name, value in given.items() for part in ("-p", f"{name}:={json.dumps(value)}")]


class Children:
    """Processes that are started together and end together, at the latest when the thread ends that started them.

    Parameters
    ----------
    commands : mapping of str to sequence of str
        Arguments of the Python interpreter for each process, by its name.
    log_directory : Path
        Where the output of each goes, to a file NAME.log.
    """

    def __init__(self, commands: Mapping[str, Sequence[str]], log_directory: Path) -> None:
        self._commands = commands
        self._logs = {name: log_directory / f"{name}.log" for name in commands}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> "Children":
        """Start the processes."""
        try:
            for name in self._commands:
                self._start(name)
        except BaseException:  # told to end in between: none may be left behind
            self.end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the processes; a failure of one is raised unless something else already failed.

        Where the user ended the command, one that the signal ended or that had to be killed is no failure.
        """
        failed = {name: code for name, code in self.end().items() if code}
        if kind is SystemExit:
            failed = {name: code for name, code in failed.items() if code not in _ENDED}
        if kind in (None, SystemExit) and failed:
            self._refuse(*next(iter(failed.items())))

    @property
    def pids(self) -> dict[str, int]:
        """Numbers of the processes that are watched, by name."""
        return {name: process.pid for name, process in self._processes.items()}

    def check(self) -> None:
        """Check that all still run.

        Raises
        ------
        InputError
            When one has ended because of a parameter or file, with its sentence.
        Refused
            When one has ended otherwise, with the end of its output.
        """
        for name in self._processes:
            if (code := self._code(name)) is not None:
                self._refuse(name, code)

    def end(self) -> dict[str, int]:
        """End the processes one after another and return their exit codes.

        Not at once: Fast DDS 2.14 can deadlock when a participant is destroyed while it hears of another's end.
        A second Ctrl-C waits until then.
        """
        with signals.postponed():
            return {name: self.end_one(name) for name in [*reversed(self._processes)]}

    def end_one(self, name: str, signal_number: signal.Signals = signal.SIGINT) -> int:
        """End one process and return its exit code; it is no longer watched.

        Parameters
        ----------
        name : str
            Name of a process that is watched.
        signal_number : Signals
            What asks it to end; it is killed when it has not ended five seconds later.
        """
        process = self._processes.pop(name)
        process.send_signal(signal_number)
        try:
            return process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait()

    def is_running(self, name: str) -> bool:
        """Return whether a process has not ended."""
        return self._code(name) is None

    def log(self, name: str) -> str:
        """Return the output of a process so far."""
        return self._logs[name].read_text(errors="replace")

    def _code(self, name: str) -> int | None:
        """Return the exit code of a process, None while it runs."""
        with signals.postponed():  # an exception while `poll` has its lock would leave it locked: no wait would end
            return self._processes[name].poll()

    def _start(self, name: str) -> None:
        self._logs[name].parent.mkdir(parents=True, exist_ok=True)
        with self._logs[name].open("wb") as log, signals.held_back():
            self._processes[name] = subprocess.Popen(
                [sys.executable, "-I", "-S", bound.__file__, str(os.getpid()), *self._commands[name]],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=dict(os.environ),
                start_new_session=True,  # a Ctrl-C in the terminal reaches only the parent, who ends them in order
            )

    def _refuse(self, name: str, code: int) -> None:
        lines = self.log(name).splitlines()
        if code == 2:  # the last line says what in its input is not usable
            raise InputError(lines[-1].removeprefix("tam: "))
        tail = "\n".join(lines[-15:])
        raise Refused(f"{name} ended with exit code {code} (see {self._logs[name]}):\n{tail}")
