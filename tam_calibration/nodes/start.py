"""The entry points of the nodes: light, so that a signal ends a node well even while its libraries load.

``python -m tam_calibration.nodes.start collector --ros-args …`` does as ``ros2 run tam_calibration collector …``.
"""

import sys
from importlib import import_module

from tam_calibration.model.exceptions import InputError, printable
from tam_calibration.model.libraries import use_one_thread
from tam_calibration.model.signals import Ending


def calibrator() -> int:
    """Run the calibrator until it is told to end."""
    return _run("Calibrator")


def collector() -> int:
    """Run the collector until it is told to end."""
    return _run("Collector")


def corrector() -> int:
    """Run the corrector until it is told to end."""
    return _run("Corrector")


def localizer() -> int:
    """Run the localizer until it is told to end."""
    return _run("Localizer")


def stream() -> int:
    """Run collector and corrector in one process: a sample that both handle wakes no second process.

    The localizer has its own, so that its fits hold up no sample.
    """
    return _run("Collector", "Corrector")


def _run(*names: str) -> int:
    """Load nodes and spin them.

    Returns
    -------
    int
        The exit code: 0 when the nodes were told to end, 2 when a parameter or file is not usable (said on stderr).
    """
    if not {"-h", "--help"}.isdisjoint(sys.argv):
        print(f"Runs {' and '.join(names)} until Ctrl-C. Parameters: --ros-args -p name:=value, or --params-file FILE.")
        return 0
    ending = Ending(exit_code=0)
    use_one_thread()
    try:
        session = import_module("tam_calibration.nodes.session")
        session.configure_fast_dds()
        nodes = [getattr(import_module(f"tam_calibration.nodes.{name.lower()}_node"), name) for name in names]
        session.spin_nodes(ending, nodes)
    except (InputError, OSError) as problem:
        print(f"tam: {printable(problem)}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    entry_points = {each.__name__: each for each in (calibrator, collector, corrector, localizer, stream)}
    sys.exit(entry_points[sys.argv.pop(1)]())
