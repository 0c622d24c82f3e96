"""The data of one run."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording

SAMPLES, SENSORS = 6, 2


def recording(**changes):
    """Return a plausible recording of two sensors, with some channels replaced."""
    rng = np.random.default_rng(3)
    channels = {
        "time_s": np.arange(SAMPLES) / 10,
        "readings_T": rng.uniform(-3e-5, 3e-5, (SAMPLES, SENSORS, 3)),
        "scalar_T": np.full(SAMPLES, 5e-5),
        "temperature_C": np.full(SAMPLES, 20.0),
        "current_A": np.ones(SAMPLES),
        "attitude": np.tile([0, 0, 0, 1.0], (SAMPLES, 1)),
    }
    return Recording(**{**channels, **changes})


def with_value(shape, place, value):
    """Return plausible values of a shape with another value at one place."""
    values = np.full(shape, 3e-5)
    values[place] = value
    return values


@given(st.lists(st.booleans(), min_size=SAMPLES, max_size=SAMPLES).filter(any))
def test_take_selects_the_same_samples_in_every_channel(chosen):
    """A mask gives the recording of its samples, absent channels stay absent."""
    mask = np.array(chosen)
    whole = recording(current_A=None)
    part = whole.take(mask)
    for name in ("time_s", "readings_T", "scalar_T", "temperature_C", "attitude"):
        assert_array_equal(getattr(part, name), getattr(whole, name)[mask])
    assert part.current_A is None


@pytest.mark.parametrize("channel", ["scalar_T", "temperature_C", "current_A"])
def test_a_channel_that_holds_nothing_is_absent(channel):
    """A channel of nothing but NaN is as good as none."""
    assert getattr(recording(**{channel: np.full(SAMPLES, np.nan)}), channel) is None


@pytest.mark.parametrize("channel", ["scalar_T", "temperature_C", "current_A"])
def test_a_channel_may_be_missing_in_places(channel):
    """NaN in a channel beside the sensors means no reading there."""
    assert recording(**{channel: with_value(SAMPLES, 2, np.nan)}).sample_count == SAMPLES


@pytest.mark.parametrize("part", [[0], [3], [1, 2], [0, 1, 2]])
@pytest.mark.parametrize("rows", [slice(2, 4), slice(None)])
def test_a_quaternion_that_is_unknown_in_part_is_unknown(part, rows):
    """Of one sample or of all, where the attitude is then absent; the array that was given stays as it was."""
    given = np.tile([0.0, 0.0, 0.0, 1.0], (SAMPLES, 1))
    given[rows, part[0] : part[-1] + 1] = np.nan
    before = given.copy()
    attitude = recording(attitude=given).attitude
    assert_array_equal(given, before)
    if rows == slice(None):
        assert attitude is None
    else:
        assert np.isnan(attitude[rows]).all() and np.isfinite(np.delete(attitude, [2, 3], axis=0)).all()


@pytest.mark.parametrize("value", [1e308, -1e308, 9.3e9, 1e18])
@pytest.mark.parametrize("name", ["time_s", "scalar_T", "temperature_C", "readings_T", "attitude"])
def test_a_sentence_is_short_however_large_the_number_is(name, value):
    """Also where it is the time of the first or last fault."""
    for place in (0, SAMPLES - 1, slice(None)):
        values = recording().values()
        values["time_s"][place], values[name][place] = value, value
        with pytest.raises(InputError) as problem:
            Recording.of_values(values)
        assert len(str(problem.value)) < 250


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"readings_T": np.zeros((SAMPLES, 3))}, r"readings must have the shape \(samples, sensors, 3\), not \(6, 3\)"),
        ({"readings_T": np.zeros((SAMPLES, 0, 3))}, r"readings must have the shape .* not \(6, 0, 3\)"),
        ({"time_s": np.arange(5.0)}, r"time_s must have the shape \(6,\) to match the readings, not \(5,\)"),
        ({"scalar_T": np.zeros((SAMPLES, 1))}, r"scalar_T must have the shape \(6,\)"),
        ({"temperature_C": np.zeros(1)}, r"temperature_C must have the shape \(6,\)"),
        ({"current_A": np.zeros(7)}, r"current_A must have the shape \(6,\)"),
        ({"attitude": np.zeros((SAMPLES, 3))}, r"attitude must have the shape \(6, 4\)"),
        ({"scalar_T": with_value(SAMPLES, 1, np.inf)}, "hold infinite values, first scalar_T in sample 2"),
        (
            {"readings_T": with_value((SAMPLES, SENSORS, 3), (4, 1, 2), np.nan)},
            "1 of 6 samples hold NaN or infinite values, first sensor 2 axis z in sample 5",
        ),
        ({"time_s": np.array([0, np.nan, 2, 3, 4, 5])}, "first time_s in sample 2: leave those samples out"),
        ({"temperature_C": with_value(SAMPLES, 0, np.inf)}, "first temperature_C in sample 1"),
        ({"attitude": with_value((SAMPLES, 4), (3, 0), np.inf)}, "first attitude in sample 4"),
        ({"time_s": np.array([0, 1, 1, 2, 3, 4])}, r"time repeats at sample 3.*1 such place"),
        ({"time_s": np.array([0, 1, 2, 1.5, 3, 2.5])}, r"time goes backwards at sample 4.*2 such places"),
    ],
)
def test_broken_data_are_refused(changes, sentence):
    """What is wrong is named with its channel and sample."""
    with pytest.raises(InputError, match=sentence):
        recording(**changes)


def test_an_empty_recording_is_refused():
    """Without a sample there is nothing to do."""
    with pytest.raises(InputError, match="the recording contains no sample"):
        Recording(np.zeros(0), np.zeros((0, 1, 3)))


@pytest.mark.parametrize(
    ("factor", "hint"),
    [(1e6, "µT given as T"), (1e9, "nT given as T"), (1e4, "gauss given as T"), (1e-3, "µT given as nT")],
)
def test_mistaken_units_are_named(factor, hint):
    """A field of another size than the Earth's is refused with the unit that would make it one."""
    with pytest.raises(InputError, match=f"scalar intensity is .*15 to 100 µT.*{hint}"):
        recording(scalar_T=np.full(SAMPLES, 5e-5 * factor)).check_units()
    with pytest.raises(InputError, match=f"sensor 1 reads .*15 to 100 µT.*{hint}"):
        recording(scalar_T=None, readings_T=recording().readings_T * factor).check_units()


def test_a_field_of_no_known_unit_is_refused():
    """Where no mistake of units explains the size, the source is to be checked."""
    with pytest.raises(InputError, match="check the unit and the source"):
        recording(scalar_T=np.full(SAMPLES, 5e-3)).check_units()
