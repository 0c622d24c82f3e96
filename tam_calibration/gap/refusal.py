"""The answer for a recording that allows no verdict: too short, at rest, or refused by `tam calibrate`."""

import numpy as np
from numpy.linalg import LinAlgError

from tam_calibration.effects.grades import LEAST_SAMPLES, NEGLIGIBLE
from tam_calibration.effects.library import installed_effects
from tam_calibration.fit.consistency import accepted, require_one_sphere
from tam_calibration.fit.identifiability import require_determined
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.gap.nominal import canonical_correlations, significant_correlation
from tam_calibration.gap.result import Considered, Gap, Residue, Size, Where
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.geomagnetic_field import FieldBounds
from tam_calibration.model.recording import Recording

ENOUGH_SAMPLES = 8000
"""Samples of a long recording that refusal and search take at most; the final fit takes all."""


def open_parameters(recording: Recording, array: Array) -> str | None:
    """Return which parameters the attitudes leave open, in one sentence, or None.

    Parameters
    ----------
    recording : Recording
        Raw readings of K sensors, tesla, and those of the scalar magnetometer where there is one.
    array : Array
        Of these sensors; a noise that is not stated is estimated.
    """
    try:
        require_determined(recording, array)
    except (InputError, LinAlgError) as problem:
        return str(problem)
    except Refused:
        return None  # the readings contradict each other: effects may explain it
    return None


def refusal_of(recording: Recording, array: Array) -> str | None:
    """Return why a calibration of the recording would be refused, in one sentence, or None.

    Parameters
    ----------
    recording : Recording
        As given; a long one is thinned.
    array : Array
        Of the recording; a noise that is not stated is estimated.
    """
    some = recording.thinned(ENOUGH_SAMPLES)
    try:
        require_determined(some, array)
        accepted(some, array, maximum_likelihood)
    except (InputError, Refused) as problem:
        return str(problem)
    except LinAlgError:
        return "the readings do not fit one calibration"
    return None


def without_calibration(recording: Recording, objection: str | None) -> str:
    """Return why no calibration is found within the bounds of sensors, and for which time.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    objection : str, optional
        Which bound the calibration that fits best exceeds.
    """
    try:
        require_one_sphere(recording)
    except Refused as problem:
        return str(problem)
    first, last = recording.time_span_s
    best = "" if objection is None else f": the one that fits best has {objection}"
    return f"no calibration that sensors can have fits the readings between {first:.1f} and {last:.1f} s{best}"


_LEAST_REDUNDANCY = 60
"""Degrees of freedom beyond the calibration that a verdict takes at least."""


def needed_samples(sensor_count: int) -> int:
    """Return how many samples any verdict takes."""
    channels = _LEAST_REDUNDANCY + 12 * sensor_count - 3
    return max(LEAST_SAMPLES, -(-channels // (3 * sensor_count - 2)))


def is_at_rest(recording: Recording, field: FieldBounds) -> bool:
    """Whether the first sensor hardly moves, or moves on a line, or no other's readings are correlated with it.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    field : FieldBounds
        Bounds of the intensity: readings whose spread is small against the lower one are at rest.
    """
    first = recording.readings_T[:, 0] - recording.readings_T[:, 0].mean(axis=0)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(first.T @ first / len(first)), 0))
    # As much as a turn of half a degree.
    if spread[1] < NEGLIGIBLE * field.low_T:
        return True
    shared = canonical_correlations(recording.readings_T)[1:, 1]
    return bool((shared < significant_correlation(recording.sample_count)).all()) if len(shared) else False


def at_rest(recording: Recording) -> Gap:
    """Return the answer without a verdict for an array that was not turned."""
    return _nothing(
        recording,
        "the array was not turned",
        "the array was hardly turned, or its sensors share no motion: calibration and effects cannot be told apart",
    )


def too_short(recording: Recording) -> Gap:
    """Return the answer without a verdict for a recording with too few samples."""
    count = recording.sensor_count
    needed, some = needed_samples(count), recording.sample_count
    why = f"{some} sample{'s' * (some > 1)} of {count} sensor{'s' * (count > 1)}"
    return _nothing(recording, "the recording is too short", f"it takes {needed} samples at least, not {why}")


def without_nominal(recording: Recording, why: str) -> Gap:
    """Return the answer without a verdict for a recording without a calibration.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    why : str
        Reason in one clause.
    """
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
        Where(),
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
