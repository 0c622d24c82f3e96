"""Random functions of time: smooth wandering, weather, an electric load."""

from collections.abc import Callable

import numpy as np
from numpy.random import Generator
from scipy.interpolate import PchipInterpolator

from tam_calibration.model.units import FloatArray

TimeFunction = Callable[[FloatArray], FloatArray]


def draw_wander(rng: Generator, duration_s: float, knots: int) -> TimeFunction:
    """Draw a smooth path through random knots, of mean zero and standard deviation one over the recording."""
    time_s = np.linspace(-0.1 * duration_s, 1.1 * duration_s, knots + 2)
    path = PchipInterpolator(time_s, np.cumsum(rng.normal(size=knots + 2)))
    inside = path(np.linspace(0, duration_s, 1000))
    return lambda at_s: np.asarray((path(np.clip(at_s, time_s[0], time_s[-1])) - inside.mean()) / inside.std())


def draw_weather(rng: Generator, duration_s: float) -> TimeFunction:
    """Draw the temperature about an array: it warms up, cools down, and the sun comes and goes."""
    mean_C, span_C = rng.uniform(5, 30), rng.uniform(6, 25)
    knots = int(rng.integers(7, 13))
    time_s = np.linspace(-0.2 * duration_s, 1.2 * duration_s, knots)
    swings = np.where(np.arange(knots) % 2 == 0, 1, -1) * rng.uniform(0.2, 1, knots)
    path = PchipInterpolator(time_s, swings + rng.uniform(-1.5, 1.5) * time_s / duration_s)
    return lambda at_s: np.asarray(mean_C + span_C / 2 * path(np.clip(at_s, time_s[0], time_s[-1])))


def draw_load(rng: Generator, duration_s: float) -> TimeFunction:
    """Draw the current of a load that is switched between levels and follows each within a moment."""
    switches = int(rng.integers(9, 30))
    cuts_s = np.sort(rng.uniform(0, duration_s, switches))
    levels_A = rng.choice(rng.uniform(0, 12, 5), switches + 1) + rng.uniform(0, 0.5, switches + 1)
    follow_s = duration_s * rng.uniform(0.001, 0.01)

    def current(at_s: FloatArray) -> FloatArray:
        last = np.searchsorted(cuts_s, at_s, side="right")
        since_s = at_s - np.concatenate([[-np.inf], cuts_s])[last]
        before_A = levels_A[np.maximum(last - 1, 0)]
        return np.asarray(levels_A[last] + (before_A - levels_A[last]) * np.exp(-since_s / follow_s))

    return current
