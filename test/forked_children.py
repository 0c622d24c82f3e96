"""Processes that are forked from one that has loaded their libraries, which else costs a second of each of hundreds."""

import os
import runpy
import signal
import subprocess
import sys
from contextlib import suppress
from multiprocessing import active_children, forkserver, get_context, resource_tracker

from tam_calibration.model import signals
from tam_calibration.nodes import bound
from tam_calibration.nodes.session import NODES, Children

SERVER = get_context("forkserver")


def start_server():
    """Start the process from which others are forked; they hold signals back as those of `Children` do."""
    forkserver._forkserver._stop()  # that of another test, which holds nothing back
    SERVER.set_forkserver_preload([f"tam_calibration.nodes.{name}_node" for name in NODES])
    resource_tracker.ensure_running()  # it would let them through
    with signals.held_back():
        forkserver.ensure_running()


def end_forked(others):
    """Kill what was forked and still runs, but for others: its environment, which came later, tells not whose it is."""
    for process in set(active_children()) - set(others):
        process.kill()
        process.join()


class ForkedChildren(Children):
    """Children that run a module, or a script, as a Python of their own would; but that leaves out its last moments."""

    def _start(self, name):
        self._logs[name].parent.mkdir(parents=True, exist_ok=True)
        self._logs[name].touch()
        self._processes[name] = _Forked(self._commands[name], self._logs[name])


class _Forked:
    """What `subprocess.Popen` is to `Children`."""

    def __init__(self, command, log):
        self._process = SERVER.Process(target=_run, args=(command, dict(os.environ), log), daemon=True)
        self._process.start()
        self.pid = self._process.pid

    def poll(self):
        return self._process.exitcode

    def wait(self, timeout=None):
        self._process.join(timeout)
        if self._process.is_alive():
            raise subprocess.TimeoutExpired(self.pid, timeout)
        return self._process.exitcode

    def send_signal(self, number):
        if self._process.is_alive():
            with suppress(ProcessLookupError):  # it ended a moment ago, and the server has not said so yet
                os.kill(self.pid, number)

    def kill(self):
        self.send_signal(signal.SIGKILL)


def _run(command, environment, log):
    bound._bind(os.getppid())
    os.close(forkserver._forkserver._forkserver_alive_fd)  # else the server outlives a test that is killed, and so this
    os.setsid()
    output = os.open(log, os.O_WRONLY | os.O_APPEND)
    for stream in (1, 2):
        os.dup2(output, stream)
    os.environ.clear()
    os.environ.update(environment)
    is_module = command[0] == "-m"
    sys.argv = command[is_module:]
    run = runpy.run_module if is_module else runpy.run_path
    run(sys.argv[0], run_name="__main__")
