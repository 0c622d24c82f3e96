"""Gross mistakes of simulators: units, frames, the world's field and noise, found before anything is fitted."""

from tam_calibration.comparison.mistakes.find import mistakes_of

__all__ = ["mistakes_of"]
