"""What moved is found, told as what it is, and when; chance is not taken for a change."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.correction.update import KINDS
from tam_calibration.fit.contradiction import Difference, _candidates, changes_that_explain
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori, resolve
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.posterior import Known, posterior_of
from tam_calibration.fit.prior import in_first_frame, prior_of
from tam_calibration.model.array import Array
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import from_degrees
from tam_calibration.simulation import simulate
from tam_calibration.simulation.attitude import Manoeuvre

SIZES = {"scale factor": 4e-4, "non-orthogonality": 6e-4, "bias": 2e-8, "misalignment": 1e-3}
DIRECTION = np.array([0.64, -0.6, 0.48])


@pytest.fixture(scope="module")
def array(wu_scenario):
    """Return the array with its noise."""
    return wu_scenario.array.with_stated_noise()


@pytest.fixture(scope="module")
def prior(wu_scenario, array):
    """Return a day-old calibration of the whole sphere."""
    return prior_of(maximum_likelihood(simulate(replace(wu_scenario, sample_count=2000)).recording, array), None, None)


def turn(scenario, errors, seed, count=300):
    """Return a turn by a quarter of a circle at five degrees of pitch and roll."""
    limit = from_degrees(5.0)
    motion = Manoeuvre(limit, limit, count / 10 * 4)
    begin = replace(scenario, errors=errors, motion=motion, sample_count=count, rate_hz=10.0, seed=seed)
    return simulate(begin).recording


def moved(errors, kind, sensor):
    """Return errors of which one kind of one sensor moved, in the frame of sensor 1."""
    vector, place = errors.to_vector(), 3 * KINDS.index(kind)
    vector[sensor, place : place + 3] += SIZES[kind] * DIRECTION
    return in_first_frame(SensorErrors.from_vector(vector))[0]


@pytest.mark.parametrize("sensor", [0, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_a_change_is_told_as_what_it_is(wu_scenario, array, prior, kind, sensor):
    """Kind and sensor, also of the sensor whose frame all others are told in; size within its standard errors."""
    recording = turn(wu_scenario, moved(wu_scenario.errors, kind, sensor), 5)
    resolved = resolve(recording, array, Known(prior))
    found = resolved.moved[0]
    assert (found.kind, found.sensor) == (kind, sensor + 1)
    assert len(resolved.moved) == 1 and found.since_s is None
    assert found.probability > 0.5
    assert (np.abs(found.change - SIZES[kind] * DIRECTION) < 4.5 * found.standard_errors).all()


def test_what_moved_is_learned_anew(wu_scenario, array, prior):
    """The bias is within its standard errors, and these are those of the data."""
    errors = moved(wu_scenario.errors, "bias", 1)
    resolved = resolve(turn(wu_scenario, errors, 6), array, Known(prior))
    found = maximum_a_posteriori(resolved.recording, array, resolved.known)
    assert (np.abs(found.errors.bias_T - errors.bias_T) < 4.5 * found.standard_errors[:, 6:9]).all()


def test_chance_is_no_change(wu_scenario, array, prior):
    """Of forty clean turns none contradicts, and χ² is that of its degrees of freedom."""
    squares, freedom = [], 0
    for seed in range(40):
        posterior = posterior_of(turn(wu_scenario, wu_scenario.errors, seed), array, prior)
        difference = Difference.of(prior, posterior)
        assert not changes_that_explain(difference, prior)
        squares.append(difference.chi_square)
        freedom = difference.freedom
    # The errors did not move, while the prior reckons with a day.
    assert 0.2 * freedom < np.mean(squares) < freedom


def test_chi_square_is_that_of_its_freedom(wu_scenario, array, prior):
    """Where the errors are drawn from the prior its mean is the number of directions that count."""
    generator = np.random.default_rng(8)
    squares, freedom = [], 0
    for seed in range(40):
        values, vectors = np.linalg.eigh(prior.covariance)
        step = vectors @ (np.sqrt(np.maximum(values, 0)) * generator.normal(size=48))
        errors = SensorErrors.from_vector(prior.errors.to_vector() + step.reshape(4, 12))
        difference = Difference.of(prior, posterior_of(turn(wu_scenario, errors, seed), array, prior))
        squares.append(difference.chi_square)
        freedom = difference.freedom
    assert np.mean(squares) == pytest.approx(freedom, rel=0.15)


def test_a_change_within_the_recording_has_a_time(wu_scenario, array, prior):
    """To a hundredth of the recording; the calibration is that of the samples after it."""
    before = turn(wu_scenario, wu_scenario.errors, 9, 600)
    after = turn(wu_scenario, moved(wu_scenario.errors, "bias", 3), 9, 600)
    at_s = float(before.time_s[350])
    readings = np.where((before.time_s < at_s)[:, None, None], before.readings_T, after.readings_T)
    resolved = resolve(replace(before, readings_T=readings), array, Known(prior))
    found = resolved.moved[0]
    assert (found.kind, found.sensor) == ("bias", 4)
    assert found.since_s == pytest.approx(at_s, abs=1.0)
    assert resolved.recording.time_s[0] == found.since_s


def test_which_of_two_sensors_turned_stays_open(wu_scenario):
    """Of two the one turned against the other: both are told."""
    pair = Array(wu_scenario.array.positions_m[:2], wu_scenario.array.vector_noise_T[:2], 1e-10)
    scenario = replace(wu_scenario, array=pair, errors=SensorErrors.from_vector(wu_scenario.errors.to_vector()[:2]))
    array = pair.with_stated_noise()
    prior = prior_of(maximum_likelihood(simulate(scenario).recording, array), None, None)
    recording = turn(scenario, moved(scenario.errors, "misalignment", 1), 2)
    found = resolve(recording, array, Known(prior)).moved[0]
    told = {(found.kind, found.sensor), *found.rivals}
    assert {("misalignment", 1), ("misalignment", 2)} <= told
    assert found.probability == pytest.approx(0.5, abs=0.1)


def lone(prior, evidence, kind="bias", sensor=2):
    """Return a difference that one change of a bias explains by a given evidence, known to 1 nT along x."""
    information = np.zeros((48, 48))
    place = 12 * sensor + 3 * KINDS.index(kind)
    information[place, place] = 1e18
    size = 1e18 * (10e-9) ** 2
    score = np.zeros(48)
    score[place] = np.sqrt((2 * evidence + np.log(1 + size)) * 1e18 * (1 + 1 / size))
    return Difference(score, information, 1.0, 30)


def test_evidence_is_that_of_all_changes_that_may_be(prior):
    """The mean of the likelihood over them, here by a sum; a given evidence is met."""
    difference = lone(prior, 7.0)
    change = next(each for each in _candidates(prior) if (each.kind, each.sensor) == ("bias", 2))
    assert difference.evidence(change) == pytest.approx(7.0)
    shift = np.linspace(-2e-7, 2e-7, 40_001)
    score = difference.score[30]
    chance = np.exp(-(shift**2) / 2 / (10e-9) ** 2) / np.sqrt(2 * np.pi) / 10e-9
    mean = np.sum(np.exp(score * shift - 0.5e18 * shift**2) * chance) * (shift[1] - shift[0])
    assert np.log(mean) == pytest.approx(7.0, abs=1e-6)


def test_a_change_convinces_from_ten_thousand_to_one(prior):
    """However little it is of a difference that chance explains as a whole."""
    assert changes_that_explain(lone(prior, 9.0), prior) == []
    (found,) = changes_that_explain(lone(prior, 9.4), prior)
    assert (found[0].kind, found[0].sensor) == ("bias", 2)


def test_a_difference_beyond_chance_takes_any_change_that_explains_it(prior):
    """χ² of 30 freedoms contradicts from 67.6 on: once in ten thousand."""
    for chi_square, count in ((67.0, 0), (68.0, 1)):
        assert len(changes_that_explain(replace(lone(prior, 3.0), chi_square=chi_square), prior)) == count


def test_at_most_three_changes_are_told(prior):
    """Where more moved, the whole array has."""
    parts = [lone(prior, 500.0, kind, sensor) for kind, sensor in zip(["bias"] * 4, range(4), strict=True)]
    both = Difference(
        np.sum([part.score for part in parts], axis=0), np.sum([part.information for part in parts], axis=0), 1e6, 30
    )
    assert len(changes_that_explain(both, prior)) == 3
