"""Recordings as text: what is written reads back, and faults are told by column and line."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import read_recording, text_source
from tam_calibration.recordings.inspection import inspect
from tam_calibration.results import write_recording


@pytest.fixture
def read(tmp_path):
    """Return a function that reads a text as a recording."""

    def read(text):
        path = tmp_path / "recording.csv"
        path.write_text(text)
        return read_recording(path)

    return read


def full_recording(sensor_count=2, samples=20):
    """Make a recording with all channels, holes in them included."""
    rng = np.random.default_rng(3)
    scalar, temperature = 50e-6 + rng.normal(size=(2, samples)) * 1e-9
    scalar[3] = temperature[:4] = np.nan
    readings = rng.normal(size=(samples, sensor_count, 3)) * 5e-5
    return Recording(
        1.7e9 + np.arange(samples) / 7,
        readings,
        scalar,
        temperature,
        rng.normal(size=samples),
        rng.normal(size=(samples, 4)),
        {"actuator_rudder": rng.normal(size=samples), "current_2_A": rng.normal(size=samples)},
    )


def test_a_recording_reads_back(tmp_path):
    """All channels read back to the last bit of a number, twice to the very bit."""
    recording = full_recording()
    write_recording(tmp_path / "a.csv", recording)
    once = read_recording(tmp_path / "a.csv")
    assert list(once.values()) == list(recording.values())
    for name, values in recording.values().items():
        assert_allclose(once.values()[name], values, rtol=3e-16)
    write_recording(tmp_path / "b.csv", once)
    twice = read_recording(tmp_path / "b.csv")
    assert list(twice.values()) == list(once.values())
    for name, values in once.values().items():
        assert_array_equal(twice.values()[name], values)


@pytest.mark.parametrize("names", [("Datum", "Uhrzeit"), ("Date", "Time")])
def test_a_clock_beside_a_date_is_the_time(tmp_path, names):
    """Whatever the columns are called; the map that is written reads the same."""
    clock = [f"09:15:{row / 20:06.3f}".replace(".", ",") for row in range(40)]
    rows = [f"12.03.2026;{time};{48_000 + row};20;-300" for row, time in enumerate(clock)]
    (tmp_path / "run.csv").write_text("\n".join([";".join((*names, "mag_x", "mag_y", "mag_z")), *rows]))
    found = inspect(tmp_path / "run.csv")
    (tmp_path / "map.yaml").write_text(found.map_yaml())
    assert found.tables[0].rate_hz == pytest.approx(20)
    for channel_map in (None, tmp_path / "map.yaml"):
        time_s = read_recording(tmp_path / "run.csv", map=channel_map).time_s
        assert_allclose(time_s, 9.25 * 3600 + np.arange(40) / 20, rtol=0, atol=1e-9)


def test_columns_may_have_any_order(read):
    """Columns are found by their names; channels that are not there are None."""
    recording = read("b1z_nT,time_s,b1x_nT,current_A,b1y_nT\n3,0,1,9,2\n")
    assert recording.readings_T.tolist() == [[[1e-9, 2e-9, 3e-9]]]
    assert recording.current_A.tolist() == [9]
    assert recording.scalar_T is None and recording.temperature_C is None and recording.attitude is None


@pytest.mark.parametrize(
    ("unit", "value"), [("nT", "48123.4"), ("uT", "48.1234"), ("G", "0.481234"), ("T", "48.1234e-6")]
)
def test_units_are_converted(read, unit, value):
    """The same field in nT, µT, gauss and tesla is the same number."""
    recording = read(f"time_s,b1x_{unit},b1y_{unit},b1z_{unit},scalar_{unit}\n0{f',{value}' * 4}\n")
    assert_allclose(recording.readings_T, 48.1234e-6, rtol=3e-16)
    assert_allclose(recording.scalar_T, 48.1234e-6, rtol=3e-16)


def test_empty_cells_of_a_channel_are_missing_values(read):
    """An empty cell, nan, spaces, Windows line ends and a byte order mark are understood."""
    recording = read(
        "\ufefftime_s, b1x_nT,b1y_nT,b1z_nT,scalar_nT\r\n0,1,2,3,\r\n1,1,2,3,nan\r\n2, 1,2,3,5\r\n3,1,2,3, "
    )
    assert_array_equal(recording.scalar_T, [np.nan, np.nan, 5e-9, np.nan])


def test_pyarrow_and_numpy_read_the_same(tmp_path, monkeypatch):
    """Large files go through pyarrow, small ones and those of a core without it through numpy: to the very bit."""
    recording = full_recording(4, 3000)
    write_recording(tmp_path / "a.csv", recording)
    small = read_recording(tmp_path / "a.csv")
    monkeypatch.setattr(text_source, "_LARGE", 0)
    large = read_recording(tmp_path / "a.csv")
    for name, values in small.values().items():
        assert_array_equal(large.values()[name], values)


@pytest.mark.parametrize("size", [128, 133, 1 << 22])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_file_is_the_same_in_pieces(tmp_path, monkeypatch, end, encoding, size):
    """Whatever ends its lines and wherever pieces of it end; remarks and blank lines between the rows are no rows."""
    rows = [f"{time},{time + 0.5},2,3" for time in range(200)]
    text = end.join(["# µ-metal, 20 °C", HEADER.strip(), *rows[:150], "# 1,2,3,4", *[""] * 300, *rows[150:]])
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode(encoding))
    monkeypatch.setattr(text_source, "PIECE", size)
    recording = read_recording(path)
    assert_array_equal(recording.time_s, range(200))
    assert_allclose(recording.readings_T[:, 0, 0], (np.arange(200) + 0.5) * 1e-9, rtol=3e-16)
    path.write_bytes(text.replace("180,180.5,", "180,oops,").encode(encoding))
    with pytest.raises(InputError, match=r"line 484 column b1x_nT: 'oops' is not a number$"):
        read_recording(path)


def test_letters_of_another_encoding_are_no_fault_in_a_remark(tmp_path):
    """Far behind the beginning, from which the encoding is detected."""
    rows = [f"{time},1,2,3".encode() for time in range(20_000)]
    rows[15_000:15_000] = [b"# 20 \xb0C"]
    path = tmp_path / "a.csv"
    path.write_bytes(b"\n".join([b"# a run", HEADER.strip().encode(), *rows]))
    assert read_recording(path).sample_count == 20_000


HEADER = "time_s,b1x_nT,b1y_nT,b1z_nT\n"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "is empty"),
        (" \n", "is empty"),
        (HEADER, "has a header but no sample"),
        ("time_s,b1x_nT,b1y_nT\n0,1,2\n", r"column b1z_nT is missing \(of 1 sensors\)"),
        ("time_s,b2x_nT,b2y_nT,b2z_nT\n0,1,2,3\n", r"column b1x_nT is missing \(of 2 sensors\)"),
        ("time_s,qx,qy\n0,1,2\n", "no vector of a magnetic field is recognised among columns qx, qy; `tam inspect"),
        ("time_s,b1x_nT,b1y_nT,b1z_nT,qx\n0,1,2,3,4\n", "column qy is missing"),
        ("time_s,b1x_mT,b1y_nT,b1z_nT\n0,1,2,3\n", "the columns of sensor 1 are in mT and nT: give them one unit"),
        ("time_s,b1x_nT,b1x_nT,b1y_nT,b1z_nT\n0,1,1,2,3\n", "column 'b1x_nT' is there twice: use header_line: 0"),
        (HEADER + "0,1,2,3\n1,1,oops,3\n2,1,2,3\n", r"recording\.csv: line 3 column b1y_nT: 'oops' is not a number"),
        (HEADER + "0,1,2,3\n1,1,3\n2,1,2,3\n", "line 3 has 3 values, but the table has 4 columns$"),
        (HEADER + "0,1,2,3\n1,1", "line 3 has 2 values, but the table has 4 columns: the file seems to be truncated"),
        (HEADER + "0,1,2\n", "line 2 has 3 values"),
        (
            HEADER + "0,1,nan,3\n1,1,,3\n2,1,2,3\n",
            "more than half of the readings of sensor 1 are missing: 2 of 3 readings of sensor 1 are NaN or blank, "
            "first at 0.00, 1.00 s",
        ),
        (HEADER + "0,1,2,3\n2,1,2,3\n1,1,2,4\n", "time goes backwards at sample 3: .* Split the file there"),
        (HEADER + "0,1,1e300,3\n", "1 of 1 readings of sensor 1 is a sentinel, first at 0.00 s"),
        (HEADER.replace("nT", "T") + "0,1,1e12,3\n", "values beyond 1e.09, first sensor 1 axis y in sample 1"),
        (HEADER + "0,1,2,3\n1e-7,1,2,3\n", "2 samples in 1e-07 s: the time must be in seconds"),
        (HEADER + "1e308,1,2,3\n", "a time is 1e.308 s, beyond the year 2262: check its unit"),
        (HEADER + "0,1,2,3\nnan,1,2,3\n1,1,2,3\n", "the time of row 2 is nan: 1 of 3 rows have no time"),
        (HEADER + f"0,1,{'x' * 5000},3\n", "line 2 column b1y_nT: 'x{20,30}[.]{3}x{20,30}' is not a number$"),
        (HEADER + "0,1,2,3\n" * 20_000 + '"' * 200_000, "line 20002 has 1 values, but the table has 4 columns"),
    ],
)
def test_a_fault_is_one_sentence(read, text, sentence):
    """Whatever is wrong with the file is told with its name and place."""
    with pytest.raises(InputError, match=sentence) as problem:
        read(text)
    assert "recording.csv" in str(problem.value)
    assert "\n" not in str(problem.value) and len(str(problem.value)) < 500


def test_other_files_are_refused(tmp_path):
    """What is not there, not text or a folder without a bag is told as such."""
    with pytest.raises(InputError, match=r"there is no file or bag .*none\.csv"):
        read_recording(tmp_path / "none.csv")
    for content in (b"\xff\xfe\x00\x81", b"\0", bytes(range(1, 30))):
        (tmp_path / "binary.csv").write_bytes(content * 10)
        with pytest.raises(InputError, match="is not a text file"):
            read_recording(tmp_path / "binary.csv")


def test_the_number_of_sensors_is_checked(tmp_path):
    """A recording of another number of sensors than wanted is refused."""
    write_recording(tmp_path / "a.csv", full_recording(2))
    with pytest.raises(InputError, match="the recording has 2 sensors, not 4"):
        read_recording(tmp_path / "a.csv", sensor_count=4)


_CELLS = st.one_of(
    st.floats().map(repr),
    st.sampled_from(
        ["", " ", "nan", "-inf", "1e308", "1e-308", "1e999", "0x10", "1_0", "1+2j", '"1"', "\x0b1", "é", "\0"]
    ),
    st.text(max_size=5),
)
_NAMES = st.sampled_from(
    ["time_s", "b1x_nT", "b1y_nT", "b1z_nT", "b2x_uT", "scalar_G", "temperature_C", "current_A", "qx", "qy", "qz", "qw"]
)
_TABLES = st.builds(
    lambda names, rows: "\n".join([",".join(names), *(",".join(row) for row in rows)]),
    st.one_of(st.just(["time_s", "b1x_nT", "b1y_nT", "b1z_nT"]), st.lists(st.one_of(_NAMES, st.text(max_size=5)))),
    st.lists(st.lists(_CELLS, min_size=4, max_size=4), max_size=4),
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.one_of(st.binary(), st.text().map(str.encode), _TABLES.map(str.encode)))
def test_any_file_is_a_recording_or_a_fault(tmp_path, content):
    """Nothing but `InputError` is raised and nothing warned of, in one short line with the name of the file."""
    path = tmp_path / "any.csv"
    path.write_bytes(content)
    try:
        recording = read_recording(path)
    except InputError as problem:
        assert "any.csv" in str(problem) and "\n" not in str(problem) and len(str(problem)) < 500 + len(str(path))
    else:
        assert np.isfinite(recording.readings_T).all()
