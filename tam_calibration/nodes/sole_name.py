"""One name, one node: on a machine the name of a node is taken until its process ends, however that ends."""

import socket
import struct
import sys
from hashlib import sha256

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
