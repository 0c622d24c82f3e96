"""A simulator's recording beside a real one: what differs, and the mend."""

from tam_calibration.comparison.compare import compare

__all__ = ["compare"]
