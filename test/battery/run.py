"""One command in a process of its own: forked from this one, which has everything imported, or a fresh interpreter."""

import atexit
import ctypes
import os
import resource
import select
import signal
import sys
import threading
import time
import traceback
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from battery.surroundings import NOBODY, PLAIN, Ended, Surroundings

LIMIT_S = 60.0
"""After which a command hangs: the good ones take a twentieth of it."""
MEMORY_BYTES = 3 << 29
"""1.5 GiB, more than which no command may take for inputs of some hundred kilobytes."""
_ADDRESSES_BYTES = 4 << 30
"""Of address space, so that what asks for all of the memory takes no other process with it."""
_GRACE_S = 5.0
"""For processes that a command started to end after it."""
_LOOK_S = 0.02
"""From one look for them to the next: a wait for all children at once has no time limit."""
_BEGIN_S = 0.02
"""From the word of a command that it begins to the end of its first line: what Python does before is not ours."""
_FRESH = "import os, sys; from tam_calibration.__main__ import run; os.write(int(sys.argv.pop(1)), b'.'); run()"
"""What the installed command does, which gives its word as a fork does."""
_TOLD_BYTES = 1 << 20
_PR_SET_CHILD_SUBREAPER = 36
_MODULES = (
    *(
        "recordings.bag_source",
        "recordings.ulog_source",
        "recordings.dataflash_source",
        "recordings.bag_mcap",
        "recordings.bag_sqlite3",
        "results.bag_corrected",
        "gap.calibration_with_effects",
    ),
    *("simulation.observe", "report.calibration_report", "report.gap_report", "report.survey_report"),
)


def warm() -> None:
    """Import what the commands load, so that a fork has it; nothing of ROS, whose threads no fork survives."""
    for command in iter_modules(import_module("tam_calibration.cli").__path__):
        import_module(f"tam_calibration.cli.{command.name}")
    for name in _MODULES:
        import_module(f"tam_calibration.{name}")
    # A command that runs as another user cannot read the standard library of an interpreter in root's folder.
    for name in ("tam_validation.blind_command", "tam_validation.reproduce_command"):
        import_module(name)
    for name in ("scipy.optimize", "scipy.spatial.transform", "scipy.special", "zstandard", "jinja2"):
        import_module(name)
    nodes = import_module("tam_calibration.cli.nodes")
    nodes.PATIENCE_S = 0.2  # nobody will come
    adopt_orphans()
    if threading.active_count() > 1:
        raise RuntimeError(f"a fork would lose {threading.enumerate()}")


def adopt_orphans() -> None:
    """Have what a command leaves running become a child of this process."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)


def run(line: list[str], folder: Path, around: Surroundings = PLAIN, limit_s: float = LIMIT_S) -> Ended:
    """Run ``tam`` with a line and return how it ended.

    Parameters
    ----------
    line : list of str
        The words after ``tam``.
    folder : Path
        In which it runs.
    around : Surroundings
        What else is about it; ``moment`` counts in seconds here.
    limit_s : float
        After which it is killed.
    """
    listener = _Listener(around)
    started, starter = os.pipe()
    began = time.monotonic()
    process = os.fork()
    if not process:
        os.close(started)
        _become(line, folder, listener.writers, around, starter)
    os.close(starter)
    os.read(started, 1)
    os.close(started)
    is_hung = not _wait(process, around, limit_s, listener)
    _, status, used = os.wait4(process, 0)
    code = os.waitstatus_to_exitcode(status)
    seconds = time.monotonic() - began
    left = _end_others()
    said = listener.close()
    return Ended(128 - code if code < 0 else code, code < 0, *said, seconds, used.ru_maxrss * 1024, is_hung, left)


class _Listener:
    """The pipes to which a command speaks, which no limit on files concerns.

    Attributes
    ----------
    writers : list of int
        Ends for the command: stdout and stderr.
    readers : dict of int to bytearray
        Ends of ours, with what was said.
    """

    def __init__(self, around: Surroundings) -> None:
        pipes = [os.pipe(), os.pipe()]
        self.writers = [writer for _, writer in pipes]
        self.readers = {reader: bytearray() for reader, _ in pipes}
        self._stdout = pipes[0][0]
        self._left = around.read_bytes if around.stdout == "broken" else _TOLD_BYTES
        self._open = set(self.readers)

    def begin(self) -> list[int]:
        """Leave the ends of the command to it, and return those to listen to."""
        for writer in self.writers:
            os.close(writer)
        if not self._left:
            self._close(self._stdout)
        return sorted(self._open)

    def take(self, reader: int) -> bool:
        """Take what waits at an end; return whether more may come."""
        if reader not in self._open:
            return False
        data = os.read(reader, 1 << 16)
        self.readers[reader] += data[: _TOLD_BYTES - len(self.readers[reader])]
        if not data or (reader == self._stdout and len(self.readers[reader]) >= self._left):
            self._close(reader)
        return reader in self._open

    def _close(self, reader: int) -> None:
        os.close(reader)
        self._open.discard(reader)

    def close(self) -> list[str]:
        """Take the rest, and return what was said."""
        for reader in sorted(self._open):
            os.set_blocking(reader, False)
            with suppress(BlockingIOError):
                while self.take(reader):
                    pass
        for reader in sorted(self._open):
            self._close(reader)
        return [bytes(said).decode(errors="backslashreplace") for said in self.readers.values()]


def _wait(process: int, around: Surroundings, limit_s: float, listener: _Listener) -> bool:
    """Listen until a process has ended, and return whether it did so by itself, or by the signal at its moment."""
    descriptor = os.pidfd_open(process)
    poll = select.poll()
    for each in (descriptor, *listener.begin()):
        poll.register(each, select.POLLIN)
    begin = time.monotonic()
    moments = [(limit_s, signal.SIGKILL)]
    if around.ended_by is not None:
        moments.insert(0, (_BEGIN_S + around.moment, around.ended_by))
    try:
        while moments:
            left_s = begin + moments[0][0] - time.monotonic()
            ready = [each for each, _ in poll.poll(1000 * left_s)] if left_s > 0 else []
            if descriptor in ready:
                return True
            for each in ready:
                if not listener.take(each):
                    poll.unregister(each)
            if left_s <= 0:
                signal.pidfd_send_signal(descriptor, moments.pop(0)[1])
        return False
    finally:
        os.close(descriptor)


def _children() -> dict[int, str]:
    """Return the processes whose parent this one is, those that lost theirs among them, with their names."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            name, _, rest = (folder / "stat").read_text().rpartition(") ")
        except OSError:  # it has ended
            continue
        if int(rest.split()[1]) == os.getpid():
            found[int(folder.name)] = name.partition("(")[2]
    return found


def _end_others() -> tuple[str, ...]:
    """Wait for the processes that a command left, kill those that go on, and return their names."""
    limit = time.monotonic() + _GRACE_S
    while _reap() and time.monotonic() < limit:
        time.sleep(_LOOK_S)
    left = _children()
    for process in left:
        os.kill(process, signal.SIGKILL)
    while _reap():
        time.sleep(_LOOK_S)
    return tuple(left.values())


def _reap() -> bool:
    """Take leave of children that have ended, and return whether there are others."""
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return False
    return True


def _become(line: list[str], folder: Path, writers: list[int], around: Surroundings, starter: int) -> None:
    """Be the command, in a fork; never returns."""
    code = 70
    try:
        os.setsid()
        _arrange(folder, writers, around)
        if around.fresh:
            os.set_inheritable(starter, True)
            os.execv(sys.executable, [sys.executable, "-c", _FRESH, str(starter), *line])
        code = _run_here(line, starter)
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def _arrange(folder: Path, writers: list[int], around: Surroundings) -> None:
    os.chdir(folder / around.within)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _redirect(0, around.stdin or "/dev/null", os.O_RDONLY)
    for number, target in ((1, around.stdout), (2, around.stderr)):
        if target in ("", "broken"):
            os.dup2(writers[number - 1], number)
        else:
            _redirect(number, target, os.O_WRONLY)
    for writer in writers:
        os.close(writer)
    for name, value in around.variables.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES_BYTES, _ADDRESSES_BYTES))
    for limited, value in around.limits.items():
        resource.setrlimit(limited, (value, value))
    if around.is_nobody and os.geteuid() == 0:
        os.setgroups([])
        os.setresgid(NOBODY, NOBODY, NOBODY)
        os.setresuid(NOBODY, NOBODY, NOBODY)
    if around.loses_folder:
        os.rmdir(os.getcwd())


def _redirect(number: int, target: str, flags: int) -> None:
    if target == "closed":
        os.close(number)
        return
    opened = os.open(target, flags)
    os.dup2(opened, number)
    if opened != number:
        os.close(opened)


def _run_here(line: list[str], starter: int) -> int:
    """Do what the installed command does, to the end of the interpreter, and return its exit code."""
    sys.argv = ["tam", *line]
    sys.stdin, sys.stdout = os.fdopen(0, closefd=False), os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="backslashreplace", closefd=False)
    code: object = 0
    entry = import_module("tam_calibration.__main__")
    try:
        os.write(starter, b".")
        entry.run()
    except SystemExit as end:
        code = end.code
    except KeyboardInterrupt:
        traceback.print_exc()
        code = 130
    except BaseException:
        traceback.print_exc()
        code = 1
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the command has ended
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    return code if isinstance(code, int) else int(code is not None)
