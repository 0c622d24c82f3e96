"""The constants that the search for laws decides by, in one place."""

import numpy as np

MOST_SAMPLES = 8000
"""Samples that the search looks at, at most: more would not change which law predicts best."""

BINS = 512
"""Bins of a course in time, at most: an eighth of a second in a minute."""

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

MOST_LAWS = 3
"""Laws of one gap, at most."""

TIE = 3.0
"""Log evidence up to which two places are not told apart: odds of 20."""

SPIKE = 6.0
"""Standard deviations from its neighbours from which a sample is a spike: noise exceeds it once in 10⁹."""

SHEET = 0.15
"""Part by which the noise of a data sheet is off in sound sensors."""

NEAR = 0.6
"""Part of the energy of the best sensor from which another may hold the disturbance."""

NEARLY = 0.005
"""Part of the evidence by which a simpler law may be behind: models are wrong by more where the gap is large."""

LAGS = (0.0, 0.02, 0.1)
"""Lags of a recorded channel, as parts of the recording."""

RANGES = (0.5, 0.1, 0.02)
"""Correlation lengths of a function of the own reading, as parts of its range."""

OWN_BINS = 256
"""Bins of an own reading."""

VARIANCES = (0.1, 1.0, 5.0)
"""Variances of a course, as parts of the one that explains the whole gap."""

STEADY = 0.5
"""Part of the gap's energy that a steady tone explains, at least, for one that wavers."""

LEAST_PERIODS = 12
"""Periods of a tone in the recording, at least: a slower one is a drift."""

POINTS = 200
"""Points of a curve, at most."""

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

PLAYS = (0.03, 0.08, 0.16, 0.26, 0.4, 0.65)
"""Half-widths of loops, as parts of the half range: narrow to wide."""

RATE_LAGS = (1.0, 4.0, 16.0)
"""Time constants of currents that follow the rate of the field, in sampling steps."""

SCATTER_SIZES = np.geomspace(0.01, 1e8, 41)
"""Variances that are tried, in units of the noise of a channel."""

NEIGHBOURS = 5
"""Samples on either side of a spike."""

RUN = 3
"""Samples of a burst of spikes, at most: a longer one is an episode."""

MOST_SPIKES = 0.1
"""Part of the samples that are spikes, at most."""

RARE = 0.1
"""Part of the samples below which deviations are of single samples, and not of spans of noise."""

CLUSTERED = 0.25
"""Correlation of neighbouring samples' sizes from which spikes are spans of noise."""

ROUNDING = 1e-6
"""Difference of readings, as a part of their usual change, below which they are the same number."""

LATTICE = 0.02
"""Energy of a lattice, in units of the noise of all channels, from which it is told: a seventh of the noise."""

MANY = 0.01
"""Part of the samples that are held or filled in from which that is told however little it changes."""

ROUNDS = 6
"""Rounds of fitting the two states and finding the times at which each holds."""

MOST_STEPS = 3
"""Steps of a course, at most: with more it is one of episodes."""

ABSORBED = 1e-4
"""Part of a direction's information that the nominal parameters leave, below which it is theirs."""

DEPENDENT = 1e-9
"""Relative eigenvalue of the nominal parameters' information below which they are not determined: rounding."""

SAME_LAW = 0.03
"""The same for a simpler course of the same law: a switch takes its time, a channel is recorded with errors."""

SAME_COURSE = 0.85
"""Correlation of the courses of two sensors from which they are one: those of independent causes hardly reach it."""
