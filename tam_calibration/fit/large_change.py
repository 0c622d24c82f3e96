"""Which change of the sensors explains a large contradiction: lengths are no straight lines over it.

Each is fitted by itself beside the prior, its own errors all but free, and they are compared by the energy that is left
and the number of their unknowns (Schwarz 1978).
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from tam_calibration.fit.contradiction import Change, log_odds, plausible
from tam_calibration.fit.estimate import sample_energies
from tam_calibration.fit.posterior import Known, Problem
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import SampleSource

_MOST_SAMPLES = 500
"""Of a recording, spread over it: what contradicts by as much shows in some."""


def large_change(
    recording: SampleSource, array: KnownNoiseArray, known: Known, candidates: Sequence[Sequence[Change]]
) -> list[Change]:
    """Return the most probable change, and after it those that are not improbable beside it; none where no fit settles.

    Parameters
    ----------
    recording : SampleSource
        Of K sensors.
    array : KnownNoiseArray
        With every noise.
    known : Known
        Of which the recording contradicts the prior.
    candidates : sequence of sequence of Change
        What may have changed, each in all sizes.
    """
    prior, some = known.prior, recording.whole()
    assert prior is not None
    some = some.take(slice(None, None, -(-some.sample_count // _MOST_SAMPLES)))
    weighed = []
    for *_, largest in candidates:
        used = prior.widened(largest.directions, largest.variance)
        with suppress(Refused):
            problem = Problem.of(some, array, replace(known, prior=used))
            place, _ = problem.settled(problem.start, is_corrected=False)
            left = float(sample_energies(some, array, known.variance_factors, place.errors, place.intensity_T).sum())
            left += used.terms(place.errors).energy + len(largest.variance) * np.log(some.sample_count)
            weighed.append((log_odds(largest) - left / 2, largest))
    return plausible(weighed) if weighed else []
