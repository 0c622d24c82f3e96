"""The channels of a recording before any fit: what they hold that no sound sensor reads."""

from tam_calibration.integrity.check import require_enough, require_sound
from tam_calibration.integrity.fault import ACCEPTABLE, Fault

__all__ = ["ACCEPTABLE", "Fault", "require_enough", "require_sound"]
