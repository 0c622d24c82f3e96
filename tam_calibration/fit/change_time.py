"""When an error of a sensor changed, where a recording shows it: from which time on its readings tell of the change."""

from itertools import pairwise

import numpy as np
from numpy.linalg import slogdet

from tam_calibration.fit.contradiction import Change
from tam_calibration.fit.information import inverted
from tam_calibration.fit.posterior import Known, Place, Posterior, Problem
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.recording import Recording

_MOST_BLOCKS = 100
"""Of equal length, at the beginning of one of which the change is placed: to a hundredth of the recording."""

_FEWEST_IN_BLOCK = 10
"""Samples of a block."""

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
    count = min(_MOST_BLOCKS, recording.sample_count // _FEWEST_IN_BLOCK)
    starts = np.linspace(0, recording.sample_count, count + 1).astype(int)
    place = Place(posterior.errors, posterior.intensity_T, posterior.view)
    has_scalar = recording.scalar_count is not None
    problems = [Problem.of(recording.take(slice(*span)), array, known, has_scalar) for span in pairwise(starts)]
    parts = [problem.data_at(place) for problem in problems]
    later = [np.cumsum([part[index] for part in parts[::-1]], axis=0)[::-1] for index in range(2)]
    basis, size = problems[0].basis_at(place), len(change.directions)
    directions = np.zeros((len(basis), 3))
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
        evidence.append((gain - slogdet(np.eye(3) + change.variance[:, None] * told)[1]) / 2)
    best = int(np.argmax(evidence))
    if evidence[best] - evidence[0] < _CONVINCING + np.log(count):
        return None
    return float(recording.time_s[starts[best]])
