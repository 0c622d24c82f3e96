"""Bursts of samples that something strikes at random times: what effects of single samples simulate."""

import numpy as np
from numpy.typing import NDArray

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import Contribution


def drawn_bursts(part: Contribution, sample_count: int, generator: np.random.Generator) -> tuple[NDArray[np.intp], int]:
    """Draw when bursts start; return their first samples, and how many samples each has.

    Parameters
    ----------
    part : Contribution
        With the ``rate``, the part of all samples that is struck, and the ``burst`` in samples, by default one.
    sample_count : int
        Of the run.
    generator : numpy.random.Generator
        Source of the random numbers.

    Raises
    ------
    InputError
        When the rate is no part, or the burst longer than the run.
    """
    rate, burst = part.values["rate"], samples_in(part, "burst", sample_count)
    if not 0 <= rate <= 1:
        raise InputError(f"the rate of {part.term} must be a part of all samples, 0 to 1, not {rate:g}")
    return np.flatnonzero(generator.random(sample_count) < rate / burst), burst


def samples_in(part: Contribution, name: str, sample_count: int) -> int:
    """Return a number of samples, at least and by default one, that a contribution states.

    Parameters
    ----------
    part : Contribution
        Of the effect.
    name : str
        Of the value.
    sample_count : int
        Of the run, which the number must not exceed.

    Raises
    ------
    InputError
        When it does, or is negative.
    """
    number = part.values.get(name, 1.0)
    if not 0 <= number <= sample_count:
        raise InputError(
            f"the {name} of {part.term} must be at most the {sample_count} samples of the run, not {number:g}"
        )
    return max(1, round(number))
