"""One command in a process of its own: forked from this one, which has everything imported, or a fresh interpreter."""

import atexit
import ctypes
import os
import resource
import runpy
import select
import signal
import sys
import threading
import time
import traceback
from importlib import import_module
from pathlib import Path

from battery.surroundings import NOBODY, PLAIN, Ended, Surroundings

LIMIT_S = 60.0
"""After which a command hangs: the good ones take a twentieth of it."""
MEMORY_BYTES = 3 << 29
"""1.5 GiB, more than which no command may take for inputs of some hundred kilobytes."""
_ADDRESSES_BYTES = 4 << 30
"""Of address space, so that what asks for all of the memory takes no other process with it."""
_GRACE_S = 5.0
"""For processes that a command started to end after it."""
_BEGIN_S = {False: 0.02, True: 0.4}
"""Time that Python takes, seconds, until the first line of the package runs, in a fork or a fresh interpreter: what it
does with a signal before is not ours."""
_TOLD_BYTES = 1 << 20
_PR_SET_CHILD_SUBREAPER = 36
_MODULES = (
    *(f"cli.{name}" for name in ("calibrate", "diagnose", "plan", "correct", "locate", "simulate", "blind")),
    *("files.bag", "files.bag_mcap", "files.bag_sqlite3", "files.bag_corrected", "gap.calibration_with_effects"),
    *("simulation.twin", "report.calibration_report", "report.gap_report", "report.survey_report"),
)


def warm() -> None:
    """Import what the commands load, so that a fork has it; nothing of ROS, whose threads no fork survives."""
    for name in _MODULES:
        import_module(f"tam_calibration.{name}")
    for name in ("scipy.optimize", "scipy.spatial.transform", "scipy.special", "zstandard", "jinja2"):
        import_module(name)
    play, call = import_module("tam_calibration.cli.play"), import_module("tam_calibration.cli.call")
    play.WAIT_S = call._FIND_S = 0.2  # nobody will come
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)  # what a command leaves running becomes this process's child
    if threading.active_count() > 1:
        raise RuntimeError(f"a fork would lose {threading.enumerate()}")


def run(line: list[str], folder: Path, logs: Path, around: Surroundings = PLAIN, limit_s: float = LIMIT_S) -> Ended:
    """Run ``tam`` with a line and return how it ended.

    Parameters
    ----------
    line : list of str
        The words after ``tam``.
    folder : Path
        In which it runs.
    logs : Path
        Folder for what it says.
    around : Surroundings
        What else is about it; ``moment`` counts in seconds here.
    limit_s : float
        After which it is killed.
    """
    reader, writer = os.pipe() if around.stdout == "broken" else (-1, -1)
    streams = [logs / "stdout", logs / "stderr"]
    started, starter = os.pipe()
    began = time.monotonic()
    process = os.fork()
    if not process:
        os.close(started)
        _become(line, folder, streams, writer, around, starter)
    os.close(starter)
    os.read(started, 1)
    os.close(started)
    if writer >= 0:
        os.close(writer)
        if around.read_bytes:
            os.read(reader, around.read_bytes)
        os.close(reader)
    is_hung = not _wait(process, around, limit_s)
    _, status, used = os.wait4(process, 0)
    code = os.waitstatus_to_exitcode(status)
    said = [_said(path) for path in streams]
    seconds = time.monotonic() - began
    left = _end_others()
    return Ended(128 - code if code < 0 else code, code < 0, *said, seconds, used.ru_maxrss * 1024, is_hung, left)


def _wait(process: int, around: Surroundings, limit_s: float) -> bool:
    """Return whether a process has ended within its time; signal it at its moment, kill it at the limit."""
    descriptor = os.pidfd_open(process)
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    try:
        if around.ended_by is not None and not poll.poll(1000 * (_BEGIN_S[around.fresh] + around.moment)):
            signal.pidfd_send_signal(descriptor, around.ended_by)
        if poll.poll(1000 * limit_s):
            return True
        signal.pidfd_send_signal(descriptor, signal.SIGKILL)
        return False
    finally:
        os.close(descriptor)


def _said(path: Path) -> str:
    if not path.exists():
        return ""
    with path.open("rb") as file:
        return file.read(_TOLD_BYTES).decode(errors="backslashreplace")


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
        time.sleep(0.02)
    left = _children()
    for process in left:
        os.kill(process, signal.SIGKILL)
    while _reap():
        time.sleep(0.02)
    return tuple(left.values())


def _reap() -> bool:
    """Take leave of children that have ended, and return whether there are others."""
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return False
    return True


def _become(
    line: list[str], folder: Path, streams: list[Path], writer: int, around: Surroundings, starter: int
) -> None:
    """Be the command, in a fork; never returns."""
    code = 70
    try:
        os.setsid()
        _arrange(folder, streams, writer, around)
        os.write(starter, b".")
        os.close(starter)
        if around.fresh:
            os.execv(sys.executable, [sys.executable, "-m", "tam_calibration", *line])
        code = _run_here(line)
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def _arrange(folder: Path, streams: list[Path], writer: int, around: Surroundings) -> None:
    os.chdir(folder / around.within)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    _redirect(0, around.stdin or "/dev/null", os.O_RDONLY)
    _redirect(1, around.stdout or str(streams[0]), os.O_WRONLY | os.O_CREAT | os.O_TRUNC, writer)
    _redirect(2, around.stderr or str(streams[1]), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
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


def _redirect(number: int, target: str, flags: int, pipe: int = -1) -> None:
    if target == "closed":
        os.close(number)
    elif target == "broken":
        os.dup2(pipe, number)
    else:
        opened = os.open(target, flags, 0o666)
        os.dup2(opened, number)
        if opened != number:
            os.close(opened)


def _run_here(line: list[str]) -> int:
    """Do what ``python -m tam_calibration`` does, to the end of the interpreter, and return its exit code."""
    sys.argv = ["tam", *line]
    code: object = 0
    try:
        runpy.run_module("tam_calibration", run_name="__main__")
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
