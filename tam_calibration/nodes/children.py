"""Start nodes as processes of their own, watch them, and end them."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

from tam_calibration.model import signals
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.nodes import bound

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
