"""The grades by which the diagnosis decides how much is much, how sure is sure and how many are enough.

Every question whether a part of a whole counts is answered by one of six grades, which are far apart: a threshold of
its own for each question would be fitted to the recordings that were at hand when it was asked.
"""

NEGLIGIBLE = 0.01
"""Part of a whole that models, stamps and references do not tell anyway."""

SLIGHT = 0.05
"""Part that is there, but may be what something else leaves or makes by chance."""

MINOR = 0.1
"""Part up to which a whole is still what the rest makes it."""

NOTABLE = 0.25
"""Part from which something has to be told beside the rest."""

MOST = 0.5
"""Part from which something makes the whole what it is."""

NEARLY_ALL = 0.97
"""Part that for most purposes is the whole."""

CERTAIN = 3.5
"""Standard deviations that are no chance: of white noise one value in two thousand is beyond them."""

LEAST_SAMPLES = 24
"""Of which a level or a variance is told, to some ten or twenty per cent."""

FEWEST = 4
"""Samples in a row, or at one value, that are no coincidence."""

LONGEST_BURST = 8
"""Samples of one event; what lasts longer is a course in time."""
