"""What a simulation lacks, and noise of a stated density, are added alike to arriving samples and whole recordings."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mends import EFFECTS, fitted, mend_of, run_of
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import welch

from tam_calibration.comparison import additions
from tam_calibration.comparison import mend as mend_module
from tam_calibration.comparison.additions import Additions, NoiseStream, mended
from tam_calibration.comparison.mend import Mend, NoiseTerm, slow_modes
from tam_calibration.effects.library import installed_effects
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError

NOISE = (
    NoiseTerm(1, "x", 1e-9, 2e-9, knee_hz=1.0, exponent=1.0),
    NoiseTerm(3, "z", 1e-9, 0.0, band_hz=(4.0, 5.0), band_T=2e-9),
    NoiseTerm(0, "", 1e-10, 1e-10),
)
OF_THE_COURSE = {"crosstalk", "eddy_current", "platform_field", "ringing", "time_skew"}
STREAMED = sorted(EFFECTS.keys() - {"interpolated_samples"})


@pytest.fixture(scope="module")
def run():
    """Return 300 samples with every channel."""
    return run_of(300)


@pytest.fixture(scope="module")
def mend(run):
    """Return a mend that adds nothing."""
    return mend_of(run)


def rows(recording):
    """Return readings and scalar, (N, 3K + 1)."""
    return np.column_stack([recording.readings_T.reshape(recording.sample_count, -1), recording.scalar_T])


def as_it_comes(add, run, cuts=()):
    """Return the rows that the samples of a run become, split where stated."""
    channels = (run.readings_T, run.time_s, run.scalar_T, run.temperature_C, run.current_A, run.attitude)
    parts = [add(*batch) for batch in zip(*(np.split(channel, cuts) for channel in channels), strict=True)]
    return np.concatenate([np.column_stack([made.reshape(len(made), -1), scalar]) for made, scalar in parts])


def adding(mend, *names):
    """Return the mend with effects."""
    return replace(mend, added=tuple(EFFECTS[name] for name in names))


def test_every_effect_is_tried():
    """None of the library is left out."""
    ours = {name for name, one in installed_effects().items() if type(one).__module__.startswith("tam_calibration.")}
    assert ours == EFFECTS.keys()


@pytest.mark.parametrize("name", STREAMED)
def test_batches_change_no_number(run, mend, name):
    """Sample by sample, in batches and at once are the same, each effect with noise."""
    own = replace(adding(mend, name), noise=NOISE)
    short = run.take(slice(30))
    whole = as_it_comes(Additions(own, 5), short)
    for cuts in (range(1, 30), [1, 2, 20]):
        assert_allclose(as_it_comes(Additions(own, 5), short, cuts), whole, rtol=0, atol=1e-17)


@pytest.fixture(scope="module")
def all_together(run, mend):
    """Return a function of batches that gives the rows with all effects and noise."""
    own, short = replace(adding(mend, *STREAMED), noise=NOISE), run.take(slice(60))
    return cache(lambda cuts=(): as_it_comes(Additions(own, 1), short, cuts))


@settings(max_examples=4)
@given(cuts=st.sets(st.integers(1, 59), max_size=6))
def test_any_split_of_all_effects_together(all_together, cuts):
    """Whatever the batches, all effects at once and the noise give the same readings."""
    difference = np.abs(all_together(tuple(sorted(cuts))) - all_together())
    # Where a value lies between two steps of the converter, its last bit decides.
    assert np.mean(difference > 1e-15) < 0.01


@pytest.mark.parametrize("name", sorted(set(STREAMED) - {"timing_jitter"} - OF_THE_COURSE))
def test_samples_as_they_come_are_those_of_the_whole(run, mend, name):
    """What follows from the past is the same in both, noise and random effects included."""
    own = replace(adding(mend, name), noise=NOISE)
    assert_allclose(as_it_comes(Additions(own, 2), run, [7, 100]), rows(mended(run, own, 2)), rtol=0, atol=1e-17)
    assert np.abs(rows(mended(run, adding(mend, name), 2)) - rows(run)).max() > 1e-9


@pytest.mark.parametrize("name", sorted(OF_THE_COURSE))
def test_the_field_to_come_is_foretold(mend, name):
    """Without knowing what comes, an effect of the field's course is that of the whole to a fiftieth."""
    slow = run_of(200, rate_hz=60.0, array=Array.cross(0.5, 1e-11, 1e-12))
    expected = rows(mended(slow, adding(mend, name), 0)) - rows(slow)
    made = as_it_comes(Additions(adding(mend, name)), slow) - rows(slow)
    started = slice(20, None)  # the first samples have no past
    assert np.sqrt(np.mean((made - expected)[started] ** 2)) < 0.02 * np.sqrt(np.mean(expected[started] ** 2))


def test_the_rate_of_change_has_little_noise(run, mend):
    """Noise of the readings comes into a delay about as into a central difference: 1.5 times, not 4 or 20."""
    quiet, noisy = (run_of(300, rate_hz=60.0, array=Array.cross(0.5, size, 1e-12)) for size in (1e-12, 1e-8))
    late = replace(mend, added=(fitted("time_skew", {}, 2, None, "delay", {"delay": 1 / 60}),))
    spread = [
        np.std(made(noisy) - rows(noisy) - made(quiet) + rows(quiet), axis=0)[6:9].mean()
        for made in (lambda one: as_it_comes(Additions(late), one), lambda one: rows(mended(one, late, 0)))
    ]
    assert spread[0] < 1.8 * spread[1]


@pytest.fixture(scope="module")
def error_of_delay(mend):
    """Return a function that gives the error of a delay that is added as the samples of a fast turn come, tesla."""
    fast = run_of(300, rate_hz=15.0, array=Array.cross(0.5, 3e-7, 1e-12))
    late = replace(mend, added=(fitted("time_skew", {}, 2, None, "delay", {"delay": 0.03}),))
    whole = rows(mended(fast, late, 0))
    return lambda: np.sqrt(np.mean((as_it_comes(Additions(late), fast) - whole)[30:] ** 2))


@pytest.fixture(scope="module")
def least_error(error_of_delay):
    """Return it with the polynomials as they are."""
    return error_of_delay()


@pytest.mark.parametrize(("name", "value"), [("_FITTED", 6), ("_FITTED", 24), ("_DEGREE", 2), ("_DEGREE", 6)])
def test_other_polynomials_are_worse(error_of_delay, least_error, monkeypatch, name, value):
    """Fewer samples or a higher degree have more noise, more samples or a lower degree do not follow the turns."""
    monkeypatch.setattr(additions, name, value)
    assert error_of_delay() > least_error


@pytest.mark.parametrize("name", ["outliers", "stale_samples"])
def test_as_many_samples_are_struck_as_stated(name):
    """Of samples that arrive those in bursts are the stated part, but for those of two bursts at once."""
    many = run_of(8000)
    own = adding(mend_of(many.take(slice(300))), name)
    struck = np.any(as_it_comes(Additions(own, 1), many, [3000]) != rows(many), axis=1)
    (part,) = EFFECTS[name].contributions
    starts = np.flatnonzero(np.diff(struck.astype(int)) > 0)
    error = np.sqrt(len(starts)) * part.values["burst"] / len(struck)
    assert struck.mean() == pytest.approx(part.values["rate"], abs=3 * error)


def test_jitter_is_as_large(run, mend):
    """The scatter of a sensor in motion is that of the whole recording."""
    own = adding(mend, "timing_jitter")
    sizes = [made - rows(run) for made in (as_it_comes(Additions(own, 1), run), rows(mended(run, own, 1)))]
    assert sizes[0][:, :3].std() == pytest.approx(sizes[1][:, :3].std(), rel=0.15)
    assert_array_equal(sizes[0][:, 3:], 0)


def test_late_packets_hold_what_was_read_before(run, mend):
    """Each struck reading of that sensor is the one of two samples before, in batches shorter than that too."""
    late = fitted("stale_samples", {}, 1, None, "late", {"rate": 0.3, "burst": 3.0, "samples late": 2.0})
    made = as_it_comes(Additions(replace(mend, added=(late,))), run, list(range(1, 300)))[:, 3:6]
    own = rows(run)[:, 3:6]
    struck = np.any(made != own, axis=1)
    assert 40 < struck[2:].sum() < 130
    assert_array_equal(made[2:][struck[2:]], own[:-2][struck[2:]])


def test_a_single_sample_and_a_batch_of_one(run, mend):
    """(K, 3) with plain numbers is a batch of one, and keeps its shape."""
    own = replace(adding(mend, "temperature_drift"), noise=NOISE)
    single, scalar = Additions(own)(run.readings_T[0], 0.0, 5e-5, temperature_C=25.0)
    batch, _ = Additions(own)(run.readings_T[:1], np.zeros(1), np.full(1, 5e-5), temperature_C=np.full(1, 25.0))
    assert single.shape == (4, 3) and scalar.shape == (1,)
    assert_array_equal(single, batch[0])
    assert Additions(own)(run.readings_T[0], 0.0, temperature_C=25.0)[1] is None


def test_a_jump_is_at_its_time_in_each_run(run, mend):
    """What happens at a time of the simulation happens again after a reset."""
    own = adding(mend, "bias_jump")
    add = Additions(own)
    for made in (as_it_comes(add, run), as_it_comes(add, run), rows(mended(run, own, 1))):
        assert_allclose(made[:, 2] - rows(run)[:, 2], np.where(run.time_s >= 9.0, 27e-9, 0), atol=1e-18)


def test_a_clock_of_its_own_moves_no_effect(run, mend):
    """Times count from the first sample: a run stamped in seconds of this century gets the same, batch by batch too."""
    mend = adding(mend, "bias_jump", "geomagnetic_drift")
    later = replace(run, time_s=run.time_s + 1.7e9)
    by_run, by_later = (mended(one, mend, 1).readings_T for one in (run, later))
    np.testing.assert_allclose(by_later, by_run, atol=1e-14)
    one, other = Additions(mend, 1), Additions(mend, 1)
    np.testing.assert_allclose(as_it_comes(one, later, (100,)), as_it_comes(other, run, (100,)), atol=1e-14)


def test_another_run_has_other_noise(run, mend):
    """After a reset the noise is not that of the first run, and another seed has another."""
    add = Additions(replace(mend, noise=NOISE), 1)
    first, again = as_it_comes(add, run), as_it_comes(add, run)
    other = as_it_comes(Additions(replace(mend, noise=NOISE), 2), run)
    assert np.all(first[:, 0] != again[:, 0]) and np.all(first[:, 0] != other[:, 0])
    assert_array_equal(first, as_it_comes(Additions(replace(mend, noise=NOISE), 1), run))


def test_errors_of_the_simulation_are_seen_through(run, mend, true_errors):
    """An effect follows the field, not the readings, where the errors of the simulation's sensors are given."""
    own = adding(mend, "scalar_heading_error")
    straight = replace(run, readings_T=np.repeat(run.readings_T.mean(axis=1, keepdims=True), 4, axis=1))
    crooked = replace(run, readings_T=true_errors.distort(straight.readings_T[:, 0]))
    expected = mended(straight, own, 0).scalar_T
    assert_allclose(mended(crooked, own, 0, true_errors).scalar_T, expected, rtol=0, atol=1e-15)
    assert np.abs(mended(crooked, own, 0).scalar_T - expected).max() > 1e-11


def test_holes_of_channels_and_a_silent_scalar(run, mend):
    """A whole recording may have holes; where the scalar is silent nothing is added."""
    temperature, scalar = run.temperature_C.copy(), run.scalar_T.copy()
    temperature[10:20], scalar[50:80] = np.nan, np.nan
    holed = replace(run, temperature_C=temperature, scalar_T=scalar)
    made = mended(holed, replace(adding(mend, "temperature_drift", "outliers"), noise=NOISE), 1)
    assert np.isfinite(made.readings_T).all()
    assert_array_equal(np.isnan(made.scalar_T), np.isnan(scalar))
    assert_array_equal(made.temperature_C, temperature)


def test_bad_input_is_one_sentence(run, mend):
    """What cannot be added is told by name."""
    with pytest.raises(InputError, match="interpolated_samples cannot be added to samples as they arrive"):
        Additions(adding(mend, "interpolated_samples"))
    with pytest.raises(InputError, match="temperature_drift follows the temperature: give temperature_C of the sim"):
        Additions(adding(mend, "temperature_drift"))(run.readings_T, run.time_s)
    with pytest.raises(InputError, match="the simulation has 2 sensors, and the mend is of 4"):
        Additions(mend)(run.readings_T[:, :2], run.time_s)
    with pytest.raises(InputError, match="needs the value 'standard deviation'"):
        Additions(replace(mend, added=(fitted("noise_excess", {}, 0, 0, "noise", {}),)))(run.readings_T, run.time_s)
    with pytest.raises(InputError, match="needs the value 'rate'"):
        Additions(replace(mend, added=(fitted("outliers", {}, 0, 0, "spikes", {}),)))(run.readings_T, run.time_s)
    with pytest.raises(InputError, match="noise_excess acts on a sensor beyond the 4"):
        wrong = fitted("noise_excess", {}, 4, 0, "noise", {"standard deviation": 1e-9})
        mended(run, replace(mend, added=(wrong,)), 0)


RATE_HZ, SPAN_S, WHITE_T, KNEE_HZ = 50.0, 120.0, 1e-9, 2.0
SLOW = NoiseTerm(1, "y", WHITE_T, WHITE_T, KNEE_HZ, 1.0)
BAND = NoiseTerm(2, "z", WHITE_T, 0.0, band_hz=(9.0, 11.0), band_T=3e-9)
SCALAR = NoiseTerm(0, "", WHITE_T, 0.5e-9)


def mend_with(*terms):
    """Return a mend with noise of two sensors and the scalar."""
    return Mend((), (), terms, SimpleNamespace(array=Array(np.zeros((2, 3))), time_span_s=(0.0, SPAN_S)), RATE_HZ)


def drawn(terms, samples, seed=1, step_s=1 / RATE_HZ):
    """Return noise (N, 7) of two sensors and the scalar."""
    return NoiseStream(mend_with(*terms), np.random.default_rng(seed)).drawn(step_s * np.arange(samples))


def density_error(exponent):
    """Return the largest relative error of the density of white and slow noise together."""
    constants_s, variances_T2 = slow_modes(mend_with(), NoiseTerm(1, "x", WHITE_T, 0.0, KNEE_HZ, exponent))
    frequency = np.geomspace(1 / SPAN_S, RATE_HZ / 2, 400)
    decay = np.exp(-1 / (RATE_HZ * constants_s))
    transfer = 1 / np.abs(1 - decay * np.exp(-2j * np.pi * frequency / RATE_HZ)[:, None]) ** 2
    slow = 2 / RATE_HZ * transfer @ (variances_T2 * (1 - decay**2))
    white = 2 * WHITE_T**2 / RATE_HZ
    return np.abs((white + slow) / (white * (1 + (KNEE_HZ / frequency) ** exponent)) - 1).max()


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.5, 2.0])
def test_the_modes_have_the_density(exponent):
    """To a fiftieth at all frequencies that the recording showed; random walk, of one mode, to a twentieth."""
    assert density_error(exponent) < (0.05 if exponent == 2 else 0.02)


@pytest.mark.parametrize(("name", "value"), [("_PER_DECADE", 1), ("_FREQUENCIES", 8)])
def test_fewer_modes_or_frequencies_would_miss_it(monkeypatch, name, value):
    """The constants are as small as they can be, by a factor of a few."""
    monkeypatch.setattr(mend_module, name, value)
    assert max(density_error(exponent) for exponent in (0.5, 1.0, 1.5)) > 0.02


def test_what_is_drawn_has_the_density():
    """Averaged over many samples, the spectrum of the draw is white noise with a slow one."""
    frequency, density = welch(drawn([SLOW], 200_000)[:, 1], RATE_HZ, nperseg=3000)
    seen = (frequency > 0.1) & (frequency < 0.98 * RATE_HZ / 2)
    expected = 2 * WHITE_T**2 / RATE_HZ * (1 + KNEE_HZ / frequency[seen])
    ratio = density[seen] / expected
    assert np.mean(ratio) == pytest.approx(1, abs=0.02)
    assert np.mean(ratio[:60]) == pytest.approx(1, abs=0.08)


def test_a_band_is_where_and_as_large_as_stated():
    """Its variance is the stated one, half of it between the limits of the band, and nothing is elsewhere."""
    noise = drawn([BAND], 200_000)
    frequency, density = welch(noise[:, 5], RATE_HZ, nperseg=2000)
    assert noise[:, 5].std() == pytest.approx(3e-9, rel=0.02)
    inside = (frequency >= 9) & (frequency <= 11)
    assert density[inside].sum() / density.sum() == pytest.approx(0.5, abs=0.03)
    assert frequency[np.argmax(density)] == pytest.approx(10, abs=0.5)
    assert_array_equal(np.delete(noise, 5, axis=1), 0)


@pytest.mark.parametrize("limits_hz", [(9.0, 11.0), (3.5, 6.5), (13.0, 16.0)])
def test_a_band_is_an_autoregressive_process(limits_hz):
    """It has the density of the AR(2) process with its poles, from low frequencies on, a wide band too."""
    low, high = limits_hz
    noise = drawn([NoiseTerm(2, "z", WHITE_T, 0.0, band_hz=limits_hz, band_T=3e-9)], 300_000)[:, 5]
    frequency, density = welch(noise, RATE_HZ, nperseg=500)
    pole = np.exp(-np.pi * (high - low + 1j * (high + low)) / RATE_HZ)
    turn = np.exp(-2j * np.pi * frequency / RATE_HZ)
    expected = np.abs((1 - pole * turn) * (1 - pole.conj() * turn)) ** -2.0
    expected *= noise.var() / (expected.sum() * frequency[1])
    assert np.abs(density[3:-3] / expected[3:-3] - 1).max() < 0.2
    assert np.mean(density[3:20] / expected[3:20]) == pytest.approx(1, abs=0.05)


def test_white_noise_of_the_scalar():
    """What is added is the missing part, and it is in the last row."""
    noise = drawn([SCALAR], 40_000)
    assert noise[:, 6].std() == pytest.approx(0.5e-9, rel=0.02)
    assert np.corrcoef(noise[1:, 6], noise[:-1, 6])[0, 1] == pytest.approx(0, abs=0.02)


def test_slow_noise_is_the_same_at_another_rate():
    """A simulation that samples ten times as often has the same slow noise: its size does not change."""
    slow_only = NoiseTerm(1, "x", WHITE_T, 0.0, KNEE_HZ, 1.0)
    sizes = [
        np.mean([drawn([slow_only], 200 * often, seed, 0.02 / often)[:, 0].var() for seed in range(100)])
        for often in (1, 10)
    ]
    assert sizes[1] == pytest.approx(sizes[0], rel=0.15)


def test_a_single_mode_comes_nearest():
    """What simulators hold is one process: of white noise on a random walk it is all, to a hundredth."""
    walk = NoiseTerm(1, "x", WHITE_T, 0.0, 0.1, 2.0)
    (_, alone_T2), (_, all_T2) = slow_modes(mend_with(), walk, True), slow_modes(mend_with(), walk)
    assert alone_T2.sum() == pytest.approx(all_T2.sum(), rel=0.05)
    assert [len(each) for each in slow_modes(mend_with(), SLOW, True)] == [1, 1]
    assert [len(each) for each in slow_modes(mend_with(), SCALAR)] == [0, 0]


def test_it_begins_anew_where_time_goes_back():
    """The first sample of a second run has no memory of the first."""
    stream = NoiseStream(mend_with(SLOW), np.random.default_rng(1))
    runs = np.array([stream.drawn(np.arange(50) / RATE_HZ)[[0, -1], 1] for _ in range(400)])
    assert abs(np.corrcoef(runs[1:, 0], runs[:-1, 1])[0, 1]) < 0.15
    assert runs[:, 0].std() == pytest.approx(runs[:, 1].std(), rel=0.2)
