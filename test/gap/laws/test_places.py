"""The places of a law that the residual of the intensity alone shows."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.gap.laws.places import field_over_scalar, places_of, within
from tam_calibration.gap.laws.whitened import residual_of


def disturbed(run, course_T, in_field):
    """Return the residual of a scalar with a course (N,), or of a field at all sensors with the opposite one."""
    made = run(samples=900)
    if not in_field:
        return residual_of(made.with_row(12, course_T).model())
    unit = made.recording.readings_T.mean(axis=1)
    unit = unit / np.linalg.norm(unit, axis=1)[:, None]
    for row in range(12):
        made = made.with_row(row, -course_T * unit[:, row % 3])
    return residual_of(made.model())


@pytest.mark.parametrize("kind", ["random", "slow"])
@pytest.mark.parametrize("in_field", [False, True])
def test_the_readings_of_the_scalar_tell_whose_disturbance_it_is(run, kind, in_field):
    """Odds above 20, whether it is white or slow; with an attitude the likelier place alone is left."""
    time = np.linspace(0, 1, 900)
    course = np.random.default_rng(3).normal(size=900) if kind == "random" else np.sin(7 * time)
    residual = disturbed(run, 20e-9 * course, in_field)
    odds = field_over_scalar(residual)
    assert (odds > 3) if in_field else (odds < -3)
    signal = within(residual, ("scalar",), residual.z)
    right = (1, 2, 3, 4) if in_field else ("scalar",)
    assert places_of(("scalar",), signal, residual) == (right,)
    both = places_of(("scalar",), signal, replace(residual, rotation=None))
    assert both[0] == right and set(both) == {("scalar",), (1, 2, 3, 4)}


def test_a_sensor_of_several_is_a_place_of_its_own(run):
    """No other place makes what one of four sensors does."""
    residual = residual_of(run(samples=300).model())
    assert places_of((2,), residual.z, residual) == ((2,),)
