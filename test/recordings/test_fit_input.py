"""The file of a known source; a recording on disk is the same samples as in memory, however they are asked for."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.fit import METHODS, calibrate
from tam_calibration.messages.samples import Samples, Usage
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import BLOCK, InterpolatedNoise, Recording
from tam_calibration.recordings import read_pieces
from tam_calibration.recordings.channel_map import Reading
from tam_calibration.recordings.fit_input import RecordingStream, fit_with_usage, is_large, read_known_source
from tam_calibration.results import write_recording
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate


@pytest.mark.parametrize("size", [5e-324, 1e-200, 1.0, 1e200, 1.7e308])
def test_an_axis_may_have_any_length(tmp_path, size):
    """Its direction alone counts, also where the square of its length is no number."""
    path = tmp_path / "source.yaml"
    axis = [size, 0.0, -size]
    path.write_text(f"{{recording: a.csv, position_m: [1, 2, 3], axis: {axis}, moment_Am2: 4, frequency_Hz: 10}}")
    moment = read_known_source(path).source.moment_Am2
    assert_allclose(moment, 4 * np.array([1, 0, -1]) / np.sqrt(2), rtol=1e-12)


SAMPLES = 2 * BLOCK + 345


@pytest.fixture(scope="module")
def recording():
    """Return two blocks and a part of samples of one sensor with all channels, some of them empty for a time."""
    generator = np.random.default_rng(7)
    late, sparse = generator.normal(size=(2, SAMPLES))
    late[: SAMPLES // 2], sparse[np.arange(SAMPLES) % 5 != 0] = np.nan, np.nan
    readings = 5e-5 * generator.normal(size=(SAMPLES, 1, 3))
    time_s = np.cumsum(generator.uniform(0.01, 0.02, SAMPLES))
    current, attitude = generator.normal(size=SAMPLES), generator.normal(size=(SAMPLES, 4))
    return Recording(time_s, readings, sparse, late, current, attitude, {"current_2_A": late[::-1]})


@pytest.fixture(scope="module")
def stream(recording):
    """Return the same from pieces of another size than that of the blocks."""
    return RecordingStream(pieces(recording, 5000))


def pieces(recording, size):
    """Yield a recording in pieces."""
    for start in range(0, recording.sample_count, size):
        yield Samples(recording.take(slice(start, start + size)))


def test_what_interpolation_made_goes_with_the_samples(recording, stream):
    """Through a choice of them and into memory; the recording that it was said of stays as it is."""
    noise = InterpolatedNoise(np.zeros((1, 8)), np.ones(1))
    chosen = np.arange(SAMPLES) % 3 == 0
    for source in (recording, stream):
        told = source.with_noise(noise)
        assert source.interpolated_noise is None and told.sample_count == SAMPLES
        assert told.take(chosen).whole().interpolated_noise is told.interpolated_noise is noise


def require_same(one, other):
    """Check that two recordings hold the same values."""
    assert list(one.values()) == list(other.values())
    for name, values in other.values().items():
        assert_array_equal(one.values()[name], values)


@pytest.mark.parametrize("mask", [None, np.arange(SAMPLES) % 7 < 3, np.arange(SAMPLES) > SAMPLES - 5])
def test_the_samples_are_those_of_the_pieces(recording, stream, mask):
    """All of them, every n-th, those that a mask selects, and what is told of them."""
    one, other = (recording, stream) if mask is None else (recording.take(mask), stream.take(mask))
    require_same(one, other.whole())
    require_same(one.thinned(50), other.thinned(50))
    for name in ("sample_count", "sensor_count", "scalar_count", "time_span_s"):
        assert getattr(one, name) == getattr(other, name)
    blocks = list(other.blocks())
    for index, name in enumerate(blocks[0]._fields):
        assert_array_equal(np.concatenate([block[index] for block in blocks]), getattr(one, name))


def test_a_mask_of_a_mask_selects_among_the_selected(recording, stream):
    """Samples can be taken again from what was taken, and the first stream stays as it is."""
    first = np.arange(SAMPLES) % 2 == 0
    second = np.arange(first.sum()) % 3 == 0
    require_same(recording.take(first).take(second), stream.take(first).take(second).whole())
    assert stream.sample_count == SAMPLES


def test_a_channel_that_no_piece_has_is_absent(recording):
    """Without a scalar magnetometer there is none on disk either."""
    stream = RecordingStream(pieces(replace(recording, scalar_T=None), 5000))
    assert stream.scalar_count is None
    assert next(stream.blocks()).scalar_T is None


def test_pieces_must_follow_each_other(recording):
    """Time that goes back from one piece to the next is refused with the sample."""
    with pytest.raises(InputError, match=r"goes backwards at sample 101, 0\.\d+ s"):
        RecordingStream([Samples(recording.take(slice(100, 200))), Samples(recording.take(slice(100)))])


def test_no_piece_is_no_recording():
    """A stream needs a sample."""
    with pytest.raises(InputError, match="contains no sample"):
        RecordingStream([])


def test_a_full_disk_is_told_with_the_remedy(recording, monkeypatch):
    """What cannot be written is refused with the folder and how to choose another."""

    class Full:
        def __init__(self, **options):
            """Take what a temporary file takes."""

        def close(self):
            """Do nothing."""

        def write(self, content):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("tam_calibration.recordings.fit_input.TemporaryFile", Full)
    with pytest.raises(InputError, match=r"No space left on device; name a folder with more room.*TMPDIR"):
        RecordingStream([Samples(recording)])


@pytest.fixture(scope="module")
def tumble():
    """Return a run of Wu's array that is longer than a block."""
    scenario = read_scenario("wu_table_1")
    return simulate(replace(scenario, sample_count=BLOCK + 200)).recording, scenario.array


@pytest.fixture(scope="module")
def on_disk(tumble):
    """Return the same run on disk."""
    return RecordingStream(pieces(tumble[0], 7001))


@pytest.mark.parametrize("method", METHODS)
def test_a_calibration_from_disk_is_that_from_memory(tumble, on_disk, method):
    """Every method finds the same to the last bit, held-out figures, chi-square and warnings included."""
    recording, array = tumble
    one, other = (calibrate(source, array, method) for source in (recording, on_disk))
    assert_array_equal(one.errors.to_vector(), other.errors.to_vector())
    assert_array_equal(one.standard_errors, other.standard_errors)
    for residuals in ("before", "in_sample"):
        assert getattr(one, residuals).tensor_rmse_T_per_m == getattr(other, residuals).tensor_rmse_T_per_m
    assert_allclose(one.held_out.tensor_T_per_m, other.held_out.tensor_T_per_m, rtol=1e-9)
    assert (one.reduced_chi_square, one.coverage, one.warnings) == (
        other.reduced_chi_square,
        other.coverage,
        other.warnings,
    )


def test_what_the_fit_doubts_comes_before_what_was_lost(tumble):
    """The numbers suffer more from it: it is the first reason of the answer."""
    doubtful = replace(calibrate(*tumble), warnings=("biases are open",))
    found = fit_with_usage(tumble[0], Usage(8, 10), lambda samples: doubtful)
    assert found.warnings == ("biases are open", "only 8 of 10 samples of sensor 1 used")


@pytest.mark.parametrize("name", ["run.csv", "run"])
def test_files_are_read_into_a_stream(tmp_path, tumble, name):
    """A CSV file and a bag give the samples that were written, to the rounding of their formats."""
    write_recording(tmp_path / name, tumble[0])
    stream = RecordingStream(read_pieces(tmp_path / name))
    assert_allclose(stream.whole().readings_T, tumble[0].readings_T, rtol=1e-15)
    with pytest.raises(InputError, match="sensors"):
        RecordingStream(read_pieces(tmp_path / name, reading=Reading(sensor_count=3)))


def test_a_file_is_large_by_its_size(tmp_path):
    """The size counts, that of all files of a folder."""
    (tmp_path / "bag").mkdir()
    for part in range(2):
        with (tmp_path / "bag" / f"{part}.mcap").open("wb") as file:
            file.truncate(40 << 20)
    assert is_large(tmp_path / "bag")
    assert not is_large(tmp_path / "bag" / "0.mcap")
