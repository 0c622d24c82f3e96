"""Causes outside the library, the sealed half: kinds of two authors, neither of whom knew the other's.

One kind has the same name in both; that of the second stands.
"""

from tam_calibration.validation.blind import outside_sealed_causes, outside_sealed_others
from tam_calibration.validation.blind.disturbance import Entry

SEALED: dict[str, Entry] = outside_sealed_causes.SEALED | outside_sealed_others.SEALED
"""The causes by their names."""
