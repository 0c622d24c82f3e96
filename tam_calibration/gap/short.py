"""What is said of a recording that is too short for any verdict."""

import numpy as np

from tam_calibration.effects.library import installed_effects
from tam_calibration.gap.result import Considered, Gap, Residue, Size, Where
from tam_calibration.recording import Recording

_LEAST_REDUNDANCY = 60
"""Channels beyond the parameters of the calibration below which nothing is said."""

_LEAST_SAMPLES = 20
"""Without a fold of them still well above nine, which determine an ellipsoid."""


def needed_samples(sensor_count: int) -> int:
    """Return how many samples any verdict takes."""
    channels = _LEAST_REDUNDANCY + 12 * sensor_count - 3
    return max(_LEAST_SAMPLES, -(-channels // (3 * sensor_count - 2)))


def too_short(recording: Recording) -> Gap:
    """Return that nothing can be said, and how many samples it takes."""
    count = recording.sensor_count
    needed, some = needed_samples(count), recording.sample_count
    why = f"{some} sample{'s' * (some > 1)} of {count} sensor{'s' * (count > 1)}"
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
        f"No verdict: it takes {needed} samples at least, not {why}.",
        Residue(
            recording.time_s,
            np.full((recording.sample_count, 3), np.nan),
            nothing,
            nothing,
            nothing,
            np.full(3 * count + 1, np.nan),
        ),
    )
