"""The problem of a passage: derivatives, errors of the attitude, and what is known beforehand."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tam_calibration.localization.passage import GRADIENT, UNIFORM, VELOCITY, Known, Passage, solve
from tam_calibration.model.units import from_degrees
from tam_calibration.sources.dipole import Dipole, dipole_field

from .conftest import EARTH_T, GRADIENT_T_PER_M, Course

SOURCES = (
    Dipole(np.array([27.0, 2.0, -2.8]), np.array([60.0, -90.0, 120.0])),
    Dipole(np.array([34.0, -3.0, -1.9]), np.array([-40.0, 150.0, 30.0])),
)
VELOCITY_ERROR = (0.02, -0.01, 0.005)
FREE = Known(np.zeros(11), np.full(11, np.inf))
TRUTH = np.concatenate(
    [
        *(np.concatenate([source.position_m, source.moment_Am2]) for source in SOURCES),
        EARTH_T,
        GRADIENT_T_PER_M[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]],
        VELOCITY_ERROR,
    ]
)
SIZES = np.concatenate([np.tile([1.0] * 3 + [100.0] * 3, 2), [1e-6] * 3, [1e-8] * 5, [0.1] * 3])
"""Of the unknowns, for differences."""


def passage_of(course, seed=None, known=FREE):
    """Return the passage of both sources."""
    fields, poses = course.seen(SOURCES, None if seed is None else np.random.default_rng(seed))
    array = course.array
    return Passage(
        dipole_field,
        fields,
        array,
        array.vector_noise_T,
        poses.matrix,
        poses.position_m,
        course.time_s,
        course.attitude_noise,
        known,
    )


def chi_square_of(passage, unknowns):
    """Return the sum of the squared residuals."""
    return float(np.sum((passage.data - passage.predict(unknowns)[0]) ** 2))


def differences(values, unknowns, step=1e-6):
    """Return central differences (..., P) of a function of the unknowns."""
    columns = []
    for index, size in enumerate(SIZES):
        change = np.zeros(len(unknowns))
        change[index] = step * size
        columns.append((values(unknowns + change) - values(unknowns - change)) / (2 * step * size))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("attitude_noise_deg", [0.0, 0.1])
def test_data_without_noise_are_predicted_at_the_truth(attitude_noise_deg):
    """Two sources, a regional field with a gradient, a velocity that is off, and attitudes that are true."""
    course = Course(30, 1e-9, from_degrees(attitude_noise_deg), velocity_error_m_per_s=VELOCITY_ERROR)
    passage = passage_of(course)
    assert_allclose(passage.predict(TRUTH)[0], passage.data, atol=1e-6)
    assert_allclose(passage.left_T(TRUTH), 0, atol=1e-15)
    assert len(passage.data) == 30 * (12 + (3 if attitude_noise_deg else 0))
    assert_allclose(passage.center_m(TRUTH), np.outer(course.time_s, np.array([1.0, 0, 0]) + VELOCITY_ERROR))
    assert_allclose(passage.sources(TRUTH)[1], np.concatenate([SOURCES[1].position_m, SOURCES[1].moment_Am2]))


def test_derivatives_are_those_of_differences():
    """By places and moments of both sources, the regional field, its gradient and the velocity's error."""
    passage = passage_of(Course(24, 1e-9, velocity_error_m_per_s=VELOCITY_ERROR), seed=1)
    beside = TRUTH + 0.1 * SIZES * np.random.default_rng(2).normal(size=len(TRUTH))
    slopes = passage.predict(beside)[1] * SIZES
    expected = differences(lambda unknowns: passage.predict(unknowns)[0], beside, 1e-4) * SIZES
    largest = np.abs(expected).max(axis=0)
    assert (largest > 0).all()
    assert_allclose(slopes / largest, expected / largest, atol=1e-6)


def test_the_slope_of_chi_square_is_exact_with_errors_of_the_attitude():
    """Found anew for each value, the errors leave no part of the derivative out, however large they are."""
    passage = passage_of(Course(24, 1e-9, from_degrees(0.5), velocity_error_m_per_s=VELOCITY_ERROR), seed=3)
    beside = TRUTH + 1e-3 * SIZES * np.random.default_rng(4).normal(size=len(TRUTH))
    data, slopes = passage.predict(beside)
    slope = -2 * slopes.T @ (passage.data - data) * SIZES
    expected = differences(lambda unknowns: np.array(chi_square_of(passage, unknowns)), beside, 1e-5) * SIZES
    assert_allclose(slope, expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max())


def test_errors_of_the_attitude_are_found():
    """Where the noise is small they are those that were made, about all axes: the gradient turns with the sensors."""
    course = Course(40, 1e-14, from_degrees(0.2), 100.0, VELOCITY_ERROR)
    passage = passage_of(course, seed=5)
    truth = TRUTH.copy()
    truth[12 + GRADIENT.start : 12 + GRADIENT.stop] *= 100
    turns = Rotation.from_matrix(passage.matrix).inv() * course.sway
    found = course.attitude_noise * passage.turns(truth)
    assert np.abs(turns.as_rotvec()).max() > from_degrees(0.4)
    assert_allclose(found, turns.as_rotvec(), atol=1e-6)


def test_errors_of_the_attitude_are_those_of_least_squares():
    """No other error, tried in a model of its own, makes the squares of readings and errors smaller."""
    course = Course(10, 2e-8, from_degrees(0.1), velocity_error_m_per_s=VELOCITY_ERROR)
    passage = passage_of(course, seed=6)

    def chi_square(turns):
        rotation = (
            Rotation.from_matrix(passage.matrix) * Rotation.from_rotvec(course.attitude_noise * turns)
        ).as_matrix()
        points = passage.center_m(TRUTH)[:, None] + np.einsum("nij,kj->nki", rotation, course.array.positions_m)
        world = EARTH_T + points @ GRADIENT_T_PER_M + sum(source.field_T(points) for source in SOURCES)
        left = (passage.readings_T - np.einsum("nji,nkj->nki", rotation, world)) / course.noise_T
        return np.sum(left**2, axis=(1, 2)) + np.sum(turns**2, axis=1)

    best = passage.turns(TRUTH)
    assert np.abs(best).max() > 0.5
    assert chi_square(best).sum() == pytest.approx(chi_square_of(passage, TRUTH), rel=1e-9)
    for axis in np.concatenate([np.eye(3), -np.eye(3)]):
        assert (chi_square(best + 0.01 * axis) > chi_square(best)).all()


@pytest.mark.parametrize("attitude_noise_deg", [0.1, 1.0])
def test_whitened_residuals_are_white_at_the_truth(attitude_noise_deg):
    """Of variance one, without correlation between channels and samples, whatever the errors of the attitude make.

    The χ² of the data is as large: the errors are found, even of degrees, though a field of 50 µT turns with them.
    """
    course = Course(2000, 1e-10, from_degrees(attitude_noise_deg), velocity_error_m_per_s=VELOCITY_ERROR)
    passage = passage_of(course, seed=7)
    residuals, _ = passage.whitened(TRUTH)
    assert chi_square_of(passage, TRUTH) == pytest.approx(np.sum(residuals**2), rel=0.01)
    assert residuals.shape == (2000, 12)
    assert np.mean(residuals**2) == pytest.approx(1, abs=4 * np.sqrt(2 / residuals.size))
    spread = residuals.T @ residuals / 2000
    assert_allclose(spread, np.eye(12), atol=5.5 * np.sqrt(2 / 2000))
    follows = residuals[1:].T @ residuals[:-1] / 1999
    assert_allclose(follows, 0, atol=4.5 / np.sqrt(2000))


@pytest.mark.parametrize("attitude_noise_deg", [0.0, 0.3])
def test_whitened_readings_say_of_the_unknowns_what_the_data_say(attitude_noise_deg):
    """The same χ², normal equations and right-hand side: nothing is lost, nothing is counted twice."""
    course = Course(40, 1e-9, from_degrees(attitude_noise_deg), velocity_error_m_per_s=VELOCITY_ERROR)
    passage = passage_of(course, seed=8)
    residuals, by_unknowns = passage.whitened(TRUTH)
    data, slopes = passage.predict(TRUTH)
    assert np.sum(residuals**2) == pytest.approx(chi_square_of(passage, TRUTH), rel=1e-6)
    rows, slopes = by_unknowns.reshape(-1, len(SIZES)) * SIZES, slopes * SIZES
    normal = slopes.T @ slopes
    assert_allclose(rows.T @ rows, normal, atol=1e-9 * normal.max())
    right = slopes.T @ (passage.data - data)
    assert_allclose(rows.T @ residuals.ravel(), right, atol=1e-5 * np.abs(right).max())


@pytest.mark.parametrize("attitude_noise_deg", [0.0, 0.3])
def test_fields_in_the_world_are_whitened_as_the_readings_are(attitude_noise_deg):
    """What moments make at the sensors' places has the derivatives that the whitened readings have."""
    course = Course(20, 1e-9, from_degrees(attitude_noise_deg), velocity_error_m_per_s=VELOCITY_ERROR)
    passage = passage_of(course, seed=8)
    points, weights = passage.seen(TRUTH)
    _, _, by_moment = dipole_field(points - SOURCES[0].position_m, np.zeros(3))
    expected = passage.whitened(TRUTH)[1][..., 3:6]
    assert_allclose(weights @ by_moment.reshape(20, -1, 3), expected, atol=1e-9 * np.abs(expected).max())


def test_errors_of_the_attitude_are_the_same_wherever_they_are_sought():
    """From zero, from near by, and from what is too far to begin with or is no number."""
    passage = passage_of(Course(20, 1e-9, from_degrees(0.3), velocity_error_m_per_s=VELOCITY_ERROR), seed=9)
    best = passage.turns(TRUTH)
    assert_allclose(passage.turns(TRUTH, best + 0.5), best, atol=1e-6)
    for far in (10.1, np.nan):
        assert_array_equal(passage.turns(TRUTH, np.full_like(best, far)), best)
    assert not np.array_equal(passage.turns(TRUTH, np.full_like(best, 9.9)), best)


def test_whitened_residuals_have_the_axes_of_the_world():
    """What is missing in the world stays what it is, however the array is turned."""
    course, missing = Course(30, 1e-9), np.array([3e-9, -5e-9, 8e-9])
    passage = passage_of(course)
    turned = np.einsum("nji,j->ni", passage.matrix, missing)
    passage = replace(passage, readings_T=passage.readings_T + turned[:, None])
    residuals, _ = passage.whitened(np.concatenate([TRUTH[:-3], np.zeros(3)]))
    assert_allclose(residuals.reshape(30, 4, 3), np.broadcast_to([3, -5, 8], (30, 4, 3)), atol=1e-6)


def test_what_is_exact_is_no_unknown():
    """An exact value is taken as it is, and not fitted."""
    expected, error = np.zeros(11), np.full(11, np.inf)
    expected[UNIFORM], error[UNIFORM] = EARTH_T, 0.0
    expected[VELOCITY], error[VELOCITY] = VELOCITY_ERROR, 0.0
    passage = passage_of(Course(30, 1e-9, velocity_error_m_per_s=VELOCITY_ERROR), known=Known(expected, error))
    unknowns = TRUTH[:-3][np.r_[0:12, 15:20]]
    data, slopes = passage.predict(unknowns)
    assert slopes.shape == (30 * 12, 17)
    assert_allclose(data, passage.data, atol=1e-6)
    assert_allclose(passage.further(unknowns), TRUTH[12:])
    assert_array_equal(passage.further(2 * unknowns)[UNIFORM], EARTH_T)
    assert passage.degrees_of_freedom == 30 * 12 - 5


def test_what_is_uncertain_is_an_unknown_and_a_value():
    """A departure of two standard errors costs four of χ² beside what the readings say; one that is free costs none."""
    expected, error = np.zeros(11), np.full(11, np.inf)
    expected[VELOCITY] = VELOCITY_ERROR
    error[VELOCITY] = 0.05
    course = Course(30, 1e-9, velocity_error_m_per_s=VELOCITY_ERROR)
    free, uncertain = passage_of(course, 9), passage_of(course, 9, Known(expected, error))
    assert len(uncertain.data) == len(free.data) + 3
    assert uncertain.degrees_of_freedom == free.degrees_of_freedom + 3 == 30 * 12 - 8
    assert chi_square_of(uncertain, TRUTH) == pytest.approx(chi_square_of(free, TRUTH), rel=1e-12)
    off = TRUTH + np.concatenate([np.zeros(20), [0.0, 0.1, 0.0]])
    assert chi_square_of(uncertain, off) - chi_square_of(free, off) == pytest.approx(4, rel=1e-6)
    with_prior, without = (passage.predict(TRUTH)[1] for passage in (uncertain, free))
    added = with_prior.T @ with_prior - without.T @ without
    assert_allclose(added[-3:, -3:], np.eye(3) / 0.05**2, atol=1e-3)


def test_a_value_that_only_knowledge_has_is_as_certain_as_that():
    """Readings of one sample say nothing of a velocity: it stays what is known, with its standard error."""
    expected, error = np.zeros(11), np.zeros(11)
    expected[UNIFORM], expected[GRADIENT] = EARTH_T, TRUTH[15:20]
    expected[VELOCITY], error[VELOCITY] = [0.3, 0.2, 0.1], [0.03, 0.02, 0.01]
    passage = passage_of(Course(30, 1e-9), known=Known(expected, error))
    at = slice(13, 14)
    still = replace(
        passage,
        readings_T=passage.readings_T[at],
        matrix=passage.matrix[at],
        path_m=passage.path_m[at],
        time_s=np.zeros(1),
    )
    solution = solve(still, np.concatenate([TRUTH[:12], [0.0, 0.0, 0.0]]))
    assert_allclose(still.further(solution.unknowns[0])[VELOCITY], [0.3, 0.2, 0.1], rtol=1e-2)
    slopes = still.predict(solution.unknowns[0])[1]
    assert_allclose((slopes.T @ slopes)[-3:, -3:], np.diag(np.array([0.03, 0.02, 0.01]) ** -2), rtol=1e-9)


def test_a_coarse_passage_is_a_part_with_more_noise():
    """Evenly spaced samples from the first to the last, in all that belongs to them, and no more than there are."""
    passage = passage_of(Course(100, 1e-9), seed=10)
    coarse = passage.coarse(100.0, 12)
    at = np.arange(0, 100, 9)
    for name in ("readings_T", "matrix", "path_m", "time_s"):
        assert_array_equal(getattr(coarse, name), getattr(passage, name)[at])
    assert_allclose(coarse.noise_T, 1e-7)
    assert len(passage.coarse(1.0, 1000).matrix) == 100


@pytest.mark.parametrize("attitude_noise_deg", [0.0, 0.1])
def test_the_solution_of_data_without_noise_is_the_truth(attitude_noise_deg):
    """From a start half a metre and a fifth of the moment off."""
    course = Course(60, 1e-9, from_degrees(attitude_noise_deg), velocity_error_m_per_s=VELOCITY_ERROR)
    start = TRUTH.copy()
    start[[0, 1, 8]] += 0.5
    start[3:6] *= 1.2
    start[-3:] = 0
    solution = solve(passage_of(course), start)
    assert solution.is_found[0]
    assert_allclose(solution.unknowns[0] / SIZES, TRUTH / SIZES, atol=1e-5)
    assert solution.chi_square[0] == pytest.approx(0, abs=1e-6)


def test_a_passage_without_a_source_is_solved_to_the_end():
    """The field, its gradient and the velocity's error that goes with it are exact without noise, from nothing."""
    course = Course(60, 1e-9, gradient=1000.0, velocity_error_m_per_s=VELOCITY_ERROR)
    fields, _ = course.seen([])
    passage = replace(passage_of(course), readings_T=fields)
    solution = solve(passage, np.zeros(11))
    truth = np.concatenate([EARTH_T, 1000 * GRADIENT_T_PER_M[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]], VELOCITY_ERROR])
    assert solution.is_found[0]
    assert_allclose(solution.unknowns[0] / SIZES[12:], truth / SIZES[12:], atol=1e-7)


def calls_of(monkeypatch, name):
    """Return a list that grows by one with each call of a method of ``Passage``."""
    calls, method = [], getattr(Passage, name)

    def counted(*given, **named):
        calls.append(name)
        return method(*given, **named)

    monkeypatch.setattr(Passage, name, counted)
    return calls


@pytest.mark.parametrize(("away", "steps"), [(0.9e-3, 1), (1.3e-3, 2)])
def test_a_step_to_an_error_of_the_attitude_that_is_small_is_the_last(monkeypatch, away, steps):
    """A thousandth of the error's size: what that leaves is its square."""
    passage = passage_of(Course(20, attitude_noise=from_degrees(0.1), velocity_error_m_per_s=VELOCITY_ERROR), 4)
    found = passage.turns(TRUTH)
    calls = calls_of(monkeypatch, "_step")
    passage.turns(TRUTH, found + np.array([away, 0.0, 0.0]))
    assert len(calls) == steps


@pytest.mark.parametrize(("size", "is_start"), [(9.9, True), (10.1, False)])
def test_errors_of_the_attitude_are_not_sought_far_from_zero(size, is_start):
    """Ten times their size belongs to unknowns that are far off: the search begins at zero."""
    passage = passage_of(Course(20, attitude_noise=from_degrees(0.1), velocity_error_m_per_s=VELOCITY_ERROR), 4)
    near = np.zeros((20, 3))
    near[3] = size
    assert np.array_equal(passage.turns(TRUTH, near), passage.turns(TRUTH)) != is_start


def test_a_fit_that_stalls_ends_where_it_may(monkeypatch):
    """Ten steps in a row that hardly lower χ² are the last; without that it goes on."""
    passage = passage_of(Course(20, velocity_error_m_per_s=VELOCITY_ERROR), 4)
    calls = calls_of(monkeypatch, "predict")
    solve(passage, TRUTH, smallest_step=0.0, least_fall=0.9)
    assert len(calls) == 11
    solve(passage, TRUTH, smallest_step=0.0)
    assert len(calls) > 11 + 20
