"""Entry point of the calibrator: light, so that a signal ends it well even while its libraries load."""

import sys

from tam_calibration.nodes.process import run


def main() -> int:
    """Run the calibrator until it is told to end."""
    return run("tam_calibration.nodes.calibrator_node")


if __name__ == "__main__":
    sys.exit(main())
