import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.linalg import norm
from numpy.testing import assert_allclose

from tam_calibration.localization.euler import locate
from tam_calibration.localization.solutions import Status
from tam_calibration.localization.source_fit import is_certain
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.sources.dipole import Dipole

from .conftest import outputs_of

VECTOR = hnp.arrays(float, 3, elements=st.floats(-1, 1))
PLACE, MOMENT = np.array([2.4, -1.0, 0.46]), np.array([180.0, -350.0, 290.0])
ARRAY = Array.cross(0.5, vector_noise_T=1e-10)
NOISE = ARRAY.operator @ ARRAY.operator.T * 1e-20


def locate_one(output, covariance=None, **options):
    """Return the source of one sample."""
    return locate(np.asarray(output)[None], covariance, **options)


def test_a_fit_that_went_far_off_is_judged_without_a_warning():
    """Its square is beyond every number; one nearby that is known to a third is not valid."""
    unknowns = np.zeros((2, 6))
    unknowns[:, 0] = 1e200, 3.0
    covariance = np.broadcast_to(np.eye(6), (2, 6, 6))
    assert is_certain(unknowns, covariance).tolist() == [True, False]


@given(VECTOR, VECTOR)
def test_dipole_is_found_wherever_it_is_and_points(place, moment):
    """From the exact field and tensor, position and moment come out to 1e-9, at right angles and in line too."""
    assume(norm(place) > 0.1 and norm(moment) > 0.1)
    found = locate_one(outputs_of(Dipole(10 * place, 300 * moment)))
    assert_allclose(found.position_m[0], 10 * place, atol=1e-9 * norm(10 * place))
    assert_allclose(found.moment_Am2[0], 300 * moment, atol=1e-8 * norm(300 * moment))
    assert np.isnan(found.position_covariance_m2).all()


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 2])
def test_constrained_solution_needs_no_luck_with_the_moment(angle):
    """At any angle of the moment to the line of sight noise moves it by millimetres."""
    generator = np.random.default_rng(7)
    across = np.cross(PLACE, [0, 0, 1])
    moment = 400 * (np.cos(angle) * PLACE / norm(PLACE) + np.sin(angle) * across / norm(across))
    noisy = outputs_of(Dipole(PLACE, moment)) + generator.multivariate_normal(np.zeros(9), NOISE, 500)[:, :8]
    constrained = locate(noisy, NOISE)
    assert constrained.is_located.all()
    assert norm(constrained.position_m - PLACE, axis=1).max() < 5e-3
    unconstrained = locate(noisy, NOISE, constrained=False)
    assert (unconstrained.status == Status.ILL_CONDITIONED).all() == (angle == np.pi / 2)


@pytest.mark.parametrize("constrained", [True, False])
def test_covariance_is_that_of_repeated_measurements(constrained):
    """Standard errors of position, moment and distance are the scatter under noise of the outputs."""
    generator = np.random.default_rng(8)
    exact = outputs_of(Dipole(PLACE, MOMENT))
    noisy = locate(
        exact + generator.multivariate_normal(np.zeros(9), NOISE, 4000)[:, :8], NOISE, constrained=constrained
    )
    one = locate_one(exact, NOISE, constrained=constrained)
    for found, covariance in (
        (noisy.position_m, one.position_covariance_m2[0]),
        (noisy.moment_Am2, one.moment_covariance_A2m4[0]),
    ):
        size = np.sqrt(np.diag(covariance))
        assert_allclose(np.cov(found.T) / np.outer(size, size), covariance / np.outer(size, size), atol=0.08)


def test_which_eigenvector_is_left_out_by_chance_is_in_the_covariance():
    """Where noise hides which of two eigenvalues is the smaller, the other choice lies within one standard error."""
    outputs = outputs_of(Dipole(np.array([3.0, 0.0, 0.0]), 400 * np.array([np.cos(0.01), np.sin(0.01), 0.0])))
    noise = 1e-18 * np.eye(8)
    found, unaware = (locate_one(outputs, noise, constrained=constrained) for constrained in (True, False))
    gxx, gxy, gxz, gyy, gyz = outputs[3:]
    values, vectors = np.linalg.eigh([[gxx, gxy, gxz], [gxy, gyy, gyz], [gxz, gyz, -gxx - gyy]])
    parts = 3 * vectors * (vectors.T @ outputs[:3] / values)
    one, other, _ = np.argsort(np.abs(values))
    change = parts[:, one] - parts[:, other]
    assert change @ np.linalg.solve(unaware.position_covariance_m2[0], change) > 10
    assert change @ np.linalg.solve(found.position_covariance_m2[0], change) < 1


def test_structural_index_scales_the_distance():
    """A line of dipoles falls with the square, a line of current with the distance: r is n times the same vector."""
    x, y = 2.0, -1.0
    square = x**2 + y**2
    # B = (y, x)/r² times a factor is harmonic: the field of a line of dipoles is the slope of the wire's.
    wire = np.array([y, -x, 0]) / square
    slope = np.array([[-2 * x * y, x * x - y * y], [x * x - y * y, 2 * x * y]]) / square**2
    outputs = np.array([*wire, slope[0, 0], slope[0, 1], 0, slope[1, 1], 0])
    assert_allclose(locate_one(outputs, index=1).position_m[0], [-x, -y, 0], atol=1e-12)
    both = [locate_one(outputs, index=index) for index in (1, 2)]
    assert_allclose(both[1].position_m, 2 * both[0].position_m)
    assert np.isnan(both[0].moment_Am2).all()


def test_line_of_dipoles_is_found_where_its_tensor_has_no_third_dimension():
    """Unconstrained it is refused, as the tensor is singular along the line."""
    z = 2.0 - 1.5j
    field, slope = 1 / z**2, -2 / z**3
    outputs = np.array([field.real, -field.imag, 0, slope.real, -slope.imag, 0, -slope.real, 0])
    assert_allclose(locate_one(outputs, index=2).position_m[0], [-z.real, -z.imag, 0], atol=1e-12)
    refused = Status(locate_one(outputs, index=2, constrained=False).status[0])
    assert "constrained solution" in refused.reason


@pytest.mark.parametrize(
    ("outputs", "covariance", "status"),
    [
        (np.full(8, np.nan), None, Status.NOT_FINITE),
        (outputs_of(Dipole(PLACE, MOMENT)), np.full((9, 9), np.nan), Status.NOT_FINITE),
        (np.zeros(8), None, Status.NO_FIELD),
        (np.array([1e-9, 0, 0, 0, 0, 0, 0, 0]), None, Status.NO_GRADIENT),
        (outputs_of(Dipole(PLACE, 1e-5 * MOMENT)), NOISE, Status.NO_FIELD),
        (np.array([5e-8, 0, 0, 1e-12, 0, 0, 0, 0]), NOISE, Status.NO_GRADIENT),
        (np.array([1e-9, 3e-9, 0, -2e-9, 0, 0, 1e-9, 0]), None, Status.AMBIGUOUS),
    ],
)
def test_degenerate_geometry_is_refused_with_the_reason(outputs, covariance, status):
    """Not finite, no field, no gradient, hidden by noise, or two eigenvalues alike."""
    found = locate(outputs[None], covariance)
    assert found.status[0] == status
    assert np.isnan(found.position_m).all() and not found.is_located[0]


def test_far_source_is_uncertain_before_it_is_hidden():
    """Between well located and hidden there is a range in which the position is worth nothing."""
    generator = np.random.default_rng(9)
    strengths = np.logspace(-5, 0, 60)
    clean = np.array([outputs_of(Dipole(PLACE, strength * MOMENT)) for strength in strengths])
    status = locate(clean + generator.multivariate_normal(np.zeros(9), NOISE, 60)[:, :8], NOISE).status
    assert {Status.NO_FIELD, Status.NO_GRADIENT, Status.UNCERTAIN, Status.LOCATED} <= set(status)
    assert status[0] == Status.NO_FIELD and (status[-20:] == Status.LOCATED).all()


def test_a_sample_does_not_depend_on_its_neighbours():
    """Alone and among others, of which some are refused, a sample gives the same numbers."""
    many = np.array([outputs_of(Dipole(PLACE * scale, MOMENT)) for scale in (0.5, 1, 40, 2)])
    together = locate(many, NOISE)
    for n in np.flatnonzero(together.is_located):
        assert_allclose(locate_one(many[n], NOISE).position_m[0], together.position_m[n], rtol=1e-13)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"outputs": np.zeros((3, 5))}, "8 or 9 numbers"),
        ({"outputs": np.zeros((3, 9)), "index": 0}, "structural index"),
        ({"outputs": np.zeros((3, 9)), "covariance": np.eye(5)}, "covariance must be"),
        ({"outputs": np.zeros((3, 9)), "covariance": -np.eye(9)}, "covariance of field and gradient must be symmetric"),
        ({"outputs": np.zeros((3, 9)), "covariance": np.eye(9) - 0.5}, "must be symmetric and positive definite"),
        ({"outputs": np.zeros((3, 9)), "covariance": np.tri(9)}, "must be symmetric and positive definite"),
        (
            {"outputs": np.zeros((2, 9)), "covariance": np.stack([np.eye(9), 1 - np.eye(9)])},
            "must be symmetric and positive definite",
        ),
    ],
)
def test_wrong_shapes_are_named(arguments, message):
    """Each with what was expected."""
    with pytest.raises(InputError, match=message):
        locate(**arguments)


def test_ambiguity_adds_the_square_of_the_other_choice():
    """The covariance is that with neither eigenvector left out, and the change of place from one to the other."""
    values, field = 1e-7 * np.array([-2.0, 1.0005, 0.9995]), 1e-9 * np.array([1000.0, 3.0, 2.0])
    outputs = np.array([*field, values[0], 0.0, 0.0, values[1], 0.0])
    noise = np.diag([5e-9**2] * 3 + [1e-10**2] * 5)
    ambiguous, neither = (
        locate_one(outputs, noise, constrained=constrained).position_covariance_m2[0] for constrained in (True, False)
    )
    change = 3 * field / values * [0, 1, -1]
    assert_allclose(ambiguous - neither, np.outer(change, change), atol=1e-9 * change @ change)


def test_samples_may_have_a_covariance_each():
    """Of as many rows as there are samples, of the same size it gives the same."""
    many = np.array([outputs_of(Dipole(PLACE * scale, MOMENT)) for scale in (1, 1.5, 2)])
    common, own = locate(many, NOISE), locate(many, NOISE * np.array([1.0, 4.0, 9.0])[:, None, None])
    expected = common.position_covariance_m2 * np.array([1.0, 4.0, 9.0])[:, None, None]
    assert_allclose(own.position_covariance_m2, expected, rtol=1e-9)
