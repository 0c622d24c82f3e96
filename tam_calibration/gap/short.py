"""What is said of a recording that is too short for any verdict."""

import numpy as np

from tam_calibration.effects.library import installed_effects
from tam_calibration.gap.result import Considered, Gap, Residue, Size, Where
from tam_calibration.recording import Recording

LEAST_REDUNDANCY = 60
"""Channels beyond the parameters of the calibration below which nothing is said."""


def redundancy(recording: Recording) -> int:
    """Return by how many the readings outnumber fields and calibration, at most."""
    per_sample = 3 * recording.sensor_count - 2
    return recording.sample_count * per_sample - (12 * recording.sensor_count - 3)


def too_short(recording: Recording) -> Gap:
    """Return that nothing can be said, and how many samples it takes."""
    count = recording.sensor_count
    needed = int(np.ceil((LEAST_REDUNDANCY + 12 * count - 3) / (3 * count - 2)))
    why = f"{recording.sample_count} samples of {count} sensor{'s' * (count > 1)} are too few for any verdict"
    nothing = np.full((recording.sample_count, 3 * count + 1), np.nan)
    unknown = float("nan")
    return Gap(
        "not_identifiable",
        Size(unknown, unknown, unknown, unknown, unknown, unknown, unknown, unknown, (unknown, unknown)),
        Where((), (), None, None, {}),
        (),
        tuple(Considered(name, "not_identifiable", "the recording is too short") for name in installed_effects()),
        {},
        f"Record {2 * needed} samples or more while turning the array through all attitudes.",
        f"No verdict: {why}; it takes {needed} at least.",
        Residue(
            recording.time_s,
            np.full((recording.sample_count, 3), np.nan),
            nothing,
            nothing,
            nothing,
            np.full(3 * count + 1, np.nan),
        ),
    )
