"""Steps of a sensor's response."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.effects.scale_step import ScaleStep
from tam_calibration.files.schema import check
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.results.effects_schema import EffectFile, effect_to_mapping

EFFECT = ScaleStep()
STEP = {"time_s": 31.42}
BOX = {"time_s": 31.42, "end_s": 40.07}


@pytest.mark.parametrize("shape", [STEP, BOX])
@pytest.mark.parametrize("keys", [((0, 0, "scale"), (2, 1, "tilt")), ((1, None, "turn"), (3, 2, "scale"))])
def test_coefficients_come_back(turning, refitted, shape, keys):
    """Scales, tilts and turns are told from the calibration."""
    deviation, error = refitted(EFFECT, turning(), shape, *keys)
    assert np.abs(deviation).max() < 4
    assert error.max() < 0.2


def test_a_turn_is_that_of_the_sensor(turning):
    """What a small turn adds after its time is the reading of the turned field less that of the field."""
    covariates = turning()
    turn = np.array([3e-6, -1e-6, 2e-6])
    values = {f"turn about {axis}": value for axis, value in zip("xyz", turn, strict=True)}
    added = EFFECT.signal(covariates, FittedEffect("scale_step", STEP, (Contribution(2, None, "turn", values),)))
    turned = Rotation.from_rotvec(turn).apply(covariates.field_T) - covariates.field_T
    expected = np.zeros_like(added)
    expected[:, 6:9] = (turned @ covariates.errors.matrix[2].T) * (covariates.time_s > 31.42)[:, None]
    assert_allclose(added, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize(
    "where",
    [
        (1, 2, "scale", {"scale": 2e-4}),
        (3, None, "turn", {"turn about x": 1.5e-4, "turn about z": -1e-4}),
    ],
)
@pytest.mark.parametrize("shape", [STEP, BOX])
def test_the_times_are_found_to_the_sample(turning, left_by, shape, where):
    """Among the few shapes that are tried is the true one, and no end where there is none."""
    covariates = turning()
    tried = list(EFFECT.shapes(covariates, left_by(EFFECT, covariates, shape, where)))
    assert len(tried) <= 4
    near = [
        other
        for other in tried
        if other.keys() == shape.keys() and max(abs(other[name] - shape[name]) for name in shape) <= 0.051
    ]
    assert near


@pytest.mark.parametrize(
    "course", [lambda phase: phase**1.5, lambda phase: 35 * (2 * phase - 1) ** 4 - 30 * (2 * phase - 1) ** 2]
)
def test_a_slow_change_is_no_step(turning, left_by, course):
    """A scale that creeps, or swings to and fro slowly, has no time at which it changes."""
    covariates = turning()
    phase = covariates.time_s / covariates.time_s[-1]
    residuals = left_by(Creep(course(phase)), covariates, {}, (1, 0, "offset", {"offset": 1.0}))
    assert list(EFFECT.shapes(covariates, residuals)) == []


@pytest.mark.parametrize("seed", range(8))
def test_noise_has_no_step(turning, left_by, seed):
    """Whatever chance makes, it pays for no time."""
    covariates = turning(samples=400)
    assert list(EFFECT.shapes(covariates, left_by(EFFECT, covariates, STEP, seed=seed))) == []


class Creep:
    """A scale of the fourth row that grows with a course in time."""

    name = "creep"

    def __init__(self, course):
        self._course = course

    def add(self, rows_T, covariates, fitted, generator):
        """Return the rows with the scale changed by some 0.02 % at the end."""
        rows = rows_T.copy()
        rows[:, 3] += 2e-4 * self._course * covariates.sensed_T[:, 3]
        return rows


def test_a_sensor_of_its_own_can_step(turning, left_by):
    """The length of the field shows a scale where there is no other sensor."""
    covariates = turning(sensors=1)
    tried = EFFECT.shapes(covariates, left_by(EFFECT, covariates, STEP, (0, 0, "scale", {"scale": 5e-4})))
    assert min(abs(shape["time_s"] - 31.42) for shape in tried) <= 0.2


def test_what_lags_behind_the_fastest_change_is_no_step(turning, left_by, slew):
    """An amplifier too slow for five samples of a run leaves no change for good or for a time."""
    covariates = turning()
    tried = list(EFFECT.shapes(covariates, left_by(slew, covariates, {}, (1, 0, "offset", {"offset": 1.0}))))
    fastest = covariates.time_s[np.argmax(np.abs(np.diff(covariates.sensed_T[:, 3])))]
    assert all(abs(time - fastest) > 0.5 for shape in tried for time in shape.values())


def test_few_samples_show_nothing(turning, left_by):
    """A step needs a before and an after."""
    covariates = turning(samples=10)
    assert "too few" in EFFECT.obstacle(covariates)
    assert list(EFFECT.shapes(covariates, left_by(EFFECT, covariates, STEP))) == []


def test_it_survives_a_file():
    """Read again from what is written, it is the same."""
    fitted = FittedEffect("scale_step", BOX, (Contribution(1, 2, "scale", {"scale": 2e-4}),))
    units = EFFECT.shape_units | {"scale": "1"}
    assert check(effect_to_mapping(fitted, units), EffectFile).to_fitted() == fitted
