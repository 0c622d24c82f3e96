"""What moved is found, told as what it is, and when; chance is not taken for a change."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from moved_sensors import lone, turn
from numpy.testing import assert_allclose

from tam_calibration.core.least_squares import Normal
from tam_calibration.fit.contradiction import Difference, MotionFit, candidates_of, changes_that_explain
from tam_calibration.fit.problem import Known, posterior_of
from tam_calibration.model.sensor_errors import SensorErrors


def test_chance_is_no_change(wu_scenario, array, prior):
    """Of twenty clean turns none contradicts, and χ² is that of its degrees of freedom."""
    squares, freedom = [], 0
    for seed in range(20):
        posterior = posterior_of(turn(wu_scenario, wu_scenario.errors, seed), array, Known(prior))
        difference = Difference.of(prior, posterior)
        assert not changes_that_explain(difference, candidates_of(prior, True))
        squares.append(difference.chi_square)
        freedom = difference.freedom
    # The errors did not move, while the prior reckons with a day.
    assert 0.2 * freedom < np.mean(squares) < freedom


def test_chi_square_is_that_of_its_freedom(wu_scenario, array, prior):
    """Where the errors are drawn from the prior its mean is the number of directions that count."""
    generator = np.random.default_rng(8)
    squares, freedom = [], 0
    for seed in range(25):
        values, vectors = np.linalg.eigh(prior.covariance)
        step = vectors @ (np.sqrt(np.maximum(values, 0)) * generator.normal(size=48))
        errors = SensorErrors.from_vector(prior.errors.to_vector() + step.reshape(4, 12))
        difference = Difference.of(prior, posterior_of(turn(wu_scenario, errors, seed), array, Known(prior)))
        squares.append(difference.chi_square)
        freedom = difference.freedom
    assert np.mean(squares) == pytest.approx(freedom, rel=0.15)


def test_evidence_is_that_of_all_changes_that_may_be(prior):
    """The mean of the likelihood over them, here by a sum; a given evidence is met."""
    difference = lone(prior, 7.0)
    [change] = [sizes[0] for sizes in candidates_of(prior, True) if sizes[0].hypothesis.name == "bias of sensor 3"]
    assert difference.evidence(change) == pytest.approx(7.0)
    shift = np.linspace(-2e-7, 2e-7, 40_001)
    score = difference.score[30]
    chance = np.exp(-(shift**2) / 2 / (10e-9) ** 2) / np.sqrt(2 * np.pi) / 10e-9
    mean = np.sum(np.exp(score * shift - 0.5e18 * shift**2) * chance) * (shift[1] - shift[0])
    assert np.log(mean) == pytest.approx(7.0, abs=1e-6)


def test_a_change_convinces_from_ten_thousand_to_one(prior):
    """However little it is of a difference that chance explains as a whole."""
    assert changes_that_explain(lone(prior, 9.0), candidates_of(prior, True)) == []
    (found,) = changes_that_explain(lone(prior, 9.4), candidates_of(prior, True))
    assert [change.hypothesis.name for change in found] == ["bias of sensor 3"]


def test_a_difference_beyond_chance_takes_any_change_that_explains_it(prior):
    """χ² of 30 freedoms contradicts from 67.6 on: once in ten thousand."""
    for chi_square, count in ((67.0, 0), (68.0, 1)):
        assert (
            len(changes_that_explain(replace(lone(prior, 3.0), chi_square=chi_square), candidates_of(prior, True)))
            == count
        )


def test_at_most_three_changes_are_told(prior):
    """Where more moved, the whole array has."""
    parts = [lone(prior, 500.0, kind, sensor) for kind, sensor in zip(["bias"] * 4, range(4), strict=True)]
    both = Difference(
        np.sum([part.score for part in parts], axis=0), np.sum([part.information for part in parts], axis=0), 1e6, 30
    )
    assert len(changes_that_explain(both, candidates_of(prior, True))) == 3


def test_of_what_explains_as_much_the_least_is_told(prior):
    """All errors of a sensor, or all biases, are a hundred times less likely, all errors of all ten thousand times."""
    ((found,),) = changes_that_explain(lone(prior, 20.0), candidates_of(prior, True))
    assert found.hypothesis.name == "bias of sensor 3"
    assert found.probability == pytest.approx(1 / (1 + 2e-2 + 1e-4), rel=1e-6)


def test_what_may_happen_to_a_sensor_is_of_any_size(prior):
    """From 10 nT to 10 µT by half powers of ten, as much of the field for scale factors and angles."""
    sizes_T = np.array([10, 31.62278, 100, 316.2278, 1000, 3162.278, 10_000]) * 1e-9
    intensity_T = prior.calibration.intensity_T
    told = {sizes[0].hypothesis.name: sizes for sizes in candidates_of(prior, True)}
    for name, unit in (("biases of all sensors", 1), ("misalignment of sensor 2", 1 / intensity_T)):
        assert_allclose([np.sqrt(change.variance[0]) for change in told[name]], sizes_T * unit, rtol=1e-6)


def test_rounding_lasts_for_no_time():
    """An unknown of which attitude tells nothing has rounding for its information and score: it counts for nothing."""
    scores = np.stack([np.random.default_rng(3).normal(size=1600), np.linspace(-1e-6, 1e-6, 1600)], axis=1)

    def of(samples=slice(0, 1600)):
        own = scores[samples]
        return Normal(len(own) * np.diag([1.0, 1e-16]), own.sum(axis=0), 0.0, len(own))

    problem = SimpleNamespace(
        motion=SimpleNamespace(sample_count=1600),
        motion_at=lambda place, samples=slice(0, 1600): of(samples),
        normal_at=lambda place: of() + Normal(np.diag([0.0, 1600.0]), np.zeros(2), 0.0, 1600),
        basis_at=lambda place: np.eye(2),
    )
    assert MotionFit(problem, None).lasting() == 1.0
    assert MotionFit(problem, None).lasting(np.eye(2)[:, 1:]) > 100
