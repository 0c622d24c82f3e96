"""A day-old calibration, and narrow turns of an array of which something has moved since."""

from dataclasses import replace

import numpy as np

from tam_calibration.correction.parts import KINDS
from tam_calibration.fit.contradiction import Difference
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.prior import in_first_frame, prior_of
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import from_degrees
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import Manoeuvre

SIZES = {"scale factor": 4e-4, "non-orthogonality": 6e-4, "bias": 2e-8, "misalignment": 1e-3}
"""Twenty nanotesla, or as much of the field."""

DIRECTION = np.array([0.64, -0.6, 0.48])


def day_old(scenario):
    """Return the calibration of the whole sphere, a day later."""
    recording = simulate(replace(scenario, sample_count=2000)).recording
    return prior_of(maximum_likelihood(recording, scenario.array.with_stated_noise()), None, None)


def turn(scenario, errors, seed, count=300, limit_deg=5.0):
    """Return a turn by a quarter of a circle within a limit of pitch and roll."""
    limit = from_degrees(limit_deg)
    motion = Manoeuvre(limit, limit, count / 10 * 4)
    begin = replace(scenario, errors=errors, motion=motion, sample_count=count, rate_hz=10.0, seed=seed)
    return simulate(begin).recording


def moved(errors, kind, sensor, times=1.0):
    """Return errors of which one kind of one sensor moved, in the frame of sensor 1."""
    vector, place = errors.to_vector(), 3 * KINDS.index(kind)
    vector[sensor, place : place + 3] += times * SIZES[kind] * DIRECTION
    return in_first_frame(SensorErrors.from_vector(vector))[0]


def joined(before, after, first):
    """Return a recording whose readings are those of another of the same turn from a sample on."""
    readings = before.readings_T.copy()
    readings[first:] = after.readings_T[first:]
    return replace(before, readings_T=readings)


def lone(prior, evidence, kind="bias", sensor=2):
    """Return a difference that one change of a bias explains by a given evidence, known to 1 nT along x."""
    information = np.zeros((48, 48))
    place = 12 * sensor + 3 * KINDS.index(kind)
    information[place, place] = 1e18
    size = 1e18 * (10e-9) ** 2
    score = np.zeros(48)
    score[place] = np.sqrt((2 * evidence + np.log(1 + size)) * 1e18 * (1 + 1 / size))
    return Difference(score, information, 1.0, 30)
