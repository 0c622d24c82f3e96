"""What all effects that are linear in their coefficients have in common."""

import numpy as np
import pytest

from tam_calibration.effects.library import effect_named
from tam_calibration.files.schema import check
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.results.effects_schema import EffectFile, effect_to_mapping

STEP, BOX = {"time_s": 31.42}, {"time_s": 31.42, "end_s": 40.07}
WINDOWS = {"on_1_s": 5.02, "off_1_s": 8.02, "on_2_s": 21.52, "off_2_s": 25.02, "on_3_s": 50.02}
THRESHOLDS, OF_SENSOR = (
    {"upper_T": 35e-6, "lower_T": 28e-6},
    {"sensor_upper_T": 45e-6, "sensor_lower_T": 38e-6},
)
LATE, RINGS = {"late_y_s": 0.05}, {"frequency_hz": 1.3, "damping": 0.2}
OFFSETS = (0, 0, "offset"), (2, 1, "offset"), (SCALAR, None, "offset")
GAINS = (0, 0, "gain"), (2, 1, "gain")
SCALES, TURNS = ((0, 0, "scale"), (2, 1, "tilt")), ((1, None, "turn"), (3, 2, "scale"))
CURVES = [(*place, name) for place in ((1, 2), (3, 0)) for name in ("quadratic", "cubic", "higher", "highest")]
DRIFT = {"time_constant_s": 4.0, "inner_share": 0.3, "reference_C": 20.0, "start_s": 0.0}


@pytest.mark.parametrize(
    ("name", "shape", "keys", "largest_error"),
    [
        ("ambient_gradient", {}, [(ALL, None, f"degree {degree}") for degree in (2, 3, 4)], np.inf),
        ("bias_jump", STEP, OFFSETS, 0.1),
        ("bias_jump", BOX, OFFSETS, 0.1),
        ("crosstalk", LATE, [(0, 0, "from y"), (2, 2, "from y")], 0.1),
        (
            "current_interference",
            {"reference_A": 0.5, "time_constant_s": 0.3},
            [(0, 0, "field"), (0, 0, "lagged"), (0, 0, "quadratic"), (3, 1, "field")],
            0.1,
        ),
        ("eddy_current", {"time_constant_s": 0.4}, [(0, None, "first mode"), (3, None, "first mode")], 1),
        ("flexure", {}, [(1, None, "turn")], np.inf),
        ("gain_switching", WINDOWS, GAINS, 0.1),
        ("gain_switching", THRESHOLDS, GAINS, 0.1),
        ("gain_switching", OF_SENSOR, GAINS, 0.1),
        ("nonlinearity", {"full_scale_T": 50e-6}, CURVES, 0.1),
        (
            "periodic_interference",
            {"frequency_hz": 3.217, "start_s": 0.0},
            [(0, 0, "line"), (0, 0, "harmonics"), (SCALAR, None, "line")],
            0.1,
        ),
        ("ringing", RINGS, [(0, None, "response"), (2, 1, "response of the axis")], 0.3),
        *(("scale_step", shape, keys, 0.2) for shape in (STEP, BOX) for keys in (SCALES, TURNS)),
        ("temperature_drift", DRIFT, [(1, 0, "offset"), (1, 0, "scale"), (1, 2, "quadratic offset")], 0.1),
        ("time_skew", {}, [(1, None, "delay"), (2, 0, "delay of the axis")], 0.1),
    ],
)
def test_coefficients_come_back(turning, refitted, name, shape, keys, largest_error):
    """They are told from the calibration and from each other, within their standard errors."""
    deviation, error = refitted(effect_named(name), turning(), shape, *keys)
    assert np.abs(deviation).max() < (4.5 if name == "eddy_current" else 4)  # of eighteen coefficients
    assert error.max() < largest_error


@pytest.mark.parametrize(
    ("name", "samples"), [("bias_jump", 10), ("gain_switching", 10), ("scale_step", 10), ("periodic_interference", 20)]
)
def test_few_samples_show_nothing(turning, name, samples):
    """A step needs a before and an after, a spectrum some samples."""
    assert "too few" in effect_named(name).obstacle(turning(samples=samples))


@pytest.mark.parametrize("name", ["eddy_current", "time_skew"])
def test_poses_show_nothing(turning, name):
    """Without motion there are no rates and no eddy currents."""
    poses = np.random.default_rng(1).normal(size=(300, 4))
    assert "jumps" in effect_named(name).obstacle(turning(samples=300, attitude=poses))
    assert effect_named(name).obstacle(turning()) is None


@pytest.mark.parametrize(
    ("name", "shape", "contribution", "units"),
    [
        ("crosstalk", LATE, (1, 2, "from y", {"bleed": 2e-4}), {"bleed": "1"}),
        *(
            ("gain_switching", shape, (1, 2, "gain", {"gain": 2e-4}), {"gain": "1"})
            for shape in (WINDOWS, THRESHOLDS, OF_SENSOR)
        ),
        ("ringing", RINGS, (1, None, "response", {"amplitude": 1.0, "delay": 0.05}), {"amplitude": "1", "delay": "s"}),
        ("scale_step", BOX, (1, 2, "scale", {"scale": 2e-4}), {"scale": "1"}),
    ],
)
def test_effects_survive_a_file(turning, name, shape, contribution, units):
    """Read again from what is written, they are the same."""
    covariates = turning()
    fitted = FittedEffect(name, shape, (Contribution(*contribution),))
    written = effect_to_mapping(fitted, dict(effect_named(name).shape_units) | units)
    assert check(written, EffectFile).to_fitted(covariates.errors, covariates.array) == fitted
