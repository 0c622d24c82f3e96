"""What is said of a recording that is too short, or too still, for any verdict."""

import numpy as np

from tam_calibration.effects.grades import LEAST_SAMPLES, NEGLIGIBLE
from tam_calibration.effects.library import installed_effects
from tam_calibration.field_bounds import FieldBounds
from tam_calibration.gap.result import Considered, Gap, Residue, Size, Where
from tam_calibration.gap.shared_motion import canonical_correlations, sure_correlation
from tam_calibration.recording import Recording

_LEAST_REDUNDANCY = 60
"""Channels beyond the parameters of the calibration below which nothing is said."""


def needed_samples(sensor_count: int) -> int:
    """Return how many samples any verdict takes."""
    channels = _LEAST_REDUNDANCY + 12 * sensor_count - 3
    return max(LEAST_SAMPLES, -(-channels // (3 * sensor_count - 2)))


def is_at_rest(recording: Recording, field: FieldBounds) -> bool:
    """Whether the first sensor stands still or moves on a line, or no other sees it move: the calibration is open."""
    first = recording.readings_T[:, 0] - recording.readings_T[:, 0].mean(axis=0)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(first.T @ first / len(first)), 0))
    # A turn of half a degree makes as much.
    if spread[1] < NEGLIGIBLE * field.low_T:
        return True
    shared = canonical_correlations(recording.readings_T)[1:, 1]
    return bool((shared < sure_correlation(recording.sample_count)).all()) if len(shared) else False


def at_rest(recording: Recording) -> Gap:
    """Return that nothing can be said, and that the array must be turned."""
    return _nothing(
        recording,
        "the array was not turned",
        "the array was hardly turned, or its sensors share no motion: calibration and effects cannot be told apart",
    )


def too_short(recording: Recording) -> Gap:
    """Return that nothing can be said, and how many samples it takes."""
    count = recording.sensor_count
    needed, some = needed_samples(count), recording.sample_count
    why = f"{some} sample{'s' * (some > 1)} of {count} sensor{'s' * (count > 1)}"
    return _nothing(recording, "the recording is too short", f"it takes {needed} samples at least, not {why}")


def without_nominal(recording: Recording, why: str) -> Gap:
    """Return that no calibration can be had to hold the recording against, why, and for which time."""
    return _nothing(recording, "there is no calibration to start from", why)


def _nothing(recording: Recording, why: str, reason: str) -> Gap:
    count = recording.sensor_count
    first, last = recording.time_span_s
    needed = needed_samples(count)
    nothing = np.full((recording.sample_count, 3 * count + 1), np.nan)
    unknown = float("nan")
    return Gap(
        "not_identifiable",
        Size(unknown, unknown, unknown, unknown, unknown, unknown, unknown, unknown, (unknown, unknown)),
        Where((), (), None, None, {}),
        (),
        tuple(Considered(name, "not_identifiable", why) for name in installed_effects()),
        {},
        f"Record {2 * needed} samples or more while turning the array through all attitudes.",
        f"No verdict on the time from {first:.1f} to {last:.1f} s: {reason}.",
        Residue(
            recording.time_s,
            np.full((recording.sample_count, 3), np.nan),
            nothing,
            nothing,
            nothing,
            np.full(3 * count + 1, np.nan),
        ),
    )
