"""Entry point of the localizer: light, so that a signal ends it well even while its libraries load."""

import sys

from tam_calibration.nodes.process import run


def main() -> int:
    """Run the localizer until it is told to end."""
    return run("tam_calibration.nodes.localizer_node")


if __name__ == "__main__":
    sys.exit(main())
