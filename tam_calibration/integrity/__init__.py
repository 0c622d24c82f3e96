"""The channels of a recording before any fit: what they hold that no sound sensor reads."""

from tam_calibration.integrity.check import require_enough, require_sound
from tam_calibration.integrity.fault import ACCEPTABLE, CHANNEL_FAULTS, Fault, require_names

__all__ = ["ACCEPTABLE", "CHANNEL_FAULTS", "Fault", "require_enough", "require_names", "require_sound"]
