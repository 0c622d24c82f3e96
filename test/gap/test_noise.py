"""Level, colour and spectrum of noises that are known."""

import numpy as np
import pytest
from coloured_noises import STEP_S, against_the_mean, found, shaped

from tam_calibration.core.interpolation import Correlation, interpolated
from tam_calibration.gap.noise import noise_of
from tam_calibration.gap.spectrum import spectra_of
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import LAGS, InterpolatedNoise


@pytest.mark.parametrize("count", [320, 2000])
def test_white_noise_is_white(count):
    """Of 120 rows none has a colour, and each level is within five of its standard errors."""
    generator = np.random.default_rng(count)
    for _ in range(10):
        for axis in found(generator.normal(size=(count, 12))):
            assert axis.colour == "white" and axis.band_hz is None and np.isnan(axis.knee_hz)
            assert abs(axis.level_T - 1e-9) < 5 * axis.level_error_T < 3.5e-10


def test_rows_are_those_of_sensors_and_axes():
    """Of two sensors x, y, z of the first come before those of the second; a lone row is the scalar."""
    generator = np.random.default_rng(0)
    names = [(axis.sensor, axis.axis) for axis in found(generator.normal(size=(400, 6)))]
    assert names == [(1, "x"), (1, "y"), (1, "z"), (2, "x"), (2, "y"), (2, "z")]
    (scalar,) = found(generator.normal(size=(400, 1)), np.eye(1))
    assert (scalar.sensor, scalar.axis) == (0, "")


def test_levels_are_told_apart():
    """A sensor with five times the noise of the others takes nothing of their accuracy."""
    levels = np.repeat([1.0, 1.0, 0.5, 5.0], 3)
    axes = found(levels * np.random.default_rng(1).normal(size=(4000, 12)))
    assert np.array([1e9 * axis.level_T for axis in axes]) / levels == pytest.approx(np.ones(12), rel=0.06)


def test_two_sensors_have_their_mean():
    """Of their difference both have the same part: the mean of their variances."""
    axes = found(np.repeat([1.0, 3.0], 3) * np.random.default_rng(2).normal(size=(4000, 6)))
    for one, other in zip(axes[:3], axes[3:], strict=True):
        assert one.level_T == pytest.approx(other.level_T, rel=1e-9) == pytest.approx(np.sqrt(5) * 1e-9, rel=0.05)


@pytest.mark.parametrize(
    ("kind", "colour"), [("flicker", "1/f"), ("walk", "1/f"), ("relaxing", "1/f"), ("band", "band")]
)
def test_the_colour_of_one_sensor_is_found(kind, colour):
    """A coloured part as large as the white one gives its sensor its colour, and the others none."""
    generator = np.random.default_rng(3)
    rows = generator.normal(size=(2000, 12))
    rows[:, 3:6] += np.column_stack([shaped(kind, 2000, generator) for _ in range(3)])
    axes = found(rows)
    assert [axis.colour for axis in axes] == 3 * ["white"] + 3 * [colour] + 6 * ["white"]
    levels = np.array([axis.level_T for axis in axes])
    assert levels == pytest.approx(1e-9 * rows.std(axis=0), rel=0.08)


@pytest.mark.parametrize(("kind", "exponent"), [("flicker", 1.0), ("walk", 2.0)])
def test_exponent_and_knee(kind, exponent):
    """The slow part equals the white one at the knee, and falls with its exponent."""
    generator = np.random.default_rng(4)
    axes = found(
        np.column_stack([generator.normal(size=8000) + shaped(kind, 8000, generator) for _ in range(6)]), np.eye(6)
    )
    assert np.mean([axis.exponent for axis in axes]) == pytest.approx(exponent, abs=0.15)
    for axis in axes:
        model = 2 * STEP_S * axis.white_T**2 * (1 + (axis.knee_hz / axis.frequency_hz) ** axis.exponent)
        assert np.mean(np.log(axis.density_T2_per_hz / model)) == pytest.approx(0, abs=0.1)
        assert axis.white_T == pytest.approx(1e-9, rel=0.05)


def test_the_band_is_where_it_lies():
    """Centre and half width of the resonance are 5 Hz and 0.5 Hz, its standard deviation that of the white noise."""
    generator = np.random.default_rng(5)
    (axis,) = found((generator.normal(size=8000) + shaped("band", 8000, generator))[:, None], np.eye(1))
    assert axis.band_hz == pytest.approx((4.5, 5.5), abs=0.2)
    assert (axis.band_T, axis.white_T) == (pytest.approx(1e-9, rel=0.1), pytest.approx(1e-9, rel=0.05))


def test_the_interval_of_the_spectrum_holds_the_density():
    """The density of white noise is within 95 % intervals in 95 % of the bands, all below that of Nyquist."""
    generator, inside = np.random.default_rng(6), []
    for _ in range(5):
        for axis in found(generator.normal(size=(2000, 12))):
            true = 2 * STEP_S * 1e-18
            inside.append((axis.density_low_T2_per_hz < true) & (true < axis.density_high_T2_per_hz))
            assert axis.frequency_hz[0] > 0 and axis.frequency_hz[-1] < 0.5 / STEP_S
    assert np.mean(inside) == pytest.approx(0.95, abs=0.025)


def test_excluded_samples_outliers_and_holes_do_not_matter():
    """With 5 % of the samples lost, 1 % outliers, stamps that jitter and a pause the noise is the same white one."""
    generator = np.random.default_rng(7)
    rows = generator.normal(size=(4000, 12))
    residual = rows @ against_the_mean(4).T
    residual[generator.random(4000) < 0.05, 2] = np.nan
    residual[generator.random(4000) < 0.01, 5] += 1000.0
    times = STEP_S * (np.arange(4000) + generator.uniform(-0.1, 0.1, 4000)) + 60.0 * (np.arange(4000) > 2500)
    axes = noise_of(times, 1e-9 * residual, against_the_mean(4))
    assert {axis.colour for axis in axes} == {"white"}
    assert [axis.level_T for axis in axes] == pytest.approx([1e-9] * 12, rel=0.06)


@pytest.fixture(scope="module")
def interpolated_rows():
    """Return rows (N, 6) of two sensors, those of the second between its readings, and what that makes of its noise."""
    generator, count = np.random.default_rng(10), 20_000
    read, asked = 10 * np.arange(count), 10 * np.arange(count) - 2
    rows = generator.normal(size=(count, 6))
    rows[:, 3] += 0.3 * shaped("band", count, generator)
    values, after, weight = interpolated(read, rows[:, 3:], asked)
    correlation = Correlation()
    correlation.add(after[after < count], weight)
    rows[:, 3:] = values
    return rows[5:], InterpolatedNoise(np.array([np.zeros(LAGS), correlation.values]), np.ones(2))


def test_interpolated_noise_has_the_colour_of_the_sensor(interpolated_rows):
    """Between the readings white noise has a colour of its own, which is not the sensor's; a band of it still is."""
    rows, made = interpolated_rows
    times = STEP_S * np.arange(len(rows))
    as_it_is = noise_of(times, 1e-9 * rows, np.eye(6))
    assert [axis.colour == "white" for axis in as_it_is] == [True] * 3 + [False] * 3
    told = noise_of(times, 1e-9 * rows, np.eye(6), made)
    assert [axis.colour for axis in told] == ["white"] * 3 + ["band"] + ["white"] * 2
    assert told[3].band_hz == pytest.approx((4.5, 5.5), abs=0.3)
    assert [axis.level_T for axis in told] == pytest.approx([1e-9] * 3 + [1.044e-9] + [1e-9] * 2, rel=0.02)


def test_rounding_is_white_noise():
    """Steps of 3 nT add a twelfth of their square to the variance."""
    rows = 3 * np.rint(np.random.default_rng(8).normal(size=(4000, 3)) * 2 / 3)
    for axis in found(rows, np.eye(3)):
        assert axis.colour == "white" and axis.level_T == pytest.approx(1e-9 * np.sqrt(4 + 9 / 12), rel=0.05)


def test_a_row_that_stands_still_has_no_noise():
    """Its level is nothing beside that of the others, and no number is missing."""
    rows = np.random.default_rng(9).normal(size=(400, 3)) * [1.0, 0.0, 1.0]
    axes = found(rows, np.eye(3))
    assert axes[1].level_T < 1e-4 * axes[0].level_T and np.isfinite(axes[1].level_error_T)


def test_too_few_samples_are_refused():
    """The sentence counts those that are left."""
    residual = np.full((100, 3), np.nan)
    residual[:10] = 0.0
    with pytest.raises(InputError, match="24 samples without gaps, and there are 10"):
        spectra_of(np.arange(100.0), residual, np.eye(3))


def test_a_constant_channel_has_no_noise():
    """Of Wu's turntable the scalar is one number: its noise is zero, without a warning."""
    assert spectra_of(np.arange(100.0), np.zeros((100, 1)), np.eye(1)).power_T2.max() < 1e-50
