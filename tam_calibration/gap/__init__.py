"""The gap between a recording and its simulation: where it lies, which effect causes it, how far it shrinks."""

from tam_calibration.gap.diagnose import diagnose

__all__ = ["diagnose"]
