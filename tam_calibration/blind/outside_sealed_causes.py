"""Causes outside the library, the sealed half. Who writes rules of the diagnosis does not open this file.

Nor the files whose names begin like this one's, their test, or the keys of cases that hold such a cause: these are read
as counts only. A judgement on causes that somebody tuned for says nothing about those that nobody thought of.
"""

from tam_calibration.blind.entry import Entry

SEALED: dict[str, Entry] = {}
"""The causes by their names."""
