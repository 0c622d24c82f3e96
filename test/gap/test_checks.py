"""What departs from the twin is told with its figures, and noise alone departs as rarely as is said."""

import numpy as np
import pytest
from scipy import stats

from tam_calibration.gap.checks import LAGS, _kurtosis, checks_of
from tam_calibration.model.recording import LAGS as SHARED
from tam_calibration.model.recording import InterpolatedNoise

SAMPLES = 400
FLOOR_T = np.array([1e-9, 2e-9, 1e-9, 3e-10])


def directions(generator, count):
    """Return random unit vectors (N, 3)."""
    vectors = generator.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def checked(change=lambda noise, time, direction: noise, samples=SAMPLES, seed=1):
    """Return the checks of white noise of four rows at 10 Hz, after the first row was changed."""
    generator = np.random.default_rng(seed)
    time, direction = 0.1 * np.arange(samples), directions(generator, samples)
    noise = generator.normal(size=(samples, 4))
    noise[:, 0] = change(noise[:, 0], time, direction)
    return checks_of(time, direction, noise * FLOOR_T, FLOOR_T)


def test_noise_alone_departs_once_in_twenty_recordings():
    """Over 120 recordings of noise, any statistic of any row is out of its range in 5 % of them."""
    departing = sum(bool(checked(samples=150, seed=seed).departures) for seed in range(120))
    assert 0.01 < departing / 120 < 0.1


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("chi_square", lambda noise, *_: 1.5 * noise, "is larger than noise: χ²/n 2.2"),
        ("chi_square", lambda noise, *_: 0.6 * noise, "is smaller than noise: χ²/n 0.3"),
        (
            "lag_1_correlation",
            lambda noise, *_: (noise + np.roll(noise, 1)) / np.sqrt(2),
            "is correlated from sample to sample: lag-1 correlation 0.",
        ),
        (
            "lag_1_correlation",
            lambda noise, *_: (noise - np.roll(noise, 1)) / np.sqrt(2),
            "changes its sign from sample to sample: lag-1 correlation −0.",
        ),
        (
            "strongest_line",
            lambda noise, time, _: noise + 0.6 * np.sin(2 * np.pi * 3 * time),
            "has a line in its spectrum: at 3 Hz",
        ),
        (
            "part_of_direction",
            lambda noise, _, direction: noise + 6 * direction[:, 0] * direction[:, 1] * direction[:, 2],
            "goes with the direction of the field: ",
        ),
        (
            "excess_kurtosis",
            lambda noise, *_: np.where(np.arange(SAMPLES) == 100, 9.0, noise),
            "has far outliers: excess kurtosis ",
        ),
        ("excess_kurtosis", lambda noise, *_: np.sign(noise), "has shorter tails than noise: excess kurtosis −"),
    ],
)
def test_each_departure_is_found_and_said(name, change, words):
    """The statistic that is made for it is out of its range in the row that was changed, and a sentence says so."""
    checks = checked(change)
    assert checks.by_name[name].departs.tolist() == [True, False, False, False]
    assert np.flatnonzero(np.any([check.departs for check in checks.by_name.values()], axis=0)).tolist() == [0]
    assert any(sentence.startswith(f"The residual of sensor 1 x {words}") for sentence in checks.sentences)


def test_the_sentence_is_of_the_worst_row_and_counts_the_others():
    """One sentence a statistic."""
    noise = np.random.default_rng(1).normal(size=(SAMPLES, 4)) * [2, 1, 3, 1]
    checks = checks_of(0.1 * np.arange(SAMPLES), directions(np.random.default_rng(2), SAMPLES), noise, np.ones(4))
    (sentence,) = checks.sentences
    assert sentence.startswith("The residual of sensor 1 z is larger") and sentence.endswith("(axes alike: 1 more).")


def test_ranges_are_those_of_the_laws():
    """χ² of n, ± z/√n about -1/n, and an empirical kurtosis, each at the chance of one statistic of one row."""
    checks = checked()
    chance = 1 - 0.95 ** (1 / 20)
    low, high = stats.chi2.ppf([chance / 2, 1 - chance / 2], SAMPLES) / SAMPLES
    assert checks.by_name["chi_square"].low[0] == pytest.approx(low) and checks.by_name["chi_square"].high[
        0
    ] == pytest.approx(high)
    half = stats.norm.isf(chance / 2) / np.sqrt(SAMPLES)
    assert checks.by_name["lag_1_correlation"].high[0] == pytest.approx(half - 1 / SAMPLES)
    drawn = stats.kurtosis(np.random.default_rng(5).normal(size=(20_000, SAMPLES)), axis=1)
    found = checks.by_name["excess_kurtosis"]
    assert np.mean(drawn < found.low[0]) == pytest.approx(chance / 2, abs=chance / 2)
    assert np.mean(drawn > found.high[0]) == pytest.approx(chance / 2, abs=chance / 3)
    most = stats.beta.isf(chance, 15 / 2, (SAMPLES - 16) / 2)
    assert checks.by_name["part_of_direction"].high[0] == pytest.approx(most)


@pytest.mark.parametrize(("count", "power"), [(48, 1.3), (300, 1.3), (48, 0.5)])
def test_the_range_of_the_kurtosis_is_that_of_scipys_test(count, power):
    """At the chance that scipy gives a sample with long or short tails, its kurtosis is the end of the range."""
    noise = np.random.default_rng(3).normal(size=count)
    values = np.sign(noise) * np.abs(noise) ** power
    departure = stats.kurtosistest(values).statistic
    found, low, high = _kurtosis(values, 2 * stats.norm.sf(abs(departure)))
    assert (departure > 0) == (power > 1)
    assert found == pytest.approx(high if departure > 0 else low, rel=1e-9)


def test_the_autocorrelation_is_that_of_an_autoregressive_process():
    """0.8 to the power of the lag."""
    generator, values = np.random.default_rng(1), np.zeros(20_000)
    for index in range(1, len(values)):
        values[index] = 0.8 * values[index - 1] + generator.normal()
    rows = np.column_stack([values, values])
    checks = checks_of(np.arange(20_000.0), directions(generator, 20_000), rows, np.ones(2))
    assert checks.autocorrelation.shape == (2, 20) and LAGS == 20
    assert np.allclose(checks.autocorrelation[0], 0.8 ** np.arange(1, 21), atol=0.05)


def test_what_interpolation_makes_is_in_the_range():
    """Noise that is correlated from sample to sample by 0.4 departs, unless interpolation makes as much."""
    noise = np.random.default_rng(4).normal(size=(SAMPLES + 1, 1))
    rows = (0.89 * noise[1:] + 0.46 * noise[:-1]) * [1, 1, 1, 1]
    correlation = np.zeros((1, SHARED))
    correlation[0, 0] = 0.41
    direction = directions(np.random.default_rng(5), SAMPLES)
    for interpolated in (None, InterpolatedNoise(correlation, np.ones(1))):
        checks = checks_of(0.1 * np.arange(SAMPLES), direction, rows, np.ones(4), interpolated)
        assert checks.by_name["lag_1_correlation"].departs.all() == (interpolated is None)
        assert checks.by_name["lag_1_correlation"].low[0] < 0 < checks.by_name["lag_1_correlation"].high[0]


def test_the_range_of_the_lag_1_correlation_is_told_about_its_mean():
    """Of n samples -1/n, not zero."""
    checks = checked(lambda noise, *_: noise * (-1.0) ** np.arange(60) + np.where(np.arange(60) % 2, 4.0, -4.0), 60)
    half = stats.norm.isf((1 - 0.95 ** (1 / 20)) / 2) / np.sqrt(60)
    assert any(f"where noise has −{1 / 60:.2f} ± {half:.2f}." in sentence for sentence in checks.sentences)


def test_what_nothing_tells_does_not_depart():
    """A row that is missing, constant or known at 47 samples is not told; holes in another do no harm."""
    generator = np.random.default_rng(1)
    rows = generator.normal(size=(SAMPLES, 4))
    rows[:, 0], rows[47:, 1], rows[100:150, 2], rows[:, 3] = 0.0, np.nan, np.nan, np.nan
    checks = checks_of(0.1 * np.arange(SAMPLES), directions(generator, SAMPLES), rows, np.ones(4))
    assert checks.sentences == () and np.isfinite(checks.by_name["chi_square"].values).tolist() == [
        False,
        False,
        True,
        False,
    ]
    rows[:, 1] = np.where(np.arange(SAMPLES) < 48, -0.1 * np.arange(SAMPLES), np.nan)
    checks = checks_of(0.1 * np.arange(SAMPLES), directions(generator, SAMPLES), rows, np.ones(4))
    assert np.isfinite(checks.by_name["chi_square"].values[1])
