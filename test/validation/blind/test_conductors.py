"""Conductors of the check, against what is known in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.linalg import norm
from numpy.testing import assert_allclose

from tam_calibration.validation.blind.conductors import disc, faded, neumann, of_cylinder, of_sphere, of_wires, ribs

MU0 = 4e-7 * np.pi
FAR = np.array([[0.0, 0.0, 50.0]])
CONDUCTIVITY = 2.5e7


def rising(rate_T_per_s):
    """Return a scene whose field rises evenly, long since."""
    time_s = np.arange(20) * 0.1
    rate = np.asarray(rate_T_per_s, dtype=float)
    return SimpleNamespace(
        time_s=time_s, step_s=0.1, duration_s=1.9, sample_count=20, field_at=lambda t: t[:, None] * rate
    )


def moment_z(field_T):
    """Return the moment along z [A m²] of the field far along z."""
    return field_T[-1, 0, 2] * 50.0**3 / 2e-7


def test_a_change_fades_with_its_time_constant():
    """Of a field that jumped a second before exp(-1 / τ) is left; of one that rises evenly its rate times τ."""
    scene = rising([0, 0, 1])
    scene.field_at = lambda t: np.outer(t > -1.0, [0.0, 0.0, 1.0])
    assert_allclose(faded(scene, np.array([0.7]))[0, :, 2], np.exp(-(scene.time_s + 1) / 0.7), rtol=0.02)
    assert_allclose(faded(rising([0, 0, 1]), np.array([0.02, 0.5]))[:, -1, 2], [0.02, 0.5], rtol=1e-3)


def test_slow_currents_in_solid_bodies_follow_the_rate():
    """In a sphere -2 π σ a⁵ / 15, in a cylinder along the field -π σ a⁴ l / 8 for each tesla a second."""
    scene, radius = rising([0, 0, 1e-5]), 0.2
    sphere = moment_z(of_sphere(scene, FAR, np.zeros(3), radius, CONDUCTIVITY))
    assert sphere == pytest.approx(-2 * np.pi * CONDUCTIVITY * radius**5 / 15 * 1e-5, rel=2e-3)
    ends = np.array([[0, 0, -0.3], [0, 0, 0.3]])
    cylinder = moment_z(of_cylinder(scene, FAR, ends, radius, CONDUCTIVITY))
    assert cylinder == pytest.approx(-np.pi * CONDUCTIVITY * radius**4 * 0.6 / 8 * 1e-5, rel=2e-3)


def test_a_cylinder_answers_twice_as_strongly_across():
    """As the currents along it close at its far ends."""
    ends = np.array([[0, 0, -0.3], [0, 0, 0.3]])
    along = of_cylinder(rising([0, 0, 1e-5]), FAR, ends, 0.1, CONDUCTIVITY)[-1, 0, 2]
    across = of_cylinder(rising([1e-5, 0, 0]), FAR, ends, 0.1, CONDUCTIVITY)[-1, 0, 0]
    assert across / along == pytest.approx(2 * -0.5, rel=1e-3)


def test_slow_currents_in_a_disc_follow_the_rate():
    """By -π σ t a⁴ / 8 for each tesla a second across it, and by nothing along it."""
    plate = disc(np.zeros(3), np.array([0.0, 0, 1]), 0.3, 1 / (CONDUCTIVITY * 0.002))
    assert moment_z(plate.field(rising([0, 0, 1e-5]), FAR)) == pytest.approx(
        -np.pi * CONDUCTIVITY * 0.002 * 0.3**4 / 8 * 1e-5, rel=0.03
    )
    assert norm(plate.field(rising([1e-5, 0, 0]), FAR)) < 1e-20


def test_the_field_of_wires():
    """At the centre of a square of edge a it is 2 √2 μ0 / (π a), upwards where the current turns to the left."""
    square = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0], [1, 1, 0]]) * 0.5
    assert_allclose(of_wires(square, np.zeros((1, 3))), [[0, 0, 2 * np.sqrt(2) * MU0 / np.pi]], atol=1e-20)


def test_the_inductance_of_a_square():
    """2 μ0 a / π (ln(a / r) - 0.774) of a tube's radius r; ribs that are near each other share flux, and never more."""
    frame = ribs(np.array([[0.0, 0, 0], [0.3, 0, 0]]), np.array([0, 0.5, 0]), np.array([0, 0, 0.5]), 0.005, 1e-4)
    inductance = frame.inductance_H
    assert inductance[0, 0] == pytest.approx(2 * MU0 / np.pi * (np.log(200) - 0.774), rel=2e-3)
    assert 0 < inductance[0, 1] < inductance[0, 0]
    assert np.linalg.eigvalsh(inductance).min() > 0
    assert_allclose(norm(frame.areas_m2, axis=1), [1.0, 1.0, 0.3, 0.3])


def test_currents_in_a_frame_oppose_the_change():
    """A loop that has settled carries -A b' / R."""
    frame = ribs(np.array([[0.0, 0, 0], [0.3, 0, 0]]), np.array([0, 0.5, 0]), np.array([0, 0, 0.5]), 0.005, 1.0)
    field = frame.field(rising([1e-5, 0, 0]), np.array([[50.0, 0, 0]]))[-1, 0, 0]
    assert field == pytest.approx(2e-7 * 2 * (-1e-5 / 4) / 49.85**3, rel=5e-3)


def test_the_mutual_inductance_of_small_loops_far_apart():
    """μ0 A² / (2 π d³) of two squares with one axis, and half as much the other way in one plane."""
    square = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) * 0.05
    expected = MU0 * 0.01**2 / (2 * np.pi * 2.0**3)
    assert neumann(square, square + np.array([0, 0, 2.0])) == pytest.approx(expected, rel=0.01)
    assert neumann(square, square + np.array([2.0, 0, 0])) == pytest.approx(-expected / 2, rel=0.01)
