"""Start nodes as processes of their own, watch them, and end them."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

from tam_calibration.problems import Refused

GRACE_S = 5.0
"""Time that a process has to end after SIGINT before it is killed."""

TAIL_LINES = 15


NODES = ("collector", "calibrator", "corrector")


def node_commands(
    array: Path | None = None,
    calibration: Path | None = None,
    method: str | None = None,
    params_file: Path | None = None,
) -> dict[str, list[str]]:
    """Return the command of each node, with the parameters that a user set."""
    everywhere = {"array_file": array}
    own = {"calibrator": {"calibration_file": calibration, "method": method}}
    shared = ["--params-file", str(params_file)] if params_file else []
    return {
        name: ["-m", f"tam_calibration.nodes.{name}", "--ros-args", *shared, *_settings(everywhere | own.get(name, {}))]
        for name in NODES
    }


def _settings(values: Mapping[str, Path | str | None]) -> list[str]:
    """Return parameters as ROS takes them: the value is YAML, so quoted."""
    given = {name: str(value) for name, value in values.items() if value is not None}
    return [part for name, value in given.items() for part in ("-p", f"{name}:={json.dumps(value)}")]


class Children:
    """Processes that are started together and end together.

    Parameters
    ----------
    commands : mapping of str to sequence of str
        Arguments of the Python interpreter for each process, by its name.
    log_directory : Path
        Where the output of each goes, to a file NAME.log.
    """

    def __init__(self, commands: Mapping[str, Sequence[str]], log_directory: Path) -> None:
        self._logs = {name: log_directory / f"{name}.log" for name in commands}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        log_directory.mkdir(parents=True, exist_ok=True)
        for name, arguments in commands.items():
            with self._logs[name].open("wb") as log:
                self._processes[name] = subprocess.Popen(
                    [sys.executable, *arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    env=dict(os.environ),
                    start_new_session=True,  # a Ctrl-C in the terminal reaches only the parent, who ends them in order
                )

    def __enter__(self) -> "Children":
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the processes; a failure of one is raised unless something else already was."""
        codes = self.end()
        if kind is None and any(codes.values()):
            self._refuse(next(name for name, code in codes.items() if code))

    @property
    def names(self) -> list[str]:
        """Names of the processes that are watched."""
        return list(self._processes)

    def check(self) -> None:
        """Check that all still run.

        Raises
        ------
        Refused
            When one has ended, with the end of its output.
        """
        for name, process in self._processes.items():
            if process.poll() is not None:
                self._refuse(name)

    def end(self, signal_number: signal.Signals = signal.SIGINT) -> dict[str, int]:
        """End the processes and return their exit codes; one that was still starting may die of the signal: 0."""
        for process in self._processes.values():
            if process.poll() is None:
                process.send_signal(signal_number)
        limit = time.monotonic() + GRACE_S
        codes = {name: _wait(process, limit) for name, process in self._processes.items()}
        return {name: 0 if code == -signal_number else code for name, code in codes.items()}

    def end_one(self, name: str, signal_number: signal.Signals = signal.SIGINT) -> int:
        """End one process and return its exit code; it is no longer watched."""
        process = self._processes.pop(name)
        process.send_signal(signal_number)
        return _wait(process, time.monotonic() + GRACE_S)

    def is_running(self, name: str) -> bool:
        """Return whether a process has not ended."""
        return self._processes[name].poll() is None

    def log(self, name: str) -> str:
        """Return the output of a process so far."""
        return self._logs[name].read_text(errors="replace")

    def _refuse(self, name: str) -> None:
        tail = "\n".join(self.log(name).splitlines()[-TAIL_LINES:])
        raise Refused(
            f"{name} ended with exit code {self._processes[name].returncode} (see {self._logs[name]}):\n{tail}"
        )


def _wait(process: subprocess.Popen[bytes], limit: float) -> int:
    try:
        return process.wait(max(0.0, limit - time.monotonic()))
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()
