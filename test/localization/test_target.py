"""Several lines show one list: an object that several see is one target, as certain as its sightings agree."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.localization.targets import Target, merged

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
