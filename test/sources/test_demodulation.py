import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.simulation.conditions import Manoeuvre
from tam_calibration.sources.demodulation import Stretch, background_of, demodulate, turning_of, without

TIME_S = np.arange(2000) / 100
ATTITUDE = Manoeuvre(0.5, 0.5, 20.0).attitudes(TIME_S, np.random.default_rng(0))
BACKGROUND = background_of(TIME_S, ATTITUDE)
CARRIER = np.sin(2 * np.pi * 10 * (TIME_S - TIME_S[[0, -1]].mean()) + 0.7)
AMPLITUDE = 1e-9 * np.array([30.0, -12, 5, 20, 5, -7, 9, 3])
NOISE = 1e-9 * np.array([0.5] * 3 + [3.0] * 5)
EARTH = np.array([1e-6, 2e-5, -4.5e-5])


def earth():
    """Return what eight channels of an uncalibrated, turning platform read of the Earth's field, with a drift."""
    generator = np.random.default_rng(41)
    field = Rotation.from_quat(ATTITUDE).inv().apply(EARTH)
    drift = np.outer(np.sin(2 * np.pi * TIME_S / 60), 1e-8 * generator.normal(size=8))
    return field @ generator.normal(size=(3, 8)) + 1e-6 * generator.normal(size=8) + drift


def test_amplitudes_have_their_signs_and_nothing_of_the_background():
    """Without noise they come out to a thousandth of a picotesla under 50 µT that turn."""
    found = demodulate(Stretch(TIME_S, earth() + np.outer(CARRIER, AMPLITUDE), background_of(TIME_S, ATTITUDE)), 10.0)
    sign = np.sign(found.amplitude[0])
    assert_allclose(sign * found.amplitude, AMPLITUDE, atol=1e-13)
    assert found.phase == pytest.approx(0.7, abs=1e-4)


@pytest.mark.parametrize("rests_in", ["array", "world"])
def test_error_is_the_standard_error_and_that_of_the_noise_alone(rests_in):
    """σ √(2/N): neither background nor rotation cost anything that counts."""
    generator = np.random.default_rng(42)
    turning = None if rests_in == "array" else turning_of(ATTITUDE)
    signal = CARRIER[:, None] * (AMPLITUDE if turning is None else turning @ AMPLITUDE)
    pulls, coherence = [], []
    for _ in range(100):
        channels = earth() + signal + NOISE * generator.normal(size=(2000, 8))
        found = demodulate(Stretch(TIME_S, channels, BACKGROUND, turning), 10.0)
        pulls.append((found.amplitude - AMPLITUDE) / found.standard_errors)
        coherence.append(found.out_of_phase)
    assert np.mean(np.square(pulls)) == pytest.approx(1, abs=0.15)
    assert np.mean(coherence) == pytest.approx(1, abs=0.2)
    if turning is None:
        assert_allclose(found.standard_errors, NOISE * np.sqrt(2 / 2000), rtol=0.06)
        assert_allclose(found.noise, NOISE, rtol=0.06)


def test_uneven_times_are_no_trouble():
    """A third of the samples lost at random."""
    kept = np.random.default_rng(43).random(2000) > 1 / 3
    time = TIME_S[kept]
    carrier = np.sin(2 * np.pi * 10 * (time - time[[0, -1]].mean()) + 0.7)
    found = demodulate(Stretch(time, np.outer(carrier, AMPLITUDE), background_of(time)), 10.0)
    assert_allclose(found.amplitude, AMPLITUDE, atol=1e-18)


def test_world_amplitudes_of_field_and_gradient_turn_with_the_platform():
    """Field and tensor of the world, turned by the rotation, are what the matrices of the turning give."""
    turning = turning_of(ATTITUDE[:5])
    for matrix, turned in zip(Rotation.from_quat(ATTITUDE[:5]).as_matrix(), turning @ AMPLITUDE, strict=True):
        xx, xy, xz, yy, yz = AMPLITUDE[3:]
        tensor = matrix.T @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, -xx - yy]]) @ matrix
        assert_allclose(turned[:3], matrix.T @ AMPLITUDE[:3])
        assert_allclose(turned[3:], tensor[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]], atol=1e-22)


def test_two_sources_out_of_phase_are_told():
    """No common phase fits: the channels' amplitudes at right angles to it are many standard errors."""
    second = np.cos(2 * np.pi * 10 * (TIME_S - TIME_S[[0, -1]].mean()))
    noise = NOISE * np.random.default_rng(44).normal(size=(2000, 8))
    channels = np.outer(CARRIER, AMPLITUDE) + np.outer(second, AMPLITUDE[::-1]) + noise
    assert demodulate(Stretch(TIME_S, channels, background_of(TIME_S)), 10.0).out_of_phase > 100


def test_background_is_orthonormal_and_takes_cubics_and_rotation():
    """Nothing is left of a cubic, nor of what a turning platform reads of a uniform field."""
    cubic = np.polynomial.Polynomial([3.0, -1.0, 0.2, 0.1])(TIME_S)[:, None]
    turned = Rotation.from_quat(ATTITUDE).inv().apply(EARTH)
    assert_allclose(without(background_of(TIME_S), cubic), 0.0, atol=1e-11 * np.ptp(cubic))
    assert_allclose(without(BACKGROUND, turned), 0.0, atol=1e-12 * np.ptp(turned))
    assert_allclose(BACKGROUND.T @ BACKGROUND, np.eye(BACKGROUND.shape[1]), atol=1e-12)


def silent(background):
    """Return channels of nothing."""
    return Stretch(TIME_S, np.zeros((2000, 3)), background)


TURNING_AT_1_HZ = Rotation.from_euler("z", 2 * np.pi * TIME_S[:, None]).as_quat()


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: demodulate(silent(BACKGROUND), 0.01), InputError, "one period"),
        (lambda: demodulate(silent(BACKGROUND), 60.0), InputError, "cannot be told"),
        (
            lambda: demodulate(silent(background_of(TIME_S, TURNING_AT_1_HZ)), 1.0),
            Refused,
            "the signal itself",
        ),
        (lambda: background_of(TIME_S[:4]), InputError, "too few"),
        (lambda: background_of(TIME_S[:1]), InputError, "too few"),
    ],
)
def test_what_cannot_be_demodulated_is_refused(call, error, message):
    """Periods, rates and backgrounds that leave nothing."""
    with pytest.raises(error, match=message):
        call()
