"""When an error of a sensor changed, where a recording shows it: from which time on its readings tell of the change."""

from itertools import pairwise

import numpy as np
from numpy.linalg import slogdet

from tam_calibration.core.variance_factors import VarianceFactors
from tam_calibration.fit.contradiction import Change
from tam_calibration.fit.estimate import sample_energies
from tam_calibration.fit.information import inverted
from tam_calibration.fit.posterior import Known, Place, Posterior, Problem
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

_MOST_BLOCKS = 100
"""Of equal length, at the beginning of one of which the change is placed: to a hundredth of the recording."""

_BY_CHANCE = 1e-6
"""Probability of a sample's energy beyond which it does not fit: none in most recordings."""

_CONVINCING = 5.0
"""Logarithm of the evidence, beside that of the number of times tried, for a change within the recording."""


def time_of_change(
    recording: Recording, array: KnownNoiseArray, known: Known, posterior: Posterior, change: Change
) -> float | None:
    """Return the time stamp from which on errors were changed; None where they were so from the start.

    A change from block j on acts with the information of the samples from there on, while the errors before it are
    those of the prior: as in ``contradiction``, the evidences of all j are compared.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    array : KnownNoiseArray
        With every noise.
    known : Known
        What is known before; the recording contradicts its prior.
    posterior : Posterior
        Of both.
    change : Change
        What moved.
    """
    count = min(_MOST_BLOCKS, recording.sample_count)
    starts = np.linspace(0, recording.sample_count, count + 1).astype(int)
    place = Place(posterior.errors, posterior.intensity_T, posterior.view)
    has_scalar = recording.scalar_count is not None
    problems = [Problem.of(recording.take(slice(*span)), array, known, has_scalar) for span in pairwise(starts)]
    parts = [problem.data_at(place) for problem in problems]
    later = [np.cumsum([part[index] for part in parts[::-1]], axis=0)[::-1] for index in range(2)]
    basis, (size, unknowns) = problems[0].basis_at(place), change.directions.shape
    directions = np.zeros((len(basis), unknowns))
    directions[:size] = change.directions
    whole = later[0][0].copy()
    problems[0].add_known(place, whole, np.zeros(len(whole)))
    covariance = inverted(whole, basis)
    evidence = []
    for information, gradient in zip(*later, strict=True):
        reached = information @ directions
        told = directions.T @ reached - reached.T @ covariance @ reached
        score = directions.T @ gradient
        gain = score @ np.linalg.solve(told + np.diag(1 / change.variance), score)
        evidence.append((gain - slogdet(np.eye(unknowns) + change.variance[:, None] * told)[1]) / 2)
    best = int(np.argmax(evidence))
    if evidence[best] - evidence[0] < _CONVINCING + np.log(count):
        return None
    return float(recording.time_s[starts[best]])


def samples_between(
    recording: Recording, array: KnownNoiseArray, factors: VarianceFactors, before: Posterior, after: Posterior
) -> tuple[int, int]:
    """Return the number of samples that the errors before a change fit, and the place from which on those after it do.

    Of a change of many times the noise, which bends what ``time_of_change`` takes for straight, this is the time. While
    it lasts, as when a tool is picked up, samples fit neither: they lie between the two places.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    array : KnownNoiseArray
        With every noise.
    factors : VarianceFactors
        Of the channels, as of ``Known``.
    before, after : Posterior
        Of the samples before the change and of those after it, or most of them.
    """
    old, new = (sample_energies(recording, array, factors, fit.errors, fit.intensity_T) for fit in (before, after))
    gained = np.cumsum((old - new)[::-1])[::-1]
    last = first = 1 + int(np.argmax(gained[1:]))
    channels = 3 * array.sensor_count - 2
    old_limit, new_limit = _largest(old[:last], channels), _largest(new[first:], channels)
    while last > 1 and old[last - 1] > old_limit:
        last -= 1
    while first < len(new) - 1 and new[first] > new_limit:
        first += 1
    return last, first


def _largest(energies: FloatArray, channels: int) -> float:
    """Return the energy beyond which a sample does not fit, where most do, or do as well as these."""
    from scipy.special import chdtri

    usual, limit = chdtri(channels, [0.5, _BY_CHANCE])
    return float(limit * max(1.0, np.median(energies) / usual))
