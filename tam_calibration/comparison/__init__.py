"""Comparison of a simulator's recording with a real one: what differs, and what to change in the simulator."""

from tam_calibration.comparison.compare import compare

__all__ = ["compare"]
