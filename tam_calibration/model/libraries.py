"""Libraries: how many processors and how much memory they may use, and which of them only some commands need.

Not all of those are in Ubuntu, and a robot has no use for them.
"""

import os
import resource
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from tam_calibration.model.exceptions import InputError

EXTRAS = {
    "bags": ("rosbags", "zstandard", "lz4"),
    "report": ("jinja2", "matplotlib"),
    "fleet": ("distributed",),
    "compare": ("mujoco",),
    "tables": ("pandas", "pyarrow"),
}
"""What each extra of setup.py brings, by the names of the modules."""

_UBUNTU = {"report": "sudo apt install python3-jinja2 python3-matplotlib, or "}
"""How to get the extras that Ubuntu has, in versions that will do."""


def require(extra: str, purpose: str) -> None:
    """Check that the libraries of an extra are installed.

    Parameters
    ----------
    extra : str
        A name in `EXTRAS`.
    purpose : str
        What needs it, the subject of the sentence.

    Raises
    ------
    InputError
        When one is missing; the sentence says how to install it, also where Python is managed by the system.
    """
    for library in EXTRAS[extra]:
        try:
            import_module(library)
        except ModuleNotFoundError:
            pip = f"pip install 'tam_calibration[{extra}]' in a virtual environment"
            remedy = f"{_UBUNTU.get(extra, '')}{pip} (python3 -m venv --system-site-packages)"
            raise InputError(f"{purpose} needs {library}: {remedy}") from None


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


def use_one_thread() -> None:
    """Have linear algebra use one thread, by default: matrices here are small, and threads only wait.

    To be called before numpy is loaded.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
