import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from tam_calibration.model.exceptions import Refused
from tam_validation.blind.continuous_motion import about
from tam_validation.blind.injected import INJECTED, inject

NOISE_T = 100e-9


@pytest.fixture(scope="module")
def real():
    """Return times, readings of one sensor and attitudes, as a real recording would hold them."""
    rng = np.random.default_rng(1)
    time_s = np.arange(1500) / 25
    swing = np.stack([0.9 * time_s, 1.1 * np.sin(0.37 * time_s), 1.6 * np.sin(0.23 * time_s + 1)], axis=1)
    to_world = about("z", swing[:, 0]) @ about("y", swing[:, 1]) @ about("x", swing[:, 2])
    field = np.einsum("nji,j->ni", to_world, [18e-6, 3e-6, -44e-6])
    response = np.array([[1.04, 0.02, -0.01], [0.01, 0.97, 0.03], [0.0, -0.02, 1.01]])
    readings = field @ response.T + [60e-6, -50e-6, 400e-6]
    return time_s, readings[:, None] + rng.normal(size=(1500, 1, 3)) * NOISE_T, to_world


def ellipsoid_residual(readings):
    """Return what the best ellipsoid leaves, tesla, by another fit."""
    point = readings[:, 0] * 1e6
    middle = (point.max(axis=0) + point.min(axis=0)) / 2
    places = np.triu_indices(3)

    def residual(unknowns):
        upper = np.zeros((3, 3))
        upper[places] = unknowns[:6]
        return np.linalg.norm((point - unknowns[6:]) @ upper.T, axis=1) - 1

    start = np.concatenate([np.eye(3)[places] / 48, middle])
    fit = least_squares(residual, start, x_scale="jac")
    upper = np.zeros((3, 3))
    upper[places] = fit.x[:6]
    return fit.fun * 1e-6 / np.linalg.det(upper) ** (1 / 3)


@pytest.mark.parametrize("with_attitude", [False, True])
def test_own_residual_is_the_noise(real, with_attitude):
    """What a recording leaves by itself, robustly, is the noise of its readings."""
    time_s, readings, to_world = real
    spiked = readings.copy()
    spiked[::50] += 30e-6
    made = inject(time_s, spiked, to_world if with_attitude else None, "bias_jump", 1.0, 1)
    assert made.key["own_residual_nT"] == pytest.approx(1e9 * NOISE_T, rel=0.05)


@pytest.mark.parametrize("effect", [name for name in INJECTED if name != "stale_samples"])
def test_visible_size_is_what_another_fit_leaves(real, effect):
    """The residual of an ellipsoid grows by the size that the key tells, as independent errors add."""
    time_s, readings, _ = real
    made = inject(time_s, readings, None, effect, 3.0, 2)
    assert made.key["visible_nT"] == pytest.approx(300, rel=0.05)
    before, after = (ellipsoid_residual(one).std() for one in (readings, made.readings_T))
    assert np.sqrt(after**2 - before**2) == pytest.approx(made.key["visible_nT"] * 1e-9, rel=0.1)


def test_visible_size_with_attitude_is_what_remains_of_the_vectors(real):
    """With attitude all three axes are redundant: a constant and matrices times the turned field take up the rest."""
    time_s, readings, to_world = real
    made = inject(time_s, readings, to_world, "current_interference", 3.0, 3)
    features = np.column_stack([np.einsum("nji,j->ni", to_world, [18e-6, 3e-6, -44e-6]) * 1e5, np.ones(len(time_s))])
    change = made.readings_T[:, 0] - readings[:, 0]
    left = change - features @ np.linalg.lstsq(features, change, rcond=None)[0]
    assert np.sqrt((left**2).mean()) == pytest.approx(made.key["visible_nT"] * 1e-9, rel=0.03)


@pytest.mark.parametrize(
    ("effect", "channel"), [("temperature_drift", "temperature_C"), ("current_interference", "current_A")]
)
def test_the_channel_that_is_followed_is_made_up(real, effect, channel):
    """The readings change by the coefficient of the key with the column that is added; no other column is."""
    time_s, readings, to_world = real
    made = inject(time_s, readings, to_world, effect, 10.0, 4)
    values = made.columns[channel]
    change = 1e9 * (made.readings_T - readings)[:, 0]
    slopes = np.linalg.lstsq(np.column_stack([values, np.ones(len(values))]), change, rcond=None)[0][0]
    assert_allclose(slopes, list(made.key["coefficients"].values()), rtol=0.05)
    assert list(made.columns) == [channel]


def test_a_late_axis_reads_what_was_there_before(real):
    """The one axis follows its own past by the delay of the key."""
    time_s, readings, to_world = real
    made = inject(time_s, readings, to_world, "time_skew", 3.0, 5)
    ((name, delay_s),) = made.key["coefficients"].items()
    axis = "xyz".index(made.key["axes"][0])
    assert name == f"sensor 1 {made.key['axes'][0]} delay"
    change = (made.readings_T - readings)[:, 0]
    clean = readings[:, 0, axis]
    expected = np.interp(time_s - delay_s, time_s, clean) - clean
    inner = slice(100, -100)
    assert np.corrcoef(change[inner, axis], expected[inner])[0, 1] > 0.9
    assert not np.delete(change, axis, axis=1).any()


def test_what_cannot_be_so_large_is_refused(real):
    """A repeated reading is wrong by what the field changes meanwhile, and no more."""
    time_s, readings, _ = real
    with pytest.raises(Refused, match="stale_samples cannot be 1000 times what this recording leaves by itself"):
        inject(time_s, readings, None, "stale_samples", 1000.0, 1)


def test_what_lies_on_no_ellipsoid_is_refused(real):
    """A sensor that was not turned shows no field to size an effect by."""
    time_s, readings, _ = real
    rng = np.random.default_rng(2)
    with pytest.raises(Refused, match="lie on no ellipsoid"):
        inject(time_s, 5e-5 + rng.normal(size=readings.shape) * 1e-8, None, "bias_jump", 1.0, 1)
    with pytest.raises(Refused, match="holds 20 samples"):
        inject(time_s[:20], readings[:20], None, "bias_jump", 1.0, 1)
