"""How many dipoles a passage shows, and when it shows none."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.localization import passage, track_fit
from tam_calibration.localization.passage import Known
from tam_calibration.localization.steady import track_dipole
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import from_degrees
from tam_calibration.sources.dipole import Dipole, dipole_field

from .conftest import Course

WRECK = Dipole(np.array([30.0, 2.6, -2.5]), np.array([48.5, -80.8, 129.3]))
BESIDE = Dipole(np.array([38.0, -1.5, -3.0]), np.array([100.0, 60.0, -80.0]))
BEFORE = Dipole(np.array([20.0, 2.5, -2.0]), np.array([-100.0, 160.0, -80.0]))
BELOW = Dipole(np.array([30.2, -0.05, -4.53]), np.array([-68.2, -104.5, -136.0]))
FIRST = Dipole(np.array([10.0, -2.5, -2.0]), np.array([100.0, -100.0, 80.0]))
ABOVE = Dipole(np.array([29.4, -2.0, -1.8]), np.array([-24.9, 24.5, -17.0]))
STRONG = Dipole(np.array([29.2, -2.1, -2.4]), np.array([-303.7, 296.7, -188.4]))
LAST = Dipole(np.array([48.0, -2.5, -2.0]), np.array([100.0, 100.0, -80.0]))


def tracked(course, sources, seed=1, bend_T=0.0):
    """Return what is found on a course."""
    fields, poses = course.seen(sources, np.random.default_rng(seed), bend_T)
    return track_dipole(fields, course.array, poses, time_s=course.time_s, velocity_error_m_per_s=0.1)


def passage_of(course):
    """Return the passage of one dipole."""
    fields, poses = course.seen([WRECK], np.random.default_rng(3))
    known = Known(np.zeros(11), np.append(np.full(8, np.inf), np.full(3, 0.1)))
    return passage.passage_of(dipole_field, fields, course.array, poses, known, course.time_s)


def bend_of(course, size_T):
    """Return a field along x (N, K, 3) that is quadratic along the track, of a size at its ends."""
    return size_T * ((course.points_m[..., :1] - 30) / 30) ** 2 * [1, 0, 0]


def assert_found(track, sources):
    """Check that all sources were found, each within four and a half standard errors, and nothing else."""
    assert len(track.sources) == len(sources)
    places = np.array([source.position_m for source in sources])
    found = set()
    for dipole, covariance in track.sources:
        nearest = int(np.argmin(np.linalg.norm(places - dipole.position_m, axis=1)))
        found.add(nearest)
        truth = np.concatenate([sources[nearest].position_m, sources[nearest].moment_Am2])
        off = np.concatenate([dipole.position_m, dipole.moment_Am2]) - truth
        assert (np.abs(off) < 4.5 * np.sqrt(np.diag(covariance))).all()
        assert np.sqrt(np.diag(covariance)[:3]).max() < 0.05
    assert len(found) == len(sources)


def test_one_dipole_is_one():
    """White residuals ask for no further one."""
    track = tracked(Course(), [WRECK])
    assert_found(track, [WRECK])
    assert track.fit.misfit.variance_factor == 1


@pytest.mark.parametrize("sources", [[WRECK, BESIDE], [WRECK, BEFORE]], ids=["8 m", "10 m"])
@pytest.mark.parametrize("seed", [1, 2])
def test_two_dipoles_are_both_found_and_told(sources, seed):
    """Eight metres apart along the track, where one dipole alone does not even settle, and ten."""
    assert_found(tracked(Course(), sources, seed), sources)


def test_two_dipoles_are_found_with_errors_of_the_attitude():
    """Of 0.1°, a hundred times the noise."""
    track = tracked(Course(80, attitude_noise=from_degrees(0.1)), [WRECK, BESIDE])
    assert_found(track, [WRECK, BESIDE])


@pytest.mark.parametrize("attitude_noise_deg", [0.0, 0.1])
def test_a_weak_dipole_beside_a_strong_one_is_found(attitude_noise_deg):
    """The readings point to the strong one alone; it is told first."""
    weak = Dipole(np.array([38.0, -3.5, -3.5]), np.array([10.0, 6.0, -8.0]))
    track = tracked(Course(80, attitude_noise=from_degrees(attitude_noise_deg)), [WRECK, weak])
    assert len(track.sources) == 2
    for (found, covariance), true in zip(track.sources, [WRECK, weak], strict=True):
        assert (np.abs(found.position_m - true.position_m) < 4.5 * np.sqrt(np.diag(covariance)[:3])).all()


@pytest.mark.parametrize("seed", [3, 4])
def test_two_dipoles_nearer_to_each_other_than_to_the_path_are_found(seed):
    """Six tenths of a metre apart, three from the path: one alone is between them, no start elsewhere leads there."""
    track = tracked(Course(noise_T=3e-10), [STRONG, ABOVE], seed)
    assert track.fit.misfit.variance_factor == 1
    assert len(track.sources) == 2
    for (found, covariance), true in zip(track.sources, [STRONG, ABOVE], strict=True):
        assert (np.abs(found.position_m - true.position_m) < 4.5 * np.sqrt(np.diag(covariance)[:3])).all()


def test_three_dipoles_are_found():
    """As many as are looked for."""
    assert_found(tracked(Course(100), [FIRST, WRECK, LAST]), [FIRST, WRECK, LAST])


def test_four_dipoles_are_more_than_are_looked_for():
    """They are refused, by their number."""
    with pytest.raises(Refused, match="not those of 3 dipoles beside a regional field with a constant gradient"):
        tracked(Course(100), [FIRST, BEFORE, WRECK, LAST])


def test_a_dipole_that_begins_in_the_wrong_place_is_one():
    """With errors of the attitude of nine thousand times the noise the fit of one settles elsewhere for this seed."""
    course = Course(100, noise_T=3e-11, attitude_noise=from_degrees(0.3))
    assert_found(tracked(course, [BELOW], seed=9), [BELOW])


def test_a_bend_of_the_regional_field_is_refused():
    """10 nT that are quadratic along the track are no dipole's; the reason says what is left and what would mend it."""
    course = Course(100)
    with pytest.raises(
        Refused, match=r"what is left is [\d.]+ times the noise where it is slow\. Take a shorter stretch"
    ):
        tracked(course, [WRECK], bend_T=bend_of(course, 10e-9))


def test_a_small_bend_widens_the_standard_errors():
    """Of 0.2 nT: the colour is between two and four, and all standard errors are larger by its root."""
    course = Course()
    bent, straight = tracked(course, [WRECK], bend_T=bend_of(course, 0.2e-9)), tracked(course, [WRECK])
    assert 2 < bent.fit.misfit.colour < 4
    errors, expected = (np.sqrt(np.diag(each.sources[0][1])) for each in (bent, straight))
    np.testing.assert_allclose(errors / expected, np.sqrt(bent.fit.misfit.colour), rtol=0.02)
    assert_found(bent, [WRECK])


def test_a_bend_that_moves_the_source_is_refused():
    """Of 0.27 nT: the colour is between four and eight."""
    course = Course()
    with pytest.raises(Refused, match=r"what is left is 2\.[0-7]\d? times the noise"):
        tracked(course, [WRECK], bend_T=bend_of(course, 0.27e-9))


def test_readings_of_nothing_are_refused():
    """Where there is no field at all there is no place at which to look."""
    course = Course(20)
    fields, poses = course.seen([WRECK])
    with pytest.raises(Refused, match="no source to be seen"):
        track_dipole(np.zeros_like(fields), course.array, poses)


def test_noise_beside_the_regional_field_is_no_dipole():
    """Whatever the noise, readings without a source are refused."""
    for seed in range(5):
        with pytest.raises(Refused, match="no dipole is seen"):
            tracked(Course(), [], seed)


@pytest.mark.parametrize(("chi_square", "fits"), [(1.9, 6), (2.1, 1)])
def test_a_fit_that_nearly_explains_the_readings_goes_on(monkeypatch, chi_square, fits):
    """Six times where χ² is less than twice that of noise, and not again where it is more."""
    course, solve, full = Course(40), track_fit.solve, []

    def unsettled(passage, *given, **named):
        solution = solve(passage, *given, **named)
        full.append(not given[1:] and not named)
        size = np.array([chi_square * len(passage.data)])
        return replace(solution, is_found=np.array([False]), chi_square=size)

    monkeypatch.setattr(track_fit, "solve", unsettled)
    assert not track_fit.best_fit(passage_of(course), 1).is_found[0]
    assert sum(full) == fits


@pytest.mark.parametrize("least_fall", [1e-4, 1e-2])
def test_what_is_found_does_not_depend_on_when_a_hopeless_fit_ends(monkeypatch, least_fall):
    """A tenth of the fall of χ² by which steps with fewer sources go on, and ten times it, leave the same dipoles."""
    monkeypatch.setattr(track_fit, "_LEAST_FALL", least_fall)
    assert_found(tracked(Course(60), [WRECK, BESIDE]), [WRECK, BESIDE])


@pytest.mark.parametrize("hopeless", [1.5, 10.0])
def test_what_is_found_does_not_depend_on_when_fewer_sources_are_hopeless(monkeypatch, hopeless):
    """Nor on the χ² with which no further step is made."""
    monkeypatch.setattr(track_fit, "_HOPELESS", hopeless)
    assert_found(tracked(Course(60), [WRECK, BESIDE]), [WRECK, BESIDE])
