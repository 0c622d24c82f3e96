"""Calibration of cross arrays of tri-axial magnetometers, on line over ROS 2 and offline."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("tam_calibration")
except PackageNotFoundError:  # run from a source tree that was not installed
    __version__ = "unknown"
