"""The constants that the search for laws decides by, in one place."""

import numpy as np

LENGTHS = (1.0, 0.25, 0.06, 0.015, 0.004)
"""Correlation lengths of a course, as parts of the recording; ``COARSE`` bins show the first two."""

COARSE = 64
"""Bins for courses that are slow: sixteen in a quarter of the recording."""

SLOW = 0.06
"""Least correlation length of a course that is called slow, as a part of the recording."""

TOLERANCE = 0.1
"""Model error of any law, as a part of the gap's amplitude: no law of nature is as simple as the one fitted."""

LEAST_EVIDENCE = 14.0
"""Least log evidence of a law: 1 in 10⁶ for each of some thousand patterns, courses and places tried."""

LEAST_SHARE = 0.04
"""Least share of the gap's energy for a further law."""

TIE = 3.0
"""Log evidence up to which two places are not told apart: odds of 20."""

SIZES = np.geomspace(1e-6, 1e10, 33)
"""Variances of a constant coefficient that are tried, in units of the noise of one sample."""

FREEDOM = {
    "constant": 0.0,
    "step": 0.0,
    "channel": 0.0,
    "tone": 0.5,
    "episodes": 0.5,
    "motion": 0.5,
    "slow": 2.0,
    "random": 3.0,
    "offset": 0.0,
    "rate": 0.2,
    "own_field": 0.3,
    "gain": 1.5,
    "attitude": 1.6,
}
"""Freedom of each course and of each law: the sums order what explains a gap about as well."""

SCATTER_SIZES = np.geomspace(0.01, 1e8, 41)
"""Variances that are tried, in units of the noise of a channel."""

MOST_TRIED = 6
"""Laws, the best first, of which each may be accepted where those before it predict nothing."""
