"""ROS domains for tests and batteries that run side by side: none is used by two of them at once."""

import fcntl
import os
import tempfile
from itertools import cycle, islice
from pathlib import Path

_LAST_DOMAIN = 101
"""Domains up to this have ports below those that the system hands out by itself."""

_domains = cycle(range(1, _LAST_DOMAIN + 1))


def lock_domain() -> tuple[int, int]:
    """Return the number of a ROS domain, and the open file whose closing frees it.

    Domains are taken in turn: what a killed process leaves in one of them has gone before it is used again.

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
            return domain, lock
    raise RuntimeError(f"all ROS domains from 1 to {_LAST_DOMAIN} are taken")
