"""A change over which lengths bend is told as what it is, from some of the samples."""

from dataclasses import replace

import numpy as np
import pytest
from moved_sensors import turn

from tam_calibration.fit import prior_changes as module
from tam_calibration.fit.contradiction import candidates_of, changes_of_sensors
from tam_calibration.fit.prior import in_first_frame
from tam_calibration.fit.prior_changes import large_change
from tam_calibration.fit.problem import Known
from tam_calibration.model.sensor_errors import SensorErrors

INTENSITY_T = 50e-6


@pytest.fixture(scope="module")
def known(prior):
    """Return what is known: a day-old calibration of the whole sphere."""
    return Known(prior)


def changed(errors, hypothesis, size_T, seed):
    """Return errors that a hypothesis has changed by a random draw of a size."""
    unknowns = hypothesis.directions.shape[1]
    is_bias = hypothesis.directions.reshape(-1, 12, unknowns)[:, 6:9].any(axis=(0, 1))
    draw = np.random.default_rng(seed).normal(size=unknowns) * np.where(is_bias, size_T, size_T / INTENSITY_T)
    vector = errors.to_vector() + (hypothesis.directions @ draw).reshape(-1, 12)
    return in_first_frame(SensorErrors.from_vector(vector))[0]


@pytest.mark.parametrize(("size_T", "first"), [(1e-7, 10), (3e-6, 0)])
def test_a_change_is_told_as_what_it_is(wu_scenario, known, size_T, first):
    """Of one kind, of a whole sensor, 1 and another, of all biases, of the scale: at a tilt of twenty degrees."""
    array, candidates = wu_scenario.array.with_stated_noise(), candidates_of(known.prior, True)
    told, made = [], changes_of_sensors(wu_scenario.errors)
    made = made[first : first + 5] + made[-2:]
    for seed, hypothesis in enumerate(made):
        errors = changed(wu_scenario.errors, hypothesis, size_T, seed)
        recording = turn(wu_scenario, errors, seed, limit_deg=20.0)
        told.append(large_change(recording, array, known, candidates)[0].hypothesis.name)
    assert told == [hypothesis.name for hypothesis in made]


def test_what_no_sensors_can_be_is_none(wu_scenario, known):
    """Readings of zeros: no change leads there."""
    recording = turn(wu_scenario, wu_scenario.errors, 3)
    spoilt = replace(recording, readings_T=np.zeros_like(recording.readings_T))
    candidates = candidates_of(known.prior, True)[:3]
    assert large_change(spoilt, wu_scenario.array.with_stated_noise(), known, candidates) == []


def test_energy_counts_as_twice_the_logarithm_of_the_probability(wu_scenario, known, monkeypatch):
    """Of four that one leaves more than another its probability is less by e²."""
    recording, array = turn(wu_scenario, wu_scenario.errors, 3), wu_scenario.array.with_stated_noise()

    def odds(*energies):
        left = iter(energies)
        monkeypatch.setattr(module, "sample_energies", lambda *_: np.array([next(left)]))
        two = large_change(recording, array, known, candidates_of(known.prior, True)[:2])
        probability = {change.hypothesis.name: change.probability for change in two}
        return probability["scale factor of sensor 1"] / probability["non-orthogonality of sensor 1"]

    assert odds(0.0, 4.0) / odds(0.0, 0.0) == pytest.approx(np.exp(2.0))
