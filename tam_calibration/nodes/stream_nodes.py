"""Collector and corrector in one process: a sample that both handle wakes no second process.

The localizer has its own, so that its fits hold up no sample.
"""

from tam_calibration.nodes.collector_node import Collector
from tam_calibration.nodes.corrector_node import Corrector
from tam_calibration.nodes.signals import Startup
from tam_calibration.nodes.spinning import spin_nodes


def spin(startup: Startup) -> None:
    """Run both nodes until they are told to end."""
    spin_nodes(startup, [Collector, Corrector])
