"""What no cause explains is told as it was planted: how much, in which row, when, and what it follows."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.gap.remainder import _largest_row, describe, growth_with_rate, period_of, residue_of
from tam_calibration.gap.result import Where
from tam_calibration.gap.search import Search
from tam_calibration.gap.size import measure, rivals


def described(made, verdict="unexplained"):
    """Return the words on a run of which nothing is explained."""
    model = made.model()
    unknown = tuple(rivals(model.base()))
    found = Search(model, model, (), (), unknown, unknown, ())
    residue = residue_of(model, model, model.channels(), 1.0)
    size = measure(model, model, 1.0)
    return describe(found, verdict, replace(size, closed=0.73), residue, 1.0)


def drift(made):
    """Return 6 nT with a period of 18 s."""
    return 6e-9 * np.sin(2 * np.pi * made.recording.time_s / 18)


def test_a_drift_is_told_with_its_place_and_time_scale(run):
    """Sensor, axis, band, and how long one swing takes."""
    words = described(run(700).with_row(4, drift(run(700))))
    assert words.startswith("All of the gap is open: ") and "It lies in sensor 2 y, at 0.0" in words
    assert "It drifts over seconds (one swing in about 20 seconds)." in words


def test_what_is_left_beside_causes_has_its_share(run):
    """One less what is closed."""
    words = described(run(700).with_row(4, drift(run(700))), "partly_explained")
    assert words.startswith("27 % of the gap's energy is open: ")


def test_a_scalar_that_drifts_is_named(run):
    """The scalar magnetometer is a place too."""
    assert "It lies in the scalar magnetometer" in described(run(700).with_row(12, drift(run(700))))


def test_what_follows_the_motion_is_told_so(run):
    """The attitude, and the rate of the field."""
    made = run(700)
    field = made.errors.restore(made.recording.readings_T).mean(axis=1)
    x, y, z = (field / np.linalg.norm(field, axis=1)[:, None]).T
    assert "It follows the attitude" in described(made.with_row(7, 10e-9 * np.tanh(3 * x * y) * z))
    rate = np.gradient(x, made.recording.time_s)
    assert "It follows the rate of the field" in described(made.with_row(7, 5e-9 * rate))


def test_white_noise_is_told_so(run):
    """In one axis, without a course."""
    made = run(700)
    words = described(made.with_row(7, 3e-9 * np.random.default_rng(2).normal(size=700)))
    assert "It lies in sensor 3 y" in words and words.endswith(
        "It is white: no sample tells the next, and turning does not matter."
    )


@pytest.mark.parametrize("verdict", ["no_gap", "explained", "not_identifiable"])
def test_nothing_open_has_no_words(run, verdict):
    """The verdict leaves nothing open."""
    assert described(run(200), verdict) == ""


@pytest.mark.parametrize("period_s", [0.5, 12.0, 300.0])
def test_the_period_is_that_of_a_swing_in_noise(period_s):
    """Within a tenth; with holes in the record too."""
    time = 0.1 * np.arange(12_000)
    values = np.random.default_rng(1).normal(size=12_000) + np.sin(2 * np.pi * time / period_s)
    assert period_of(values, 0.1) == pytest.approx(period_s, rel=0.1)
    values[::7] = np.nan
    assert period_of(values, 0.1) == pytest.approx(period_s, rel=0.1)


def test_noise_that_grows_with_turning_is_told_by_how_much():
    """Twice as large at the rates above the median; and no growth in even noise, at rest, or where it shrinks."""
    generator = np.random.default_rng(1)
    rate, noise = generator.uniform(0, 1, 2000), generator.normal(size=2000)
    assert growth_with_rate(noise * np.where(rate > 0.5, 2, 1), rate) == pytest.approx(2, rel=0.1)
    assert growth_with_rate(noise, rate) is None
    assert growth_with_rate(noise * np.where(rate > 0.5, 1, 2), rate) is None
    assert growth_with_rate(noise, np.zeros(2000)) is None


@pytest.mark.parametrize(("slow", "period_s"), [(0.4, 10.0), (0.6, 100.0)])
def test_half_of_the_energy_is_slower_than_the_period(slow, period_s):
    """Of two swings, of 10 and 100 s, the slower one's counts where it has more than half."""
    time = 0.1 * np.arange(10_000)
    swings = np.sqrt(slow) * np.sin(2 * np.pi * time / 100) + np.sqrt(1 - slow) * np.sin(2 * np.pi * time / 10)
    values = 10 * swings + np.random.default_rng(3).normal(size=10_000)
    assert period_of(values, 0.1) == pytest.approx(period_s, rel=0.01)


@pytest.mark.parametrize(
    ("sensors", "axes", "row"),
    [((2,), (), 4), ((2,), ("z",), 5), ((1, 2), ("x",), 3), ((), (), 6), (("scalar",), ("x",), 6), ((1,), (), 1)],
)
def test_the_largest_row_is_of_the_place(sensors, axes, row):
    """Of all axes where none is named, of all rows where no sensor is; unknown samples count for nothing."""
    rows = np.tile([0.5, 1.0, 0.1, 2.0, 4.0, 3.0, 5.0], (9, 1))
    rows[0] = np.nan
    assert _largest_row(Where(sensors, axes, None, None, {}), rows) == row
