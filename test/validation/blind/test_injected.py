import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from tam_calibration.model.exceptions import Refused
from tam_validation.blind.continuous_motion import about
from tam_validation.blind.injected import INJECTED, inject
from tam_validation.blind.recorded import Recorded

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


def alone(time_s, readings, to_world=None):
    """Return the recording of a lone sensor without a scalar."""
    return Recorded(time_s, readings, None, to_world, np.zeros((1, 3)))


@pytest.fixture(scope="module")
def cross(real):
    """Return a function that makes the recording of a cross of four with a scalar, in a field that varies by 20 nT."""
    time_s, to_world = real[0][::4], real[2][::4]
    rng = np.random.default_rng(2)
    field = np.einsum("nji,j->ni", to_world, [18e-6, 3e-6, -44e-6])
    field *= 1 + 4e-4 * np.sin(time_s / 9)[:, None]
    response = np.eye(3) + 0.03 * rng.normal(size=(4, 3, 3))
    readings = np.einsum("kij,nj->nki", response, field) + 2e-6 * rng.normal(size=(4, 3))
    readings += 1e-9 * rng.normal(size=readings.shape)
    scalar = np.linalg.norm(field, axis=1) + 1e-10 * rng.normal(size=len(field))
    positions = 0.25 * np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0.0]])
    return lambda attitude: Recorded(time_s, readings, scalar, to_world if attitude else None, positions)


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


@pytest.fixture(scope="module")
def own_residual(real):
    """Return what the best ellipsoid leaves of the recording."""
    return ellipsoid_residual(real[1])


@pytest.mark.parametrize("with_attitude", [False, True])
def test_own_residual_is_the_noise(real, with_attitude):
    """What a recording leaves by itself, robustly, is the noise of its readings."""
    time_s, readings, to_world = real
    spiked = readings.copy()
    spiked[::50] += 30e-6
    made = inject(alone(time_s, spiked, to_world if with_attitude else None), "bias_jump", 1.0, 1)
    assert made.key["own_residual_nT"] == pytest.approx(1e9 * NOISE_T, rel=0.05)


@pytest.mark.parametrize("effect", sorted(set(INJECTED) - {"stale_samples", "scalar_heading_error"}))
def test_visible_size_is_what_another_fit_leaves(real, own_residual, effect):
    """The residual of an ellipsoid grows by the size that the key tells, as independent errors add."""
    time_s, readings, _ = real
    made = inject(alone(time_s, readings), effect, 3.0, 2)
    assert made.key["visible_nT"] == pytest.approx(300, rel=0.05)
    after = ellipsoid_residual(made.columns["readings_T"]).std()
    assert np.sqrt(after**2 - own_residual.std() ** 2) == pytest.approx(made.key["visible_nT"] * 1e-9, rel=0.1)


def test_visible_size_with_attitude_is_what_remains_of_the_vectors(real):
    """With attitude all three axes are redundant: a constant and matrices times the turned field take up the rest."""
    time_s, readings, to_world = real
    made = inject(alone(time_s, readings, to_world), "current_interference", 3.0, 3)
    features = np.column_stack([np.einsum("nji,j->ni", to_world, [18e-6, 3e-6, -44e-6]) * 1e5, np.ones(len(time_s))])
    change = made.columns["readings_T"][:, 0] - readings[:, 0]
    left = change - features @ np.linalg.lstsq(features, change, rcond=None)[0]
    assert np.sqrt((left**2).mean()) == pytest.approx(made.key["visible_nT"] * 1e-9, rel=0.03)


@pytest.mark.parametrize(
    ("effect", "channel"), [("temperature_drift", "temperature_C"), ("current_interference", "current_A")]
)
def test_the_channel_that_is_followed_is_made_up(real, effect, channel):
    """The readings change by the coefficient of the key with the column that is added; no other column is."""
    time_s, readings, to_world = real
    made = inject(alone(time_s, readings, to_world), effect, 10.0, 4)
    values = made.columns[channel]
    change = 1e9 * (made.columns["readings_T"] - readings)[:, 0]
    slopes = np.linalg.lstsq(np.column_stack([values, np.ones(len(values))]), change, rcond=None)[0][0]
    assert_allclose(slopes, list(made.key["coefficients"].values()), rtol=0.05)
    assert list(made.columns) == [channel, "readings_T"]


def test_a_late_axis_reads_what_was_there_before(real):
    """The one axis follows its own past by the delay of the key."""
    time_s, readings, to_world = real
    made = inject(alone(time_s, readings, to_world), "time_skew", 3.0, 5)
    ((name, delay_s),) = made.key["coefficients"].items()
    axis = "xyz".index(made.key["axes"][0])
    assert name == f"sensor 1 {made.key['axes'][0]} delay"
    change = (made.columns["readings_T"] - readings)[:, 0]
    clean = readings[:, 0, axis]
    expected = np.interp(time_s - delay_s, time_s, clean) - clean
    inner = slice(100, -100)
    assert np.corrcoef(change[inner, axis], expected[inner])[0, 1] > 0.9
    assert not np.delete(change, axis, axis=1).any()


def test_what_cannot_be_so_large_is_refused(real):
    """A repeated reading is wrong by what the field changes meanwhile, and no more."""
    time_s, readings, _ = real
    with pytest.raises(Refused, match="stale_samples cannot be 1000 times what this recording leaves by itself"):
        inject(alone(time_s, readings), "stale_samples", 1000.0, 1)


def test_what_lies_on_no_ellipsoid_is_refused(real):
    """A sensor that was not turned shows no field to size an effect by."""
    time_s, readings, _ = real
    rng = np.random.default_rng(2)
    with pytest.raises(Refused, match="lie on no ellipsoid"):
        inject(alone(time_s, 5e-5 + rng.normal(size=readings.shape) * 1e-8), "bias_jump", 1.0, 1)
    with pytest.raises(Refused, match="holds 20 samples"):
        inject(alone(time_s[:20], readings[:20]), "bias_jump", 1.0, 1)


@pytest.mark.parametrize(
    ("effect", "attitude"),
    [
        ("outliers", False),
        ("outliers", True),
        ("noise_excess", False),
        ("quantization", False),
        ("scalar_heading_error", False),
        ("scalar_heading_error", True),
    ],
)
def test_an_effect_in_the_scalar_changes_the_scalar_alone(cross, effect, attitude):
    """Of 6 draws some are in the scalar: those leave the sensors as they are, the others leave the scalar."""
    recorded = cross(attitude)
    places = set()
    for seed in range(6, 12):
        made = inject(recorded, effect, 3.0, seed)
        in_scalar = made.key["sensors"] == ["scalar"]
        assert (made.columns["scalar_T"] != recorded.scalar_T).any() == in_scalar
        assert (made.columns["readings_T"] != recorded.readings_T).any() != in_scalar
        places.add(in_scalar)
    assert True in places


@pytest.mark.parametrize("effect", ["bias_jump", "current_interference"])
def test_the_field_of_a_magnet_or_cable_reaches_the_scalar(cross, effect):
    """The scalar at the centre sees the field along its own, at least when the source is not at a sensor."""
    made = [inject(cross(False), effect, 3.0, seed) for seed in range(8)]
    change = [np.ptp(one.columns["scalar_T"] - cross(False).scalar_T) for one in made]
    assert max(change) > 1e-12
    magnets = [one.key["parameters"].get("magnet", True) for one in made]
    assert [one > 0 for one in change] == magnets


@pytest.mark.parametrize("effect", ["temperature_drift", "time_skew", "hysteresis", "saturation"])
def test_an_effect_within_a_sensor_leaves_the_scalar(cross, effect):
    """It cannot reach another instrument."""
    assert_allclose(inject(cross(False), effect, 3.0, 1).columns["scalar_T"], cross(False).scalar_T, rtol=0)


def test_a_field_that_varies_is_no_residual_where_the_scalar_follows_it(cross):
    """With a scalar the own residual is the noise, and gaps in the scalar stay gaps."""
    recorded = cross(False)
    slow = recorded.scalar_T.copy()
    slow[1::2] = np.nan
    for scalar in (recorded.scalar_T, slow):
        one = Recorded(recorded.time_s, recorded.readings_T, scalar, None, recorded.positions_m)
        made = inject(one, "geomagnetic_drift", 3.0, 1)
        assert made.key["own_residual_nT"] == pytest.approx(1.0, rel=0.1)
        assert_allclose(np.isnan(made.columns["scalar_T"]), np.isnan(scalar))


def test_without_a_scalar_its_error_is_refused(real):
    """There is nothing to disturb."""
    with pytest.raises(Refused, match="holds no scalar"):
        inject(alone(*real[:2]), "scalar_heading_error", 1.0, 1)
