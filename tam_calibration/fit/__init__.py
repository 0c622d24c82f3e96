"""The fits: each method takes a recording and an array and returns a calibration; they differ in nothing else."""

from tam_calibration.fit.calibrate import DEFAULT_METHOD, METHODS, calibrate

__all__ = ["DEFAULT_METHOD", "METHODS", "calibrate"]
