"""Readings that are missing although a message or row came: each reason, what it is counted as, and the limit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from inspected import turned
from numpy.testing import assert_array_equal

from tam_calibration.messages.missing import REASONS, LiveMissing, Missing, Range, are, codes_of
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import EARTH_FIELD
from tam_calibration.recordings.channel_map import Pick
from tam_calibration.recordings.intake import Intake

NAN, ZERO, SENTINEL, FAR = range(1, 5)


@pytest.mark.parametrize(
    ("reading", "code"),
    [
        ((1.0, 2.0, 3.0), 0),
        ((0.0, 0.0, 3.0), 0),
        ((32767.0, 1.0, 2.0), 0),
        ((-9999.0, 1.0, 2.0), 0),
        ((np.nan, 2.0, 3.0), NAN),
        ((np.nan,) * 3, NAN),
        ((0.0, 0.0, 0.0), ZERO),
        ((-0.0, 0.0, -0.0), ZERO),
        ((1e300,) * 3, SENTINEL),
        ((1.0, -1e300, 2.0), SENTINEL),
        ((np.inf, 1.0, 2.0), SENTINEL),
        ((1.0, -32768.0, 2.0), SENTINEL),
        ((-2147483648.0, 1.0, 2.0), SENTINEL),
        *(((value,) * 3, SENTINEL) for value in (32767, 65535, 2147483647, 4294967295, -9999, 9999, 99999, 88888)),
    ],
)
def test_the_reason_of_a_vector(reading, code):
    """NaN on any axis, zero on all, a number that stands for no reading; one axis may be zero or at its end."""
    assert codes_of("tam_1", np.array([reading])).tolist() == [code]


@pytest.mark.parametrize(
    ("value", "code"), [(48_000.0, 0), (np.nan, 0), (0.0, ZERO), (1e300, SENTINEL), (99999.0, SENTINEL)]
)
def test_the_reason_of_a_scalar(value, code):
    """NaN between readings of a slower scalar is no fault."""
    assert codes_of("scalar", np.array([[value]])).tolist() == [code]


@settings(deadline=None)
@given(arrays(float, (5, 1)))
def test_other_channels_may_read_anything(values):
    """A temperature of 0, -9999 or NaN is judged by nobody."""
    assert not codes_of("temperature", values).any()


_NUMBERS = st.one_of(st.floats(), st.sampled_from([0.0, 9999.0, -32768.0, 65535.0]))


@settings(deadline=None)
@given(st.one_of(st.lists(_NUMBERS, min_size=3, max_size=3), _NUMBERS.map(lambda value: [value] * 3)))
def test_one_reading_is_judged_as_many_are(values):
    """The collector takes readings one by one."""
    assert LiveMissing().take("tam_1", values) == codes_of("tam_1", np.array([values]))[0]


@settings(deadline=None, max_examples=40)
@given(
    st.floats(1e-6, 1e6),
    st.lists(st.floats(-1, 1), min_size=3, max_size=3),
    st.integers(0, 399),
    st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda each: np.linalg.norm(each) > 0.3),
)
def test_what_is_far_outside_the_range_is_found_in_any_unit(unit, bias, place, direction):
    """One reading ten fields away, and none of a turned sensor, whatever its bias up to the field itself."""
    raw = unit * (turned(1.0) + np.array(bias))
    raw[place] = unit * (np.array(bias) + 10 * np.array(direction) / np.linalg.norm(direction))
    assert np.flatnonzero(Range.of("tam_1", raw).beyond(raw)).tolist() == [place]


def test_a_scalar_is_far_outside_at_four_times_or_a_quarter():
    """No source that is passed makes so much of the field."""
    raw = np.full((100, 1), 48_000.0)
    raw[[3, 50, 70]] = [[48_000 * 3.9], [48_000 * 4.1], [48_000 / 4.1]]
    assert np.flatnonzero(Range.of("scalar", raw).beyond(raw)).tolist() == [50, 70]


def test_few_readings_tell_no_range():
    """Neither do those of other channels."""
    raw = np.vstack([turned(1.0, 16), [[1e6] * 3]])
    assert not Range.of("tam_1", raw).beyond(raw).any()
    assert not Range.of("temperature", np.arange(50.0)[:, None]).beyond(np.array([[1e9]])).any()


def test_missing_readings_are_counted_by_stream_and_reason():
    """Over several batches, with the first three times of each; one reading is told in the singular."""
    missing = Missing()
    missing.add("tam_2", np.array([0, NAN, NAN, 0], dtype=np.int8), np.arange(4.0))
    missing.add("tam_2", np.array([NAN, NAN, FAR, 0], dtype=np.int8), np.arange(4.0, 8.0))
    missing.add("scalar", np.array([0, 0, 0, ZERO], dtype=np.int8), None)
    assert missing.of("tam_2") == 5 and missing.of("tam_1") == 0
    assert missing.sentences() == (
        "4 of 8 readings of sensor 2 are NaN or blank, first at 1.00, 2.00, 4.00 s",
        "1 of 8 readings of sensor 2 is far outside the range of the others, first at 6.00 s",
        "1 of 4 readings of the scalar is zero",
    )


@pytest.mark.parametrize("code", range(1, len(REASONS)))
def test_number_and_verb_agree(code):
    """Of one reading and of several."""
    assert are(code, 1).startswith("is ") and are(code, 2) == f"are {REASONS[code]}"
    assert are(SENTINEL, 1) == "is a sentinel" and are(ZERO, 5, "scalar") == "are zero"


@pytest.mark.parametrize(("lost", "is_error"), [(6990, False), (7000, True)])
def test_a_driver_at_half_the_rate_may_lose_a_few(lost, is_error):
    """A public recording of a Phidgets driver has NaN in 6990 of 13964 messages, which are every second one."""
    missing = Missing()
    codes = np.zeros(13964, dtype=np.int8)
    codes[:lost] = 1
    missing.add("tam_1", codes, None)
    assert bool(missing.mostly()) == is_error


@pytest.mark.parametrize("lost", [4, 5, 6])
def test_more_than_half_is_an_error(lost):
    """The sensor and the reasons are named; half is enough."""
    missing = Missing()
    codes = np.zeros(10, dtype=np.int8)
    codes[:lost] = SENTINEL
    codes[0] = ZERO
    missing.add("tam_1", np.zeros(10, dtype=np.int8), None)
    missing.add("tam_3", codes, None)
    if lost <= 5:
        missing.require_half()
        return
    with pytest.raises(InputError) as told:
        missing.require_half()
    assert str(told.value) == (
        "more than half of the readings of sensor 3 are missing: 1 of 10 readings of sensor 3 is zero on all axes; "
        "5 of 10 readings of sensor 3 are sentinels"
    )


def test_reasons_do_not_overlap():
    """A reading that is NaN on one axis and beyond all on another has one reason."""
    codes = codes_of("tam_1", np.array([[np.nan, 1e300, 0.0], [np.inf, np.inf, np.inf], [0.0, 0.0, np.nan]]))
    assert_array_equal(codes, [NAN, SENTINEL, NAN])


FAULTS = {
    30: (np.nan, 1.0, 1.0),
    31: (0.0, 0.0, 0.0),
    50: (1e300, 1.0, 1.0),
    51: (-32768.0, 20.0, 30.0),
    90: (9999.0, 9999.0, 9999.0),
    91: (np.inf, 0.0, 0.0),
    200: (4e5, 1e5, 0.0),
    201: (-3e7, 0.0, 0.0),
}
"""Readings that are missing, by their place, nT."""


def judged(stream, raw, unit="nT"):
    """Return the codes of readings and the clauses about them, of a whole recording and of single readings."""
    whole, live = Missing(), LiveMissing()
    codes = Intake(stream, Pick(unit=unit), EARTH_FIELD, False).take(raw)[1]
    whole.add(stream, codes, None)
    one_by_one = [live.take(stream, tuple(reading)) for reading in raw.tolist()]
    assert live.sentences() == whole.sentences() and live.mostly() == whole.mostly()
    return codes, one_by_one


@pytest.mark.parametrize("unit", ["nT", "T"])
def test_the_same_readings_are_missing_on_line_and_off_line(unit):
    """NaN, zeros, sentinels and what lies far outside, in whatever unit."""
    raw = turned(48_000 if unit == "nT" else 48e-6)
    raw[list(FAULTS)] = list(FAULTS.values())
    codes, one_by_one = judged("tam_2", raw, unit)
    assert_array_equal(one_by_one, codes)
    assert set(np.flatnonzero(codes)) == set(FAULTS) and len(set(codes)) == 5


def test_a_scalar_is_judged_so_too():
    """Zero, ends of types and values far off; NaN is no reading, and no fault."""
    raw = np.random.default_rng(1).normal(48_000, 10, (400, 1))
    raw[[20, 60, 61, 200, 201], 0] = [np.nan, 0.0, 65535.0, 2e6, 1.0]
    codes, one_by_one = judged("scalar", raw)
    assert_array_equal(one_by_one, codes)
    assert codes[[20, 60, 61, 200, 201]].tolist() == [0, 2, 3, 4, 4] and np.count_nonzero(codes) == 4


def test_an_array_that_rests_where_its_bias_takes_the_field_away_is_found_in_range_soon():
    """The range is that of a small field at first; once a tenth of the readings lie outside, they are inside."""
    rng = np.random.default_rng(2)
    bias = np.array([-39_000.0, 0.0, 0.0])
    resting = rng.normal([1_000.0, 0.0, 0.0], 5, (1000, 3))
    raw = np.concatenate([resting, turned(40_000, 3000) + bias])
    missing = LiveMissing()
    codes = np.array([missing.take("tam_1", tuple(reading)) for reading in raw.tolist()])
    assert not codes[1250:].any() and 0 < np.count_nonzero(codes) < 250


def test_what_no_sensor_reads_leaves_the_range_as_it_is():
    """Even where most readings of a stream, the first ones, are of another unit."""
    missing, raw = LiveMissing(), turned(48e-6, 600)
    wrong = [missing.take("tam_1", tuple(1e9 * reading), True) for reading in raw]
    assert set(wrong) == {FAR + 1}
    (sentence,) = missing.mostly().values()
    assert sentence.endswith("are beyond what any sensor reads: do these have another unit?")
    assert not any(missing.take("tam_1", tuple(reading)) for reading in raw)
    assert missing.take("tam_1", (1e-2, 0.0, 0.0)) == FAR and missing.take("current", (np.inf,), True) == FAR + 1


def test_of_long_streams_few_readings_are_kept():
    """The range of a day needs no memory of it, and is the same."""
    missing, raw = LiveMissing(), turned(48_000, 20_000)
    assert not any(missing.take("tam_1", tuple(reading)) for reading in raw.tolist())
    assert missing.take("tam_1", (1e6, 0.0, 0.0)) == 4
    assert len(missing._ranges["tam_1"]._kept) < 5000
