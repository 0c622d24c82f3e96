"""What the stamps of a stream tell of its driver."""

import pytest

from tam_calibration.messages.timeline import StampFigures

MS = 1_000_000


def stream(count, period_ms, first_ms=0.0, delay_ms=0.0, shaken_ms=0.0):
    """Return the figures of a stream whose intervals are longer and shorter now and then."""
    figures = StampFigures()
    for index in range(count):
        stamp_ns = 10**18 + round((first_ms + period_ms * index + shaken_ms * (index % 4 == 1)) * MS)
        figures.add(stamp_ns, stamp_ns + round(delay_ms * MS))
    return figures


def test_rate_jitter_delay_and_offset_are_those_of_the_driver():
    """Of 100 Hz, 5 ms after sensor 1 and 0.4 ms more each fourth time, which arrives 12 ms late."""
    pace = stream(301, 10)
    told = stream(300, 10, first_ms=4, delay_ms=12, shaken_ms=0.4).summary(pace)
    assert float(told["rate_hz"]) == pytest.approx(100, rel=0.05)
    assert float(told["jitter_ms"]) == pytest.approx(0.4 / 2**0.5, rel=0.01)
    assert float(told["delay_ms"]) == 12
    assert told["offset_ms"] == "4 (at most 4.4)"
    assert "offset_ms" not in pace.summary(pace)


def test_another_clock_has_no_delay():
    """The stamps of a recording from another day say nothing of how long a message took."""
    assert "delay_ms" not in stream(10, 10, delay_ms=1e9).summary(StampFigures())


def test_few_messages_tell_nothing():
    """Two stamps make one interval, which has no jitter."""
    assert stream(2, 10).summary(stream(9, 10)) == {}


def test_stamps_that_are_all_zero_are_seen():
    """Of three messages on; one stamp that is another ends it."""
    figures = StampFigures()
    for count in range(1, 5):
        figures.add(0, 10**18)
        assert figures.are_zero == (count >= 3)
    figures.add(10**18, 10**18)
    assert not figures.are_zero
