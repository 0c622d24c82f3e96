"""Situations of public bug reports about reading recordings, rebuilt with a known truth: each is answered as asked."""

import json
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from tam_calibration import Recording, calibrate, inspect
from tam_calibration.cli.main import main
from tam_calibration.fleet.task import process
from tam_calibration.integrity.check import faults_of
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings import read_array, read_recording
from tam_calibration.recordings.fit_input import read_source
from tam_calibration.results import read_calibration

REPORTS = Path(__file__).parents[3] / "shared" / "data" / "reports"

pytestmark = pytest.mark.skipif(
    not REPORTS.is_dir(), reason=f"the inputs of bug reports are not part of the package, and not at {REPORTS}"
)


def run(*arguments, code=0):
    """Run a command and return its result."""
    done = CliRunner().invoke(main, list(map(str, arguments)))
    assert done.exit_code == code, done.output
    return done


@pytest.fixture
def calibrated(tmp_path):
    """Return a function that calibrates a recording of a report by the command: its words, and the errors in tesla."""

    def calibrated(folder, name="run.csv", *more):
        output = tmp_path / "c.yaml"
        array = REPORTS / folder / "array.yaml"
        told = run("calibrate", REPORTS / folder / name, "--array", array, "-o", output, *more).output
        return " ".join(told.split()), read_calibration(output).errors

    return calibrated


def without(folder, name, rows):
    """Return the errors that the recording gives without some rows, as pandas reads them."""
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_csv(REPORTS / folder / name).drop(index=rows)
    return calibrate(Recording.from_pandas(frame), read_array(REPORTS / folder / "array.yaml")).errors


@pytest.mark.parametrize(
    ("name", "row", "sentence"),
    [
        ("run_1200.csv", 701, "1 of 1200 readings of the scalar is zero, first at 15.00 s"),
        ("run.csv", 150, "1 of 400 readings of the scalar is zero, first at 22.50 s"),
    ],
)
def test_dummy_scalar_one(calibrated, name, row, sentence):
    """A scalar without lock is named; the calibration is that without it."""
    told, errors = calibrated("dummy_scalar_one", name)
    assert sentence in told
    assert_allclose(errors.bias_T, without("dummy_scalar_one", name, [row]).bias_T, atol=1e-9)


def test_dummy_vector_one(calibrated):
    """The dummy of a driver is named with sensor and time, and left out."""
    told, errors = calibrated("dummy_vector_one")
    assert "1 of 400 readings of sensor 2 is far outside the range of the others, first at 22.50 s" in told
    assert_allclose(errors.bias_T, without("dummy_vector_one", "run.csv", [150]).bias_T, atol=1e-12)


def test_correct_dummy_row(tmp_path):
    """The row is corrected without the sensor, which is named; no gradient is impossible."""
    folder = REPORTS / "correct_dummy_row"
    output = tmp_path / "out.csv"
    told = run("correct", folder / "run.csv", "--calibration", folder / "calibration.yaml", "-o", output).output
    assert "1 of them without sensor 2" in told
    assert "1 of 1200 readings of sensor 2 is far outside the range of the others, first at 15.00 s" in told
    assert "calibrate again" not in told
    table = np.genfromtxt(output, delimiter=",", skip_header=1)
    others = np.abs(np.delete(table, 300, axis=0)[:, 4:]).max(axis=0)
    assert len(table) == 1200 and not (np.abs(table[300, 4:]) > 2 * others).any()


def test_locate_zero_row():
    """The reading is named and left out: the source is where it is without that sample."""
    folder, places = REPORTS / "locate_zero_row", []
    for name in ("run.csv", "clean.csv"):
        known = [
            "--calibration",
            folder / "calibration.yaml",
            "--velocity",
            "1.5,0,0",
            "--velocity-error",
            "0",
            "--json",
        ]
        done = run("locate", folder / name, *known)
        named = "1 of 600 readings of sensor 2 is zero on all axes" in done.stderr
        assert named == (name == "run.csv")
        places.append(json.loads(done.stdout))
    assert_allclose(*(each["targets"][0]["position_m"] for each in places), atol=0.01)


def test_csv_headers_quoted():
    """Quoted names are read (RFC 4180), as those without quotes."""
    path = REPORTS / "csv_headers_quoted" / "run.csv"
    recording = read_recording(path)
    assert (recording.sample_count, recording.sensor_count, recording.scalar_count) == (1200, 4, 1200)
    names = path.read_text().split("\n", 1)[0]
    assert names.startswith('"time_s","b1x_nT"')


@pytest.mark.parametrize(("folder", "name"), [("mcap_no_profile", "run.mcap"), ("reindexed_empty_storage", "run")])
def test_whole_bags_are_read(folder, name, caplog):
    """An MCAP file of another recorder, and metadata that name no storage: neither is damaged."""
    recording = read_recording(REPORTS / folder / name)
    assert recording.sensor_count == 4 and recording.sample_count > 100
    assert "damaged" not in caplog.text and "unfinished" not in caplog.text


def test_other_topic_names():
    """The only magnetometer is taken, whatever its topic; an array of four is told what there is and what to do."""
    folder = REPORTS / "other_topic_names"
    recording = read_recording(folder / "run")
    assert recording.sensor_count == 1
    assert "sensor 1" in run("inspect", folder / "run").output
    assert (
        read_recording(folder / "run", map={"sensors": [{"topic": "/imu/mag"}]}).readings_T == recording.readings_T
    ).all()
    with pytest.raises(
        InputError, match=r"1 magnetic vectors are there \(/imu/mag\), and the array has 4 sensors: name"
    ):
        read_recording(folder / "run", array=read_array(folder / "array.yaml"))


def test_zero_stamps(caplog):
    """The recorder's times are taken, and their jitter is told."""
    recording = read_recording(REPORTS / "zero_stamps" / "run")
    assert recording.sample_count == 1500 and (np.diff(recording.time_s) > 0).all()
    assert "the recorder's times are taken; their intervals vary by" in caplog.text
    assert any("all stamps are zero" in each for each in inspect(REPORTS / "zero_stamps" / "run").oddities)


def test_time_whole_seconds(calibrated, caplog):
    """All samples count, whose times are said to have too few digits."""
    told, _ = calibrated("time_whole_seconds")
    assert "; 400 samples; " in told and "keep one of each" not in told
    assert "the times have too few digits: 6.67 samples share each" in told + caplog.text


def test_stuck_bits_soft_iron():
    """Coarse steps that a driver multiplied by a matrix are no stuck bits: the recording is sound."""
    folder = REPORTS / "stuck_bits_soft_iron"
    array = read_array(folder / "array.yaml")
    assert faults_of(read_source(folder / "run.csv", array)[0], array) == []


def test_every_16th(calibrated):
    """The readings that are off are left out, and told with their sensor and how often they come."""
    told, errors = calibrated("every_16th")
    assert "25 of 400 readings of sensor 2 contradict the others and are left out, every 16th between 0.00" in told
    expected = without("every_16th", "run.csv", list(range(0, 400, 16)))
    assert_allclose(errors.bias_T, expected.bias_T, rtol=0, atol=1e-12)


def run_here(tasks, jobs):
    """Work in this process."""
    for task in tasks:
        process(task)
        yield task, ""


def test_batch_relative_times(tmp_path, monkeypatch, gap):
    """Missions whose clocks begin at 0 have one time: no drift is told."""
    monkeypatch.setattr(import_module("tam_calibration.fleet.task"), "diagnose", lambda recording, array: gap)
    monkeypatch.setattr(import_module("tam_calibration.fleet.batch"), "run_here", run_here)
    monkeypatch.setattr(import_module("tam_calibration.fleet.summary"), "plot_missions", lambda *given: Figure())
    folder = REPORTS / "batch_relative_times"
    files = sorted(folder.glob("dive*.csv"))
    told = run("batch", *files, "--array", folder / "array.yaml", "--out", tmp_path / "out", "--jobs", 1).output
    assert "no drift: the missions have one time" in told and "per day" not in told


def test_multiplexer_stuck():
    """Two channels that read one sensor are named."""
    folder = REPORTS / "multiplexer_stuck"
    told = run("calibrate", folder / "run.csv", "--array", folder / "array.yaml", code=1).stdout
    assert told.startswith("Bad: sensors 1 and 4 have the same errors, all twelve within their standard errors")
