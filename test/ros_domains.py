"""ROS domains for tests and batteries that run side by side: none is used by two of them at once."""

import fcntl
import os
import re
import tempfile
from contextlib import suppress
from itertools import cycle, islice
from pathlib import Path

_LAST_DOMAIN = 101
"""Domains up to this have ports below those that the system hands out by itself."""

_FIRST_PORT, _PORTS = 7400, 250
"""The first port of DDS, and how many each domain has."""

_domains = cycle(range(1, _LAST_DOMAIN + 1))


def lock_domain() -> tuple[int, int]:
    """Return the number of a ROS domain, and the open file whose closing frees it.

    What killed processes left in shared memory goes: a port that is left keeps the settings of who made it.

    Raises
    ------
    RuntimeError
        When all domains are taken.
    """
    for domain in islice(_domains, _LAST_DOMAIN):
        lock = os.open(Path(tempfile.gettempdir()) / f"ros_domain_{domain}.lock", os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
        else:
            _remove_ports(range(_FIRST_PORT + domain * _PORTS, _FIRST_PORT + (domain + 1) * _PORTS))
            return domain, lock
    raise RuntimeError(f"all ROS domains from 1 to {_LAST_DOMAIN} are taken")


def remove_leftovers(memory: Path = Path("/dev/shm"), processes: Path = Path("/proc")) -> None:
    """Remove the shared memory of Fast DDS unless a process uses some: what was killed may have left a lock for ever.

    Parameters
    ----------
    memory : Path
        Folder of the shared memory.
    processes : Path
        Folder with the memory maps of all processes.
    """
    for maps in processes.glob("[0-9]*/maps"):
        with suppress(OSError):
            if "fastrtps_" in maps.read_text():
                return
    for path in memory.glob("*fastrtps_*"):
        with suppress(OSError):
            path.unlink()


def _remove_ports(ports: range) -> None:
    """Remove the ports of Fast DDS in shared memory that have such numbers."""
    for path in Path("/dev/shm").glob("*fastrtps_port*"):
        if int(re.sub(r".*_port(\d+).*", r"\1", path.name)) in ports:
            path.unlink(missing_ok=True)
