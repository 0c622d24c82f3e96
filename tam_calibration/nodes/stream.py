"""Entry point of collector and corrector in one process: light, as those of single nodes are."""

import sys

from tam_calibration.nodes.process import run


def main() -> int:
    """Run both nodes until they are told to end."""
    return run("tam_calibration.nodes.stream_nodes")


if __name__ == "__main__":
    sys.exit(main())
