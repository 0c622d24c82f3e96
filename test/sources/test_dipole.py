import magpylib
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.constants import mu_0

from tam_calibration.core.least_squares import with_slopes
from tam_calibration.model.exceptions import InputError
from tam_calibration.sources.dipole import VACUUM_PERMEABILITY, Dipole, Loop, dipole_field, moment_of_field

PLACE = np.array([1.0, 2.0, 3.0])
RNG = np.random.default_rng(3)
OFFSETS, MOMENTS = RNG.normal(size=(20, 3)), 100 * RNG.normal(size=(20, 3))


def test_the_permeability_is_that_of_codata():
    """As scipy has it, whose edition of CODATA may be an older one."""
    assert pytest.approx(mu_0, rel=1e-9) == VACUUM_PERMEABILITY


def test_field_is_that_of_magpylib():
    """In any direction and at any distance."""
    for offset, moment in zip(OFFSETS, MOMENTS, strict=True):
        expected = magpylib.misc.Dipole(position=PLACE, moment=moment).getB(offset + PLACE)
        assert_allclose(Dipole(PLACE, moment).field_T(offset + PLACE), expected, rtol=1e-8)


def test_gradient_and_derivative_by_the_moment_are_slopes_of_the_field(slope):
    """Central differences agree, and the tensor is symmetric without trace."""
    field, gradient, by_moment = dipole_field(OFFSETS, MOMENTS)
    for n, (offset, moment) in enumerate(zip(OFFSETS, MOMENTS, strict=True)):
        reach = np.linalg.norm(offset)
        by_place = slope(lambda point, moment=moment: dipole_field(point, moment)[0], offset, 0.01 * reach)
        assert_allclose(gradient[n], by_place, atol=1e-8 * np.abs(by_place).max())
        assert_allclose(by_moment[n] @ moment, field[n], rtol=1e-12)
    assert_allclose(gradient, np.swapaxes(gradient, 1, 2), atol=0)
    assert_allclose(np.trace(gradient, axis1=1, axis2=2), 0, atol=1e-14 * np.abs(gradient).max())


def test_moment_of_the_field_is_the_moment(slope):
    """Field to moment undoes moment to field; its derivatives by complex steps are slopes."""
    both = np.concatenate([OFFSETS, dipole_field(OFFSETS, MOMENTS)[0]], axis=1)
    moment, slopes = with_slopes(lambda each: moment_of_field(*np.split(each, 2, axis=1)), both)
    assert_allclose(moment, MOMENTS, rtol=1e-12)
    by_offset, by_field = np.split(slopes, 2, axis=2)
    for n, (offset, source) in enumerate(zip(OFFSETS, MOMENTS, strict=True)):
        field = dipole_field(offset, source)[0]
        by_place = slope(lambda point, field=field: moment_of_field(point, field), offset, 1e-3)
        by_value = slope(lambda value, offset=offset: moment_of_field(offset, value), field, np.abs(field).max())
        assert_allclose(by_offset[n], by_place, atol=1e-8 * np.abs(by_place).max())
        assert_allclose(by_field[n], by_value, atol=1e-8 * np.abs(by_value).max())


@pytest.mark.parametrize("distance_m", [0.0, 1e-200])
@pytest.mark.parametrize("method", ["field_T", "gradient_T_per_m"])
def test_a_point_on_the_source_is_refused(method, distance_m):
    """Where the field is infinite, also of a dipole or on the wire of a loop, as one of several points."""
    sources = (
        (Dipole(PLACE, MOMENTS[0]), PLACE),
        (Loop(PLACE, np.array([0, 0, 5.0]), 0.5), np.add(PLACE, [0.3, 0.4, 0])),
    )
    for source, place in sources:
        for points in (np.add(place, [0, 0, distance_m]), np.array([[9.0, 9, 9], place])):
            with pytest.raises(InputError, match="not finite: it lies at a sensor or the array's centre"):
                getattr(source, method)(points)
        assert np.isfinite(getattr(source, method)(np.add(place, [0, 0, 1e-3]))).all()


@pytest.mark.parametrize(("moment", "radius"), [([0, 0, 0], 0.5), ([0, 0, 1], 0), ([0, 0, np.nan], 1)])
def test_a_loop_without_axis_or_size_is_refused(moment, radius):
    """Its field would be no number."""
    with pytest.raises(InputError, match=r"the field of the source is not finite: .* or has no size"):
        Loop(PLACE, np.array(moment), radius).field_T(np.zeros(3))
