"""The likelihood ratios of changes: their distribution without a change, the size that they find, and the words."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.fit.contradiction import Hypothesis
from tam_calibration.live.change import CLEAR_RATIO, Before, Evidence, Weighing, hypotheses
from tam_calibration.model.array import Array


@pytest.fixture(scope="module")
def samples():
    """Return an information of samples (48, 48), and a covariance of the errors before them that is of its size."""
    generator = np.random.default_rng(1)
    rows = generator.normal(size=(200, 48))
    mixing = generator.normal(size=(48, 48)) / 40
    return rows.T @ rows, mixing @ mixing.T


def bias_of_sensor_2(true_errors, cross):
    """Return the weighing of this one hypothesis, which is never taken for chance."""
    [bias] = [each for each in hypotheses(true_errors, cross) if each.name == "bias of sensor 2"]
    return Weighing([bias], 1 - 1e-12)


def gradient_of(information, covariance, change, generator):
    """Return the gradient of samples at errors that are a draw off the truth, after a change."""
    off = np.linalg.cholesky(covariance + 1e-12 * np.eye(48)) @ generator.normal(size=48)
    return information @ (off + change) + np.linalg.cholesky(information) @ generator.normal(size=48)


def test_without_a_change_the_ratio_is_chi_square(true_errors, cross, samples):
    """Of three degrees of freedom, whatever is uncertain before: its mean is 3, its variance 6."""
    information, covariance = samples
    generator, weighing = np.random.default_rng(2), bias_of_sensor_2(true_errors, cross)
    ratios = []
    for _ in range(800):
        gradient = gradient_of(information, covariance, 0.0, generator)
        [evidence] = weighing.weigh(information, gradient, Before(covariance, 200, 1.0))
        ratios.append(evidence.ratio)
    assert np.mean(ratios) == pytest.approx(3, abs=4 * np.sqrt(6 / 800))
    assert np.var(ratios) == pytest.approx(6, rel=0.4)


def test_a_change_is_found_with_its_standard_errors(true_errors, cross, samples):
    """The normalised error of its size has unit variance; an excess of the noise lowers the ratio and widens it."""
    information, covariance = samples
    generator, weighing = np.random.default_rng(3), bias_of_sensor_2(true_errors, cross)
    change = np.zeros(48)
    change[18:21] = 1.0, -2.0, 3.0
    squares = []
    for _ in range(200):
        gradient = gradient_of(information, covariance, change, generator)
        [evidence] = weighing.weigh(information, gradient, Before(covariance, 200, 1.0))
        error = evidence.size - change[18:21]
        squares.append(error @ np.linalg.solve(evidence.covariance, error))
    assert np.mean(squares) == pytest.approx(3, abs=4 * np.sqrt(6 / 200))
    [doubtful] = weighing.weigh(information, gradient, Before(covariance, 200, 4.0))
    assert doubtful.ratio == pytest.approx(evidence.ratio / 4)
    assert_allclose(doubtful.covariance, 4 * evidence.covariance)


def test_what_is_alike_is_not_ruled_out(true_errors, cross, samples):
    """Two hypotheses of the same directions stay both, one that explains clearly less does not."""
    information, covariance = samples
    bias = next(each for each in hypotheses(true_errors, cross) if each.name == "bias of sensor 2")
    other = next(each for each in hypotheses(true_errors, cross) if each.name == "bias of sensor 4")
    change = np.zeros(48)
    change[18:21] = 3.0
    gradient = gradient_of(information, covariance, change, np.random.default_rng(4))
    found = Weighing([other, bias, bias], 1e-6).weigh(information, gradient, Before(covariance, 200, 1.0))
    assert [each.hypothesis.name for each in found] == ["bias of sensor 2", "bias of sensor 2"]
    assert found[0].score - found[1].score < CLEAR_RATIO
    assert Weighing([bias], 1e-6).weigh(information, np.zeros(48), Before(covariance, 200, 1.0)) == ()


def test_one_sensor_has_neither_misalignment_nor_neighbours(true_errors):
    """Its frame is the array's: what may change are scale factors, angles between axes, bias, and all of these."""
    single = Array([[0.0, 0, 0]], vector_noise_T=[1e-9])
    names = [each.parameters for each in hypotheses(type(true_errors).none(1), single)]
    assert names == ["scale factor", "non-orthogonality", "bias", "several errors"]


@pytest.mark.parametrize(
    ("kind", "unit", "size", "told"),
    [
        ("bias", "T", 2e-9, "bias of sensor 2 by y +2 ± 0.1 nT"),
        ("scale factor", "1", 2e-6, "scale factor of sensor 2 by y +2 ± 0.1 ppm"),
        ("misalignment", "rad", -np.radians(0.02), "misalignment of sensor 2 by y -0.02 ± 0.001°"),
    ],
)
def test_a_change_is_told_in_the_units_of_people(kind, unit, size, told):
    """The components that are larger than three standard errors, in nT, ppm or degrees."""
    hypothesis = Hypothesis(f"{kind} of sensor 2", kind, 2, np.eye(3), ("x", "y", "z"), unit)
    deviation = abs(size) / 20
    evidence = Evidence(hypothesis, np.array([deviation, size, 0.0]), deviation**2 * np.eye(3), 400.0, 390.0)
    assert evidence.sentence == told
