"""States that are on in windows of time."""

import numpy as np
import pytest

from tam_calibration.effects.crosstalk import Crosstalk
from tam_calibration.effects.gain_switching import GainSwitching
from tam_calibration.effects.scale_step import ScaleStep
from tam_calibration.effects.switching import Level, windows_of

COUNT = 4000
EDGES = (300, 340, 900, 1400, 1450, 1500, 2800, 2830, 3600, 3700)


@pytest.mark.parametrize(
    ("shape", "windows"),
    [
        ({"time_s": 3.0}, {"on_1_s": 3.0}),
        ({"time_s": 3.0, "end_s": 5.0}, {"on_1_s": 3.0, "off_1_s": 5.0}),
        (
            {"late_x_s": 0.1, "on_1_s": 1.0, "off_1_s": 2.0, "on_2_s": 4.0},
            {"on_1_s": 1.0, "off_1_s": 2.0, "on_2_s": 4.0},
        ),
        ({"upper_T": 2e-5, "lower_T": 1e-5}, {}),
    ],
)
def test_the_windows_of_a_shape(shape, windows):
    """A step begins a window; what depends on readings has none."""
    assert windows_of(shape) == windows


@pytest.mark.parametrize(
    ("effect", "one", "two"),
    [(Crosstalk, 3, 3), (GainSwitching, 0, 1), (ScaleStep, 0, 0)],
)
def test_effects_in_the_windows_of_others(effect, one, two):
    """A channel along each axis may bleed; a gain switches in more than one window. No other effect has one alone."""
    windows = {"on_1_s": 1.0, "off_1_s": 2.0}
    assert len(effect().shapes_at({"time_s": 1.0, "end_s": 2.0})) == len(effect().shapes_at(windows)) == one
    assert len(effect().shapes_at({**windows, "on_2_s": 4.0})) == two
    assert list(effect().shapes_at({"late_x_s": 0.1})) == []


def level(states, size=2.0, noise=1.0, seed=2):
    """Return residuals that follow a wave by a level of two states, what a constant and the wave explain taken off."""
    generator = np.random.default_rng(seed)
    wave = np.sqrt(2) * np.cos(0.11 * np.arange(COUNT))
    shift = size * states * wave + noise * generator.normal(size=COUNT)
    held = np.column_stack([np.ones(COUNT), wave])
    return Level(shift - held @ np.linalg.lstsq(held, shift, rcond=None)[0], wave, np.ones(COUNT), held)


def windows(edges=EDGES):
    """Return where the state is on."""
    return np.isin(
        np.arange(COUNT), np.concatenate([np.arange(*pair) for pair in zip(edges[::2], edges[1::2], strict=True)])
    )


def test_windows_are_found_to_some_samples():
    """Each begins and ends where it did, within what the noise hides."""
    measured = level(windows())
    found = measured.settled(measured.start())
    assert len(found.windows) == 5
    assert np.abs(np.ravel(found.windows) - np.array(EDGES)).max() <= 12
    assert found.gain > measured.predicted()


def test_no_noise_leaves_no_doubt():
    """Edges are found to the sample, and the whole energy beyond one level is explained."""
    measured = level(windows(), noise=1e-6)
    found = measured.settled(measured.start())
    distance = np.abs(np.ravel(found.windows) - np.array(EDGES))
    assert distance.max() <= 1
    assert found.scale < 0.02


@pytest.mark.parametrize("noise", [1.0, 3.0])
def test_noise_has_no_windows(noise):
    """Whatever its size, chance pays for no change of state."""
    measured = level(np.zeros(COUNT), noise=noise)
    found = measured.settled(measured.start())
    assert found.windows == []


def test_a_slow_course_is_predicted_better():
    """A level that swings smoothly is no switching, though two states explain most of it."""
    measured = level(np.sin(np.arange(COUNT) / 100))
    found = measured.settled(measured.start())
    assert len(found.windows) >= 2
    assert found.gain < measured.predicted()


def test_the_rarer_state_is_the_window():
    """What is on nearly all the time is off in windows."""
    measured = level(~windows(EDGES[:4]))
    found = measured.settled(measured.start())
    assert np.abs(np.ravel(found.windows) - np.array(EDGES[:4])).max() <= 12


@pytest.mark.parametrize(("count", "is_switching"), [(1, False), (2, True), (3, True)])
def test_one_window_is_a_step(count, is_switching):
    """Two are what comes and goes."""
    states = windows(EDGES[: 2 * count])
    measured = level(states)
    assert measured.is_switching(measured.of(states)) == is_switching
