"""Commands that are ended at any moment of their work."""

import signal
from pathlib import Path

from numpy.random import Generator

from battery.recipes import Recipe
from battery.surroundings import Surroundings
from battery.trial import May, Trial, pick

_SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)

_FRESH = 0.25
"""Part of the kills that meet an interpreter which still imports."""


def end_at_any_moment(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Send a signal at a moment from just after the beginning to just after the end."""
    number, moment, fresh = pick(rng, _SIGNALS), float(rng.uniform(0.0, 1.05)), bool(rng.random() < _FRESH)
    around = Surroundings(fresh=fresh, ended_by=number, moment=moment)
    told = "of a fresh interpreter, " if fresh else ""
    return Trial.of(recipe, f"{told}{number.name} after {moment:.2f} of its time", May.DO_THE_SAME, around)
