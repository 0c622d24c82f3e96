import pytest

from tam_calibration.comparison.compare import side_of
from tam_calibration.model.exceptions import Refused


def test_the_noise_of_every_axis_and_of_the_scalar_is_found(side, sheet):
    """A run without effects has white noise of the level that was simulated."""
    *axes, scalar = side(1).gap.noise
    assert [(one.sensor, one.axis) for one in axes] == [(k, axis) for k in (1, 2, 3, 4) for axis in "xyz"]
    assert [one.level_T for one in axes] == pytest.approx([sheet] * 12, rel=0.1)
    assert {one.colour for one in axes} == {"white"}
    assert (scalar.sensor, scalar.colour) == (0, "white") and scalar.level_T == pytest.approx(1e-10, rel=0.1)


def test_what_effects_add_is_no_noise(side, sheet):
    """A drift that the diagnosis names is taken off before the noise is measured."""
    found = side(1, 3)
    assert [cause.fitted.effect for cause in found.gap.causes] == ["temperature_drift"]
    assert [one.level_T for one in found.gap.noise[:-1]] == pytest.approx([sheet] * 12, rel=0.1)


def test_a_run_that_determines_no_calibration_is_refused(run, cross):
    """A few samples tell nothing: the refusal says so."""
    with pytest.raises(Refused):
        side_of(run(1).take(slice(0, 20)), cross)
