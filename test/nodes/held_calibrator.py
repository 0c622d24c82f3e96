"""A calibrator whose diagnosis waits, once it has told how far it is, until somebody has written to a pipe.

``python held_calibrator.py PIPE ARGUMENTS``: the arguments are those of the node.
"""

import sys
from pathlib import Path

from tam_calibration.gap import diagnose
from tam_calibration.nodes import calibrator_node, start


def main():
    """Run the node until it is told to end."""
    pipe = Path(sys.argv.pop(1))
    opened = []

    def diagnose_held(*arguments, progress, **options):
        def told(stage, done):
            progress(stage, done)
            if not opened:
                opened.append(pipe.read_bytes())

        return diagnose(*arguments, progress=told, **options)

    calibrator_node.diagnose = diagnose_held
    return start.calibrator()


sys.exit(main())
