"""Which part of a recording is read, and the intensity of a base station in the place of a scalar."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from inspected import COUNT, PERIOD_NS, START_NS, columns_of, fields, numbers, times, turned, write_bag, write_text
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings import read_recording, text_source
from tam_calibration.recordings.channel_map import Moment, Reading, Window
from tam_calibration.recordings.recording_file import read_pieces, read_samples

START = datetime.fromtimestamp(START_NS // 10**9, UTC)


@pytest.mark.parametrize("words", ["12.5", "12.5 ", 12.5, "1.25e1", "+12.5"])
def test_seconds_from_the_start(words):
    """As a number or its digits."""
    moment = Moment.of(words)
    assert (moment.time_ns, moment.is_absolute) == (12_500_000_000, False)
    assert moment.since_epoch(START_NS) == START_NS + 12_500_000_000


@settings(deadline=None)
@given(st.datetimes(datetime(1974, 1, 1), datetime(2200, 1, 1)), st.integers(-12, 14))
def test_times_of_day(moment, hours):
    """In any zone; without one it is UTC."""
    expected = (moment.replace(tzinfo=UTC) - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
    local = f"{(moment + timedelta(hours=hours)).isoformat()}{'-' if hours < 0 else '+'}{abs(hours):02d}:00"
    for words in (moment.isoformat(), local, f"{moment.isoformat()}Z"):
        found = Moment.of(words)
        assert found.is_absolute and abs(found.time_ns - expected) <= 1000


@pytest.mark.parametrize("words", ["noon", "", "2026-13-01", "nan", "-1", "1e12", "inf", "12,5", "1_0"])
def test_what_is_no_time_is_one_sentence(words):
    """With an example of what is."""
    with pytest.raises(InputError, match="is no time"):
        Moment.of(words)


def test_a_time_of_day_needs_such_a_clock():
    """Times since power-on have no date."""
    with pytest.raises(
        InputError, match="its times are no times of day: give --from and --until in seconds from the start"
    ):
        Moment.of("2026-06-01").since_epoch(5 * 10**9)


@settings(deadline=None)
@given(st.floats(0, 30), st.floats(0, 30))
def test_a_window_holds_its_ends(start, end):
    """And what lies between; nothing where the end comes first."""
    stamps = START_NS + np.round(np.array([0, start, end, 0.5 * (start + end), 30]) * 1e9).astype(np.int64)
    held = Window(Moment.of(start), Moment.of(end)).contains(stamps, START_NS)
    assert held.tolist() == [stamps[1] <= each <= stamps[2] for each in stamps]
    assert Window().contains(stamps, START_NS).all()


@pytest.fixture(params=["bag", "text"])
def path(request, tmp_path):
    """Write a recording of one sensor and a scalar, in either form; return its path."""
    if request.param == "bag":
        topics = {"/mag": (fields(turned(), times()), times()), "/scalar": (numbers(np.full(COUNT, 48e3)), times())}
        return write_bag(tmp_path / "run", topics)
    stamps = [(START + timedelta(microseconds=each / 1000)).isoformat() for each in (times() - START_NS).tolist()]
    columns = {"time": stamps, **columns_of("mag_", turned(48_000)), "F": np.full(COUNT, 48e3)}
    return write_text(tmp_path / "run.csv", columns)


def test_a_part_of_a_recording_is_read(path, monkeypatch):
    """By seconds and by times of day, one side or both: the samples of the whole that lie within."""
    whole = read_recording(path)
    since_s = whole.time_s - whole.time_s[0]
    later, last = (START + timedelta(seconds=each) for each in (5, 12))
    for given_, low, high in (
        ({"start": 5, "until": 12.0}, 5, 12),
        ({"start": later.isoformat(), "until": last.isoformat()}, 5, 12),
        ({"until": "12"}, 0, 12),
        ({"start": 5.0}, 5, 99),
        ({"start": "0"}, 0, 99),
    ):
        part = read_recording(path, **given_)
        inside = (since_s >= low - 1e-6) & (since_s <= high + 1e-6)
        assert_array_equal(part.time_s, whole.time_s[inside])
        assert_array_equal(part.readings_T, whole.readings_T[inside])
        assert_array_equal(part.scalar_T, whole.scalar_T[inside])


def test_nothing_within_is_told(path):
    """A window behind the end."""
    with pytest.raises(InputError, match=r"no sample|holds none|lies within"):
        read_recording(path, start=1000)


def test_a_window_counts_from_the_start_of_the_recording_in_pieces(tmp_path, monkeypatch):
    """Not from that of each piece."""
    path = write_text(tmp_path / "run.csv", {"time_s": np.arange(COUNT) / 20, **columns_of("mag_", turned(48_000))})
    monkeypatch.setattr(text_source, "PIECE", 1000)
    how = read_samples(path).recording
    pieces = list(read_pieces(path, reading=Reading(window=Window(Moment.of(3), Moment.of(16)))))
    assert len(pieces) > 2
    assert_array_equal(np.concatenate([each.recording.time_s for each in pieces]), how.time_s[60:321])


IAGA = """\
 Format                 IAGA-2002                                    |
 IAGA CODE              TST                                          |
DATE       TIME         DOY     TSTX      TSTY      TSTZ      TSTF   |
"""


@pytest.fixture
def station(tmp_path):
    """Write the file of a base station whose intensity rises by 0.5 nT a second, with a gap; return its path."""
    rows = []
    for second in range(-60, 120, 5):
        moment = (START + timedelta(seconds=second)).strftime("%Y-%m-%d %H:%M:%S.000 %j")
        value = 88888.0 if 10 <= second < 15 else 48_000 + 0.5 * second
        rows.append(f"{moment}     {99999:8.2f}  {99999:8.2f}  {99999:8.2f}  {value:8.2f}")
    (tmp_path / "tst.sec").write_text(IAGA + "\n".join(rows) + "\n")
    return tmp_path / "tst.sec"


def seconds():
    """Return the times of the recording from its start."""
    return np.arange(COUNT) * PERIOD_NS / 1e9


def test_a_base_station_takes_the_place_of_a_scalar(tmp_path, station):
    """Its intensity, interpolated to the times of the samples."""
    path = write_bag(tmp_path / "bag", {"/mag": (fields(turned(), times()), times())})
    assert read_recording(path).scalar_T is None
    recording = read_recording(path, base_station=station)
    assert_allclose(recording.scalar_T * 1e9, 48_000 + 0.5 * seconds(), atol=1e-3)


def test_beside_a_scalar_it_fills_the_gaps(tmp_path, station):
    """Shifted by what the two differ; readings of the scalar itself stay."""
    own = 48_200 + 0.5 * seconds()
    kept = np.r_[0:100, 300:COUNT]
    topics = {
        "/mag": (fields(turned(), times()), times()),
        "/overhauser": (fields(np.column_stack([own, 0 * own, 0 * own])[kept] * 1e-9, times()[kept]), times()[kept]),
    }
    map = {"sensors": [{"topic": "/mag"}], "scalar": {"topic": "/overhauser", "field": "magnetic_field", "unit": "T"}}
    path = write_bag(tmp_path / "bag", topics)
    alone = read_recording(path, map=map).scalar_T
    recording = read_recording(path, map=map, base_station=station)
    there = np.isfinite(alone)
    assert_array_equal(recording.scalar_T[there], alone[there])
    assert not there.all() and np.isfinite(recording.scalar_T).all()
    assert_allclose(recording.scalar_T * 1e9, own, atol=0.05)


def test_a_base_station_in_pieces_is_that_of_the_whole(tmp_path, monkeypatch, station):
    """Also where a piece has no reading of the scalar, or lies before the first value of the station."""
    monkeypatch.setattr(text_source, "PIECE", 1000)
    own = [f"{48_200 + 0.5 * second:.3f}" if 10 < second < 12 else "" for second in seconds()]
    columns = {"time_s": [f"{START_NS / 1e9 - 65 + second:.2f}" for second in seconds()]}
    columns |= {**columns_of("mag_", turned(48_000)), "scalar_nT": own}
    how = Reading(base_station=station)
    path = write_text(tmp_path / "run.csv", columns)
    whole = read_samples(path, reading=how).recording.scalar_T
    pieces = [each.recording.scalar_T for each in read_pieces(path, reading=how)]
    assert np.isnan(whole[:90]).all() and np.isfinite(whole[100:]).all()
    assert_array_equal(np.concatenate(pieces), whole)


def test_a_station_of_another_day_is_refused(tmp_path, station):
    """With both times; a recording without dates has none in common with it."""
    for first_ns, begins in ((START_NS + 86_400 * 10**9, "2023-11-15T22:13:20"), (0, "1970-01-01T00:00:00")):
        path = write_bag(
            tmp_path / f"bag{first_ns}", {"/mag": (fields(turned(), times(first_ns=first_ns + 1)), times())}
        )
        with pytest.raises(InputError, match="the base station has values from 2023-11-14T22:12:20 to") as told:
            read_recording(path, base_station=station)
        assert f"the recording begins at {begins}" in str(told.value)


def test_what_is_no_station_is_one_sentence(tmp_path):
    """A file of another kind, and one that is not there."""
    path = write_bag(tmp_path / "bag", {"/mag": (fields(turned(), times()), times())})
    (tmp_path / "letter.txt").write_text("Dear station,\n")
    for name in ("letter.txt", "none.sec"):
        with pytest.raises(InputError, match=name):
            read_recording(path, base_station=tmp_path / name)
