"""The process of a node: it ends with exit code 0 whenever it is told to."""

import sys
from importlib import import_module

from tam_calibration.exceptions import InputError
from tam_calibration.nodes.signals import Startup


def run(module: str) -> int:
    """Load the module of a node and call its ``spin``.

    Returns
    -------
    int
        The exit code: 0 when it was told to end, 2 when a parameter or file is not usable (said on stderr).
    """
    startup = Startup()
    try:
        import_module(module).spin(startup)
    except (InputError, OSError) as problem:
        print(f"tam: {problem}", file=sys.stderr)
        return 2
    return 0
