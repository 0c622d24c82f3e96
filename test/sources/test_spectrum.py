import numpy as np
import pytest

from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.sources.demodulation import Stretch, background_of, find_frequency

TIME_S = np.arange(2000) / 100
BACKGROUND = background_of(TIME_S)
AMPLITUDE = np.array([3.0, -1.2, 0.5])


def noisy(generator, frequency_hz, time_s=TIME_S):
    """Return three channels with a line, noise of one and a drift of hundreds."""
    line = np.outer(np.sin(2 * np.pi * frequency_hz * time_s + 1), AMPLITUDE)
    return line + np.outer(time_s, [30.0, -20.0, 5.0]) + generator.normal(size=line.shape)


def test_frequency_is_found_to_its_standard_error():
    """Wherever it lies between the bins of the periodogram, with times that are not even."""
    generator = np.random.default_rng(51)
    time = np.sort(TIME_S + 0.002 * generator.uniform(-1, 1, 2000))
    pulls = []
    for frequency in generator.uniform(8, 12, 60):
        found = find_frequency(Stretch(time, noisy(generator, frequency, time), background_of(time)), 2, 40)
        pulls.append((found.peak_hz - frequency) / found.peak_standard_error_hz)
    assert np.mean(np.square(pulls)) == pytest.approx(1, abs=0.5)


def test_power_of_noise_is_one_and_rarely_passes_the_threshold():
    """Of 100 records of noise alone one at most shows a line, where one in a thousand may."""
    generator = np.random.default_rng(52)
    refused = 0
    for _ in range(100):
        try:
            find_frequency(Stretch(TIME_S, generator.normal(size=(2000, 3)), BACKGROUND), 2, 40)
        except Refused as problem:
            refused += "no line exceeds" in str(problem)
    assert refused >= 99
    found = find_frequency(Stretch(TIME_S, noisy(generator, 10.0), BACKGROUND), 2, 40)
    assert np.median(found.power) == pytest.approx(0.9, abs=0.1)
    assert found.frequency_hz[found.power.argmax()] == pytest.approx(10, abs=0.05)


@pytest.mark.parametrize(
    "bounds",
    [(60, 70), (0.01, 1)],
)
def test_bounds_outside_the_record_are_refused(bounds):
    """Each with what the record allows."""
    with pytest.raises(InputError, match="contains no frequency"):
        find_frequency(Stretch(TIME_S, np.ones((2000, 1)), BACKGROUND), *bounds)
