"""Times of rows: read however they are written, and repaired where a counter wraps or digits are too few."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.times import (
    PER_SECOND,
    detect_time_unit,
    even_times,
    repaired,
    stamps_of_numbers,
    stamps_of_words,
    time_unit,
)

EPOCH_S = 1_715_675_400
DAY = datetime(2024, 5, 14, 8, 30, tzinfo=UTC)


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        *((name, "") for name in ("time", "Time", "timestamp", "TIMESTAMP", "t", "date", "DateTime", "utc", "epoch")),
        *((name, "s") for name in ("time_s", "Time [s]", "time (s)", "t_sec", "time.seconds", "stamp_secs")),
        *((name, "ms") for name in ("time_ms", "t [ms]", "timestamp_msec", "millis", "time_milliseconds")),
        *((name, "us") for name in ("time_us", "Time (µs)", "time_usec", "micros", "time_microseconds")),
        *((name, "ns") for name in ("time_ns", "timestamp [ns]", "t_nanoseconds")),
        *((name, "") for name in ("time utc", "Timestamp (UTC)", "date_iso")),
        *((name, None) for name in ("T", "temperature", "runtime_s_total", "x", "speed", "time_zone", "")),
    ],
)
def test_names_of_columns_of_time(name, unit):
    """With their unit, empty where they state none; a temperature in T is no time."""
    assert time_unit(name) == unit


@settings(deadline=None)
@given(st.sampled_from(list(PER_SECOND)), st.integers(0, 4 * 10**18))
def test_whole_ticks_become_exact_stamps(unit, stamp_ns):
    """No nanosecond is lost that a double holds."""
    ticks = stamp_ns // (10**9 // PER_SECOND[unit])
    number = float(min(ticks, 2**53))
    stamps, found = stamps_of_numbers(np.array([number]), unit)
    assert found == unit and stamps.tolist() == [int(number) * (10**9 // PER_SECOND[unit])]


@pytest.mark.parametrize("unit", PER_SECOND)
@pytest.mark.parametrize("rate_hz", [0.2, 1.0, 25.0, 1000.0])
@pytest.mark.parametrize("has_date", [True, False])
def test_the_unit_of_numbers_is_detected(unit, rate_hz, has_date):
    """Times of day by their size, others by their steps: no array is read more rarely than every ten seconds."""
    if unit == "s" or has_date or rate_hz <= 25:
        time_s = np.arange(200) / rate_hz + (EPOCH_S if has_date else 3.5)
        values = time_s * PER_SECOND[unit]
        values = values if unit == "s" else np.round(values)
        assert detect_time_unit(values) == unit
        stamps, _ = stamps_of_numbers(values, "")
        assert_allclose(stamps / 1e9, time_s, atol=1e-6)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ([0.0, np.nan, 1.0], "the time of row 2 is nan: 1 of 3 rows have no time"),
        ([np.inf, 1.0], "the time of row 1 is inf: 1 of 2 rows have no time"),
        ([0.0, 1e308], "a time is 1e.308 s, beyond the year 2262: check its unit"),
    ],
)
def test_numbers_that_are_no_times(values, sentence):
    """Named by their row."""
    with pytest.raises(InputError, match=sentence):
        stamps_of_numbers(np.array(values), "s")


@pytest.mark.parametrize(
    "words",
    [
        "2024-05-14T08:30:00.25",
        "2024-05-14 08:30:00.250",
        "2024-05-14T08:30:00.250Z",
        "2024-05-14T08:30:00,25",
        "2024-05-14T08:30:00.25+00:00",
        "2024-05-14T10:30:00.25+02:00",
        "2024-05-14T04:00:00.250-0430",
        " 2024-05-14T08:30:00.25 ",
    ],
)
def test_iso_8601_in_any_zone(words):
    """Without a zone it is UTC; decimal commas and blanks are allowed; all rows alike or not."""
    expected = EPOCH_S * 10**9 + 250_000_000
    assert stamps_of_words([words] * 3, "").tolist() == [expected] * 3
    assert stamps_of_words([words, "2024-05-14T08:30:01+00:00"], "iso8601").tolist() == [
        expected,
        EPOCH_S * 10**9 + 10**9,
    ]


@settings(deadline=None, max_examples=60)
@given(
    st.datetimes(datetime(1970, 1, 2), datetime(2200, 1, 1)),
    st.integers(-14 * 60, 14 * 60),
    st.sampled_from(["T", " "]),
)
def test_any_time_of_day_is_exact(moment, minutes, separator):
    """To the microsecond, in any zone, before and after numpy's own reading."""
    aware = moment.replace(tzinfo=UTC)
    expected = (aware - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
    offset = timedelta(minutes=minutes)
    zone = f"{'-' if minutes < 0 else '+'}{abs(minutes) // 60:02d}:{abs(minutes) % 60:02d}"
    local = (moment + offset).isoformat(separator, "microseconds") + zone
    assert (
        stamps_of_words([moment.isoformat(separator), local, f"{moment.isoformat()}Z"], "").tolist() == [expected] * 3
    )


def test_nanoseconds_of_words_are_kept():
    """As loggers of PPS write them."""
    assert stamps_of_words(["2024-05-14T08:30:00.123456789"], "").tolist() == [EPOCH_S * 10**9 + 123_456_789]


@pytest.mark.parametrize("form", ["", "iso8601"])
def test_the_time_of_a_clock_goes_on_after_midnight(form):
    """Without a date it counts from the first midnight, with decimals behind a comma or a point."""
    stamps_ns = stamps_of_words(["23:59:59,950", "00:00:00.0", "00:00:00,050"], form)
    assert_array_equal(stamps_ns - 24 * 3600 * 10**9, [-50_000_000, 0, 50_000_000])


@pytest.mark.parametrize("form", ["%d.%m.%Y %H:%M:%S,%f", "%Y/%j %H%M%S.%f", "%m/%d/%y %I:%M:%S.%f %p"])
def test_a_stated_format_is_followed(form):
    """A pattern of ``strptime``, with or without a zone."""
    moments = [DAY + timedelta(seconds=0.25 * index) for index in range(4)]
    stamps = stamps_of_words([moment.strftime(form) for moment in moments], form)
    assert stamps.tolist() == [EPOCH_S * 10**9 + index * 250_000_000 for index in range(4)]
    assert stamps_of_words([DAY.strftime(f"{form} +0200")], f"{form} %z").tolist() == [(EPOCH_S - 7200) * 10**9]


@pytest.mark.parametrize(
    ("words", "form", "sentence"),
    [
        (["2024-05-14T08:30:00", "noon"], "", "the time of row 2, 'noon', is not an ISO 8601 time"),
        (["08:30", "14.5.24"], "%H:%M", "the time of row 2, '14.5.24', is not a time of the format %H:%M"),
        (["", "2024-05-14T08:30:00"], "iso8601", "the time of row 1, '', is not an ISO 8601 time"),
    ],
)
def test_words_that_are_no_times(words, form, sentence):
    """Named by their row."""
    with pytest.raises(InputError, match=sentence):
        stamps_of_words(words, form)


@pytest.mark.parametrize("bits", [16, 24, 32])
@pytest.mark.parametrize("unit", ["ms", "us"])
@pytest.mark.parametrize("wraps", [1, 3])
def test_a_counter_that_wraps_goes_on(bits, unit, wraps):
    """The times are those of a clock without an end, and it is said."""
    count = 2**bits * (wraps + 0.5)
    ticks = np.unique(np.round(np.linspace(0, count, 4000)).astype(np.int64)) + 11
    stamps, _ = stamps_of_numbers((ticks % 2**bits).astype(float), unit)
    found = repaired(stamps, unit)
    assert_array_equal(found.stamps_ns, ticks * (10**9 // PER_SECOND[unit]))
    assert found.is_kept.all() and found.remarks == (f"its counter of {bits} bits wrapped {wraps} times, and goes on",)


def test_times_that_go_back_otherwise_are_refused():
    """A restart is no overflow: the place is named, and what to do."""
    stamps = np.concatenate([np.arange(100), np.arange(100)]) * 50_000_000
    for unit in ("s", "us", ""):
        with pytest.raises(
            InputError, match=r"time goes backwards at sample 101: after 4\.950000 s comes 0\.000000 s"
        ) as told:
            repaired(stamps, unit)
        assert "Split the file there" in str(told.value) and "rate_hz" in str(told.value)


@settings(deadline=None, max_examples=40)
@given(st.integers(2, 60), st.integers(0, 10**9 - 1), st.integers(3, 40))
def test_too_few_digits_are_spread_evenly(rate_hz, first_ns, seconds):
    """Each sample lies within the step of the clock in which it was written, time rises, and no sample is lost."""
    exact = EPOCH_S * 10**9 + first_ns + np.arange(rate_hz * seconds) * (10**9 // rate_hz)
    found = repaired(exact // 10**9 * 10**9, "s")
    assert found.is_kept.all() and (np.diff(found.stamps_ns) > 0).all()
    assert (np.abs(found.stamps_ns - exact) < 1.01e9).all()
    inner = slice(rate_hz, -rate_hz)
    assert_allclose(np.diff(found.stamps_ns)[inner], 1e9 / rate_hz, rtol=0.51)
    assert "the times have too few digits" in found.remarks[0] and "spread evenly" in found.remarks[0]


def test_whole_seconds_of_an_even_rate_are_exact():
    """Where as many samples share each."""
    exact = np.arange(20 * 60) * 50_000_000
    assert_array_equal(repaired(exact // 10**9 * 10**9, "s").stamps_ns, exact)


def test_a_gap_is_not_filled():
    """Samples are not stretched across a pause."""
    seconds = np.repeat([0, 1, 2, 100, 101, 102], 10)
    found = repaired(seconds * 10**9, "s").stamps_ns
    assert found[29] < 4e9 and found[30] == 100 * 10**9


def test_a_few_repeats_are_left_out():
    """Rows that came twice, which are counted; the others keep their times."""
    stamps = np.arange(100) * 10**7
    stamps[[20, 50]] = stamps[[19, 49]]
    found = repaired(stamps, "s")
    assert np.flatnonzero(~found.is_kept).tolist() == [20, 50]
    assert_array_equal(found.stamps_ns, stamps)
    assert found.remarks == ("2 rows repeat the time before them and were left out",)


def test_one_time_for_all_is_refused():
    """A rate in a map helps."""
    with pytest.raises(InputError, match=r"all rows have one time: state time: \{rate_hz"):
        repaired(np.zeros(10, dtype=np.int64), "s")


@pytest.mark.parametrize("stamps", [[], [5], [1, 2, 3]])
def test_sound_times_are_left_alone(stamps):
    """Also none and one."""
    found = repaired(np.array(stamps, dtype=np.int64), "s")
    assert found.stamps_ns.tolist() == stamps and found.is_kept.all() and found.remarks == ()


def test_even_times():
    """Of a rate, from the first sample on."""
    assert even_times(3, 25.0).tolist() == [0, 40_000_000, 80_000_000]
