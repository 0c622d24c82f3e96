"""Files are recognised by what they hold, whatever their names; several are one recording by a map."""

from hashlib import sha256

import numpy as np
import pytest
from inspected import columns_of, fields, times, turned, write_bag, write_text
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import provenance, read_recording
from tam_calibration.recordings.recording_file import open_source
from tam_calibration.results import write_recording

SENSORS = [{"file": f"CH{sensor}.csv", "columns": ["mag_x", "mag_y", "mag_z"], "unit": "nT"} for sensor in (0, 1)]


@pytest.fixture
def channels(tmp_path):
    """Write a folder with a file of each of two sensors, the second half a sample late, and one of a slow scalar."""
    folder = tmp_path / "cube"
    folder.mkdir()
    for sensor in (0, 1):
        time_s = (times(first_ns=0) + 25_000_000 * sensor) / 1e9
        write_text(folder / f"CH{sensor}.csv", {"time_s": time_s, **columns_of("mag_", turned(48_000, sensor=sensor))})
    write_text(folder / "scalar.txt", {"t": np.arange(21.0), "F": 48_000 + np.arange(21.0)}, ";")
    return folder


@pytest.mark.parametrize("name", ["run.csv", "run.txt", "run", "run.parquet"])
def test_the_content_counts_and_not_the_name(tmp_path, name):
    """A text of any name is a text, an MCAP file of any name is one."""
    text = write_text(tmp_path / "a", {"time_s": times(first_ns=0) / 1e9, **columns_of("mag_", turned(48_000))})
    bag = next(write_bag(tmp_path / "bag", {"/mag": (fields(turned(), times()), times())}).glob("*.mcap"))
    for path, form in ((text, "text"), (bag, "bag")):
        (tmp_path / name).write_bytes(path.read_bytes())
        with open_source(tmp_path / name) as source:
            assert source.format == form


def test_a_folder_that_is_no_bag_is_told(channels):
    """It may be several files, which a map names."""
    with pytest.raises(InputError, match="cube is a folder and no bag: name a file, or its files in a map"):
        read_recording(channels)


def test_several_files_are_joined_by_time(channels):
    """Named by their folder or by one of them; the scalar has a text of its own form."""
    map = {"sensors": SENSORS, "scalar": {"file": "scalar.txt", "column": "F", "unit": "nT"}}
    recording = read_recording(channels, map=map)
    assert_array_equal(recording.readings_T, read_recording(channels / "CH1.csv", map=map).readings_T)
    # Values are interpolated once three intervals of a stream are known.
    assert recording.sample_count == 400 - 4 and recording.sensor_count == 2
    assert recording.scalar_count == 19
    first = np.interp(recording.time_s, times(first_ns=0) / 1e9, np.round(turned(48_000)[:, 0], 2)) * 1e-9
    assert_allclose(recording.readings_T[:, 0, 0], first, atol=1e-12)


@pytest.mark.parametrize(
    ("map", "sentence"),
    [
        ({"sensors": [*SENSORS, {"file": "CH7.csv"}]}, r"there is no file or bag .*CH7\.csv"),
        (
            {"sensors": [{"file": "bag", "columns": [1, 2, 3]}]},
            "bag is a bag: several files are joined only where each",
        ),
        (
            {"sensors": [{"file": "CH0.csv", "columns": ["mag_x", "mag_y", "mag_w"]}]},
            "CH0.csv has no 'mag_w': it has mag_x",
        ),
        (
            {"sensors": [{"file": "CH0.csv", "columns": [2, 3]}]},
            "sensor 1 needs 3 numbers of CH0.csv, and the map names 2",
        ),
    ],
)
def test_files_that_a_map_names_wrongly(channels, map, sentence):
    """Not there, a bag, without the column."""
    write_bag(channels / "bag", {"/mag": (fields(turned(), times()), times())})
    with pytest.raises(InputError, match=sentence):
        read_recording(channels, map=map)


def test_parquet_gives_what_the_text_gives(tmp_path):
    """The same numbers to the last bit, and blanks as missing values; dates of any resolution, and times as numbers."""
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    columns = columns_of("mag_", turned(48_000))
    frame = pandas.DataFrame(
        {"time_s": times(first_ns=0) / 1e9, **columns, "F": np.where(np.arange(400) % 4, np.nan, 48e3)}
    )
    frame.to_csv(tmp_path / "run.csv", index=False)
    frame.to_parquet(tmp_path / "run.parquet")
    text, table = (read_recording(tmp_path / f"run.{each}") for each in ("csv", "parquet"))
    for name, values in text.values().items():
        assert_array_equal(table.values()[name], values)
    for unit in ("ms", "us", "ns"):
        dated = frame.drop(columns="time_s").assign(when=pandas.to_datetime(times()).astype(f"datetime64[{unit}]"))
        dated.to_parquet(tmp_path / "dated.parquet")
        assert_allclose(read_recording(tmp_path / "dated.parquet").time_s, times() / 1e9, atol=1e-6)


@pytest.mark.parametrize("damage", [lambda content: content[:2000], lambda content: b"PAR1" + bytes(5000)])
def test_a_damaged_parquet_file_is_one_sentence(tmp_path, damage):
    """Cut, or of zeros."""
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    pandas.DataFrame(columns_of("mag_", turned(48_000))).to_parquet(tmp_path / "run.parquet")
    (tmp_path / "run.parquet").write_bytes(damage((tmp_path / "run.parquet").read_bytes()))
    with pytest.raises(InputError, match=r"run\.parquet is damaged or no Parquet file") as told:
        read_recording(tmp_path / "run.parquet")
    assert "\n" not in str(told.value)


RECORDING = Recording(np.arange(5.0), np.ones((5, 1, 3)))


def test_a_file_is_told_by_its_bytes(tmp_path):
    """Name, size and SHA-256 are those of the file."""
    write_recording(tmp_path / "a.csv", RECORDING)
    content = (tmp_path / "a.csv").read_bytes()
    source = provenance(tmp_path / "a.csv")
    assert (source.name, source.size_bytes, source.sha256) == ("a.csv", len(content), sha256(content).hexdigest())


def test_a_bag_is_told_by_its_data(tmp_path):
    """The folder's name, and the bytes of its data files in order, without the metadata."""
    write_recording(tmp_path / "bag", RECORDING)
    content = (tmp_path / "bag" / "bag.db3").read_bytes()
    source = provenance(tmp_path / "bag")
    assert (source.name, source.size_bytes, source.sha256) == ("bag", len(content), sha256(content).hexdigest())


def test_a_folder_without_bag_is_refused(tmp_path):
    """A folder without metadata is no recording."""
    with pytest.raises(
        InputError, match=r"contains no metadata\.yaml, nor a file that ends in \.db3 or \.mcap or \.bag: is it a bag\?"
    ):
        provenance(tmp_path)
