"""The process of a node: no second one has its name, and it precedes those that only compute."""

import os
import socket
import struct
import sys
from hashlib import sha256
from pathlib import Path

from tam_calibration.model.exceptions import InputError

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


LOWEST_PRIORITY = 1
"""Of the real-time priorities (1 to 99): above all that is not real-time, below all else that is."""


def precede() -> str:
    """Have the threads of this process, and those that they start, run before all that are not real-time.

    Returns
    -------
    str
        How the process is scheduled, for /diagnostics: as before where its user has no right to more.
    """
    try:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_RR, os.sched_param(LOWEST_PRIORITY))
    except PermissionError:
        return "normal: this user may not use real-time priorities"
    return f"real-time, priority {LOWEST_PRIORITY}"
