"""What `tam calibrate` would refuse of a recording, and why: told in front of a diagnosis."""

import numpy as np
from numpy.linalg import LinAlgError

from tam_calibration.array import Array
from tam_calibration.exceptions import InputError, Refused
from tam_calibration.fit.calibrate import accepted
from tam_calibration.fit.consistency import require_one_sphere
from tam_calibration.fit.identifiability import require_determined
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.recording import Recording

ENOUGH_SAMPLES = 8000
"""Of a long recording neither a refusal nor a search takes more; the fit that a search ends with takes all."""

_COPIED = 1 - 1e-13
"""Correlation of two axes that only rounding tells apart; noise of a millionth of the readings' spread makes less."""


def open_parameters(recording: Recording, array: Array) -> str | None:
    """Return which parameters the attitudes leave open, in one sentence, or None."""
    try:
        require_determined(recording, array)
    except (InputError, LinAlgError) as problem:
        return str(problem)
    return None


def refusal_of(recording: Recording, array: Array) -> str | None:
    """Return why a calibration of the recording would be refused, in one sentence, or None."""
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
    """Return why no calibration is found within what sensors can be, and for which time that is so.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    objection : str, optional
        What the calibration that fits best has, and no sensor.
    """
    try:
        require_one_sphere(recording)
    except Refused as problem:
        return str(problem)
    first, last = recording.time_span_s
    best = "" if objection is None else f": the one that fits best has {objection}"
    return f"no calibration that sensors can have fits the readings between {first:.1f} and {last:.1f} s{best}"


def require_no_copies(recording: Recording) -> None:
    """Check that no axis repeats another, scaled and shifted or not.

    Raises
    ------
    InputError
        It names both.
    """
    correlation = np.corrcoef(recording.readings_T.reshape(recording.sample_count, -1), rowvar=False)
    copies = np.argwhere(np.tril(np.abs(correlation) > _COPIED, -1))
    if len(copies):
        copy, original = (f"sensor {row // 3 + 1} axis {'xyz'[row % 3]}" for row in copies[0].tolist())
        raise InputError(f"{copy} repeats {original} but for scale and offset: it is no sensor of its own")
