"""Targets along a survey line: several dipoles beside a swaying path, and errors of navigation and attitude.

Several lines show one list: an object that several see is one target, as certain as its sightings agree.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.linalg import norm
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation, RotationSpline

from tam_calibration.localization.line_data import line_data
from tam_calibration.localization.line_window import Window
from tam_calibration.localization.target_search import LEAST_GAIN, evidence_of, fit_from, remove_weak
from tam_calibration.localization.targets import Target, find_targets, merged, path_in
from tam_calibration.localization.window_fit import likeliest_roughness
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import Recording
from tam_calibration.sources.dipole import dipole_field

EARTH_T = np.array([1.2e-6, 20.5e-6, -44e-6])
TIME_S = np.arange(300) / 5
PLACES_M = np.array([[15.0, 2.0, -4.0], [35.0, -3.0, -6.0], [48.0, 1.0, -5.0]])
MOMENTS_AM2 = np.array([[30.0, 80.0, -60.0], [-100.0, 150.0, 90.0], [40.0, 10.0, -90.0]])


def passed(
    array,
    errors,
    places=PLACES_M,
    moments=MOMENTS_AM2,
    *,
    sway=0.2,
    white=0.0,
    attitude=0.0,
    lasting=1.0,
    gyroscope=False,
):
    """Return the recording of a line past dipoles, 0.1 nT of noise."""
    generator = np.random.default_rng(7)
    path = np.column_stack([TIME_S, sway * np.sin(TIME_S), sway * np.cos(0.7 * TIME_S)])
    turns = Rotation.from_euler("zyx", 0.08 * np.sin(np.outer(TIME_S, [0.9, 0.7, 1.1])))
    points = path[:, None] + np.einsum("nij,kj->nki", turns.as_matrix(), array.positions_m)
    world = EARTH_T + sum(
        dipole_field(points - place, moment)[0] for place, moment in zip(places, moments, strict=True)
    )
    fields = np.einsum("nji,nkj->nki", turns.as_matrix(), world)
    error, drawn = np.zeros((300, 3)), generator.standard_normal((300, 3))
    keep = np.exp(-0.2 / lasting)
    for number in range(1, 300):
        error[number] = keep * error[number - 1] + np.sqrt(1 - keep**2) * drawn[number]
    reported = turns * Rotation.from_rotvec(np.radians(attitude) * error)
    position = path + white * generator.standard_normal(path.shape)
    noisy = fields + 1e-10 * generator.standard_normal(fields.shape)
    rates = RotationSpline(TIME_S, turns)(TIME_S, 1) + np.radians([0.5, -0.3, 0.2])
    measured = rates + np.radians(0.02) * generator.standard_normal(rates.shape)
    return Recording(
        TIME_S,
        errors.distort(noisy),
        attitude=reported.as_quat(),
        angular_velocity_rad_s=measured if gyroscope else None,
        position_m=position,
    )


@pytest.fixture(scope="module")
def exact(recording, cross, true_errors):
    """Return the calibration of the array with its true errors."""
    from tam_calibration.fit import calibrate

    return replace(calibrate(recording, cross), errors=true_errors, covariance=np.zeros((48, 48)))


@pytest.fixture(scope="module")
def line(cross, true_errors, exact):
    """Return what is found along a line whose path and attitude are exact."""
    recording = passed(cross, true_errors)
    return find_targets(recording, exact, path_in(recording))


def assert_found(targets, places=PLACES_M):
    """Check that each target is at a place of its own within five standard errors, which are below half a metre."""
    assert len(targets) == len(places) and not any(each.is_extended for each in targets)
    for each in targets:
        away = places - each.position_m
        assert (np.abs(away[np.argmin(norm(away, axis=1))]) < 5 * each.standard_errors_m).all()
        assert norm(each.standard_errors_m) < 0.5


def test_all_targets_of_a_line_are_found(line):
    """Three dipoles beside a swaying path; the surest stands first."""
    assert_found(line.targets)
    assert [each.evidence for each in line.targets] == sorted((each.evidence for each in line.targets), reverse=True)


def test_targets_are_found_whatever_navigation_and_attitude_err_by(cross, true_errors, exact):
    """Both err, and the standard errors hold that."""
    recording = passed(cross, true_errors, PLACES_M[:2], MOMENTS_AM2[:2], white=0.1, attitude=0.1, lasting=5.0)
    assert_found(find_targets(recording, exact, path_in(recording)).targets, PLACES_M[:2])


def test_a_gyroscope_makes_up_for_a_poor_attitude(cross, true_errors, exact):
    """An attitude that errs by 1.5° for five seconds: the target is found where the angular velocity was recorded."""
    recording = passed(cross, true_errors, PLACES_M[1:2], MOMENTS_AM2[1:2], attitude=1.5, lasting=5.0, gyroscope=True)
    line = find_targets(recording, exact, path_in(recording), np.radians(1.5))
    assert "with the angular velocity" in line.note
    assert_found(line.targets, PLACES_M[1:2])


def test_a_line_past_nothing_has_no_target(cross, true_errors, exact):
    """Noise, and an attitude that errs for seconds, are no target."""
    recording = passed(cross, true_errors, PLACES_M[:1], 1e-9 * MOMENTS_AM2[:1], attitude=0.2, lasting=5.0)
    assert find_targets(recording, exact, path_in(recording)).targets == []


def test_a_swaying_path_without_navigation_is_found_by_its_velocity(cross, true_errors, exact):
    """A velocity is true but for a random walk: the straight track does not hold, and no phantom appears."""
    recording = passed(cross, true_errors, PLACES_M[:1], MOMENTS_AM2[:1], sway=0.05)
    path = path_in(recording, np.array([1.0, 0, 0]), 0.01)
    targets = find_targets(recording, exact, path).targets
    assert len(targets) == 1
    start_m = np.array([0.0, 0.0, 0.05])
    assert (np.abs(targets[0].position_m - PLACES_M[0] + start_m) < 5 * targets[0].standard_errors_m).all()


def test_a_velocity_that_is_off_stays_within_the_errors(cross, true_errors, exact):
    """3 % of the speed, with the standard error of a tenth that is taken where none is stated."""
    recording = passed(cross, true_errors, PLACES_M[:1], MOMENTS_AM2[:1], sway=0.0)
    [target] = find_targets(recording, exact, path_in(recording, np.array([0.97, 0, 0]))).targets
    assert (np.abs(target.position_m - PLACES_M[0]) < 5 * target.standard_errors_m).all()


def test_a_line_that_no_dipoles_explain_is_refused(cross, true_errors, exact):
    """A hum of 20 nT on one sensor is all along the line."""
    recording = passed(cross, true_errors, PLACES_M[:1], MOMENTS_AM2[:1]).take(slice(150))
    readings = recording.readings_T.copy()
    readings[:, 1, 0] += 20e-9 * np.sin(2 * np.pi * 0.7 * recording.time_s)
    humming = replace(recording, readings_T=readings)
    with pytest.raises(Refused, match="--method integrated"):
        find_targets(humming, exact, path_in(humming))


def test_what_is_left_along_a_line_is_near_one(line):
    """Where the targets explain the readings; the gradient is largest near the strongest."""
    assert 0.7 < np.sqrt(np.mean(line.left**2)) < 1.3
    nearest = line.center_m[np.argmax(line.contraction_T_per_m)]
    assert min(norm(nearest - place) for place in PLACES_M) < 6.0


def window_of(recording, array, errors):
    """Return a line as one window."""
    fields, none = errors.restore(recording.readings_T), np.zeros((300, 12, 0))
    data = line_data(recording.time_s, fields, recording.attitude, array, recording.time_s, 1e-3, none)
    return Window(data, path_in(recording), np.zeros((0, 6)))


def test_evidence_is_what_a_fit_without_the_dipole_leaves(cross, true_errors):
    """Also where its depth is uncertain, and so its moment: the rise of χ² is by the field that it makes."""
    moments = MOMENTS_AM2 * [[1.0], [1.0], [0.05]]
    window = window_of(passed(cross, true_errors, PLACES_M, moments, white=0.1), cross, true_errors)
    unknowns = np.column_stack([PLACES_M, moments])
    solved = fit_from(window, np.concatenate([unknowns.ravel(), window.start()]))
    fewer = fit_from(window, np.concatenate([unknowns[:2].ravel(), solved.others]))
    assert evidence_of(solved)[2] == pytest.approx(fewer.chi_square - solved.chi_square, rel=0.3)


def test_two_dipoles_that_stand_for_one_are_made_one(cross, true_errors):
    """A dipole that was found in steps, each with a part of its moment, is one where one explains as much."""
    window = window_of(passed(cross, true_errors, PLACES_M[:1], MOMENTS_AM2[:1]), cross, true_errors)
    pair = np.column_stack([PLACES_M[[0, 0]] + [[0.1, 0, 0], [-0.2, 0, 0]], MOMENTS_AM2[[0, 0]] * [[0.7], [0.3]]])
    solved = fit_from(window, np.concatenate([pair.ravel(), window.start()]))
    one = remove_weak(solved, 0)
    assert len(one.sources) == 1 and one.chi_square < solved.chi_square + LEAST_GAIN
    assert norm(one.sources[0, :3] - PLACES_M[0]) < 0.05


def test_targets_close_together_are_each_listed_once(cross, true_errors, exact):
    """Three within 14 m, which windows that overlap all see."""
    places = np.array([[18.0, 2.0, -4.0], [25.0, -4.0, -5.0], [32.0, 3.0, -6.0]])
    recording = passed(cross, true_errors, places, white=0.05).take(slice(225))
    targets = find_targets(recording, exact, path_in(recording)).targets
    assert sorted(norm(places - each.position_m, axis=1).argmin() for each in targets) == [0, 1, 2]
    assert not any(each.is_extended for each in targets)


def test_a_smooth_regional_field_is_known_for_smooth(cross, true_errors):
    """So that it does not take the field of a deep target for its own; one that bends stays rough."""
    recording = passed(cross, true_errors, PLACES_M[:1], MOMENTS_AM2[:1])
    bend = 40e-9 * np.sin(TIME_S / 8)[:, None] * EARTH_T / norm(EARTH_T)
    turned = Rotation.from_quat(recording.attitude).inv().apply(bend)
    fields = true_errors.restore(recording.readings_T) + turned[:, None]
    rough = replace(recording, readings_T=true_errors.distort(fields))
    found = []
    for each in (recording, rough):
        window = window_of(each, cross, true_errors)
        start = np.concatenate([PLACES_M[0], MOMENTS_AM2[0], window.start()])
        found.append(likeliest_roughness(fit_from(window, start)))
    assert found[0] < 0.3 and found[1] == 1.0


def test_derivatives_are_those_of_the_residuals(cross, true_errors):
    """To a thousandth, where data see the unknown: beside a strong dipole, larger errors of them stop a fit early."""
    window = window_of(passed(cross, true_errors, white=0.1, attitude=0.1), cross, true_errors)
    unknowns = np.concatenate([np.column_stack([PLACES_M, MOMENTS_AM2]).ravel(), window.start()])
    unknowns[18 : 18 + window.unit_count] = 0.5
    slopes = window.linearized(unknowns)[1]
    sizes = norm(slopes, axis=(0, 1))
    for number in np.flatnonzero(sizes > 3.0)[::2]:
        step = np.zeros(len(unknowns))
        step[number] = 0.1 / sizes[number]
        sides = [window.linearized(unknowns + sign * step, with_slopes=False)[0] for sign in (-1, 1)]
        found = (sides[0] - sides[1]) / (2 * step[number])
        assert norm(found - slopes[..., number]) < 1e-3 * sizes[number]


def test_a_dipole_without_a_field_holds_up_no_other(cross, true_errors):
    """It moves as it likes, and the fit of the others still ends where the noise does."""
    window = window_of(passed(cross, true_errors), cross, true_errors)
    far = np.array([30.0, 60.0, 40.0, 20.0, -10.0, 5.0])
    known = np.column_stack([PLACES_M + 0.3, MOMENTS_AM2 * 0.9]).ravel()
    solved = fit_from(window, np.concatenate([known, far, window.start()]))
    assert np.mean(solved.residual**2) == pytest.approx(1.0, abs=0.1)
    assert norm(solved.sources[:3, :3] - PLACES_M, axis=1).max() < 0.05


SPREAD = np.diag([0.04, 0.01, 0.09])


def target(place, evidence=100.0, spread=SPREAD, distance=6.0):
    """Return a dipole at a place."""
    place, moment = np.asarray(place, dtype=float), np.array([0.0, 30.0, -40.0])
    field = np.array([0.0, 2e-5, -4.5e-5])
    return Target(place, spread, moment, np.eye(3), evidence, distance, 0.0, False, 1.0, field)


def test_sightings_of_one_object_are_averaged_by_their_precision():
    """Twice as precise as one where they agree; lines are counted and the evidence is added."""
    [found] = merged([[target([10, 1, -5])], [target([10.2, 1, -5], 50.0)]])
    assert_allclose(found.position_m, [10.1, 1, -5])
    assert_allclose(found.position_covariance_m2, SPREAD / 2)
    assert (found.lines, found.evidence) == (2, 150.0)
    assert found.repeat_m == pytest.approx(0.1)


def test_sightings_that_disagree_widen_the_covariance():
    """By the mean square of their differences over their standard errors (Birge)."""
    places = ([10.0, 1, -5], [10.8, 1, -5])
    [found] = merged([[target(each)] for each in places])
    assert_allclose(found.position_covariance_m2, SPREAD / 2 * (0.8**2 / 0.04 / 2 / 3))


def test_objects_that_are_apart_stay_two():
    """Five metres at standard errors of decimetres, on one line and on two; and two of one line are never one."""
    near, far = target([10, 1, -5]), target([15, 1, -5], 80.0)
    assert len(merged([[near], [far]])) == len(merged([[near, far]])) == 2
    assert len(merged([[near, replace(near, evidence=60.0)]])) == 2


def test_one_line_stays_as_it_is():
    """No repeat, and the strongest first."""
    weak, strong = target([10, 1, -5], 50.0), target([50, 1, -5], 90.0)
    assert merged([[weak, strong]]) == [strong, weak]
    assert np.isnan(strong.repeat_m) and merged([]) == []


def test_the_part_along_the_field_and_the_sphere_of_iron():
    """Projection on the field; a sphere of radius a in the field B has the moment 4π a³ B/µ0."""
    found = target([10, 1, -5])
    size = np.hypot(2e-5, 4.5e-5)
    assert found.along_field_Am2 == pytest.approx((30 * 2e-5 + 40 * 4.5e-5) / size)
    assert 0.5 * found.sphere_diameter_m == pytest.approx((50 * 1e-7 / size) ** (1 / 3))
