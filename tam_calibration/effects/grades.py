"""Common thresholds of the diagnosis: parts of a whole, significance, and numbers of samples.

Every comparison of a part with a whole uses one of six widely spaced thresholds: a threshold of its own for each
comparison would be tuned to the recordings that were at hand.
"""

NEGLIGIBLE = 0.01
"""Part of a whole below the accuracy of models, time stamps and references."""

SLIGHT = 0.05
"""Part that may be a residual of something else, or chance."""

MINOR = 0.1
"""Part up to which the rest still determines the whole."""

NOTABLE = 0.25
"""Part from which something counts beside the rest."""

MOST = 0.5
"""Part from which something dominates the whole."""

NEARLY_ALL = 0.97
"""Part that is practically the whole."""

CERTAIN = 3.5
"""Significance, in standard deviations: one value of white noise in two thousand is beyond."""

LEAST_SAMPLES = 24
"""Samples that determine a level or a variance to some ten or twenty per cent."""

FEWEST = 4
"""Consecutive samples, or samples at one value, that are no coincidence."""

LONGEST_BURST = 8
"""Samples of one event; what lasts longer is a course in time."""
