"""What a diagnosis looks at of a long recording: stretches of it, so that time and memory have a bound.

Within a stretch nothing is left out, so that what goes on from sample to sample stays: delays, ringing, spikes, the
spectrum. One stretch lies in each equal part of the run, so that what is slow stays too; where in its part it lies is
uneven, so that nothing that comes again and again hides between them.
"""

import numpy as np

from tam_calibration.model.recording import Recording, SampleSource

MOST_SAMPLES = 100_000
"""Samples that a diagnosis looks at, at most: a quarter of an hour at 100 Hz, in less than 500 MiB."""

STRETCH = 1000
"""Samples of a stretch: many times the memory of filters and loops, and a hundredth of all that are looked at."""

_GOLDEN_SECTION = (np.sqrt(5) - 1) / 2
"""Its multiples are, without their whole part, spread evenly over 0 to 1 however many there are (Weyl)."""


def in_stretches(source: SampleSource) -> tuple[Recording, tuple[str, ...]]:
    """Return what a diagnosis looks at of a recording, and what is to be said about that.

    Parameters
    ----------
    source : SampleSource
        N samples, which need not fit into memory.

    Returns
    -------
    recording : Recording
        All samples, or where there are more than ``MOST_SAMPLES`` so many, in stretches of ``STRETCH``.
    remarks : tuple of str
        One sentence where samples are left out.
    """
    count, parts = source.sample_count, MOST_SAMPLES // STRETCH
    if count <= MOST_SAMPLES:
        return source.whole(), ()
    part = np.arange(parts)
    free = count / parts - STRETCH
    starts = (part * count / parts + free * (part * _GOLDEN_SECTION % 1)).astype(int)
    chosen = np.zeros(count, dtype=bool)
    chosen[starts[:, None] + np.arange(STRETCH)] = True
    recording = source.take(chosen).whole()
    longest_s = float(np.diff(recording.time_s).max())
    remark = (
        f"Of {count} samples the diagnosis looks at {recording.sample_count}, in {parts} stretches that are spread "
        f"over the run: what happens between them only, in up to {longest_s:.3g} s, is not seen."
    )
    return recording, (remark,)
