"""The memory that a process may have: libraries of linear algebra do not end well where it does not suffice."""

import resource
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from tam_calibration.model.exceptions import InputError


def load_within_limit(libraries: Sequence[str], needed_bytes: int) -> None:
    """Load libraries at once where the memory of the process is limited (``ulimit -v``), before data take it.

    OpenBLAS, when it is loaded and finds no memory, asks for it again without end, and hears no signal.

    Parameters
    ----------
    libraries : sequence of str
        Names of modules that are else loaded when they are used first.
    needed_bytes : int
        What they and a small problem need.

    Raises
    ------
    InputError
        When the limit leaves less.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return
    in_use = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    if limit - in_use < needed_bytes:
        raise InputError(
            f"this process may have {limit >> 20} MiB of memory, and needs {needed_bytes >> 20} in addition to the "
            f"{in_use >> 20} in use: raise the limit (ulimit -v)"
        )
    for library in libraries:
        import_module(library)
