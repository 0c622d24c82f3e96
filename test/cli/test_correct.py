"""`tam correct`: CSV and bags in, CSV and bags out, all with the same numbers."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose

from tam_calibration.cli.main import main
from tam_calibration.files import read_calibration, read_recording, write_array, write_calibration, write_recording
from tam_calibration.files.bag import open_bag
from tam_calibration.fit import calibrate


@pytest.fixture
def folder(tmp_path, monkeypatch, recording, cross):
    """Give a working folder with a recording as CSV and as a bag, its array file and its calibration."""
    monkeypatch.chdir(tmp_path)
    write_recording("run.csv", recording)
    write_recording("run", recording)
    write_array("array.yaml", cross)
    write_calibration("c.yaml", calibrate(recording, cross))
    return tmp_path


def run(*arguments):
    """Run the command and return its result; it must succeed."""
    result = CliRunner().invoke(main, ["correct", *arguments])
    assert result.exit_code == 0, result.stderr
    return result


def read_cloud(path):
    """Return the numbers of the field_gradient messages of a bag."""
    with open_bag(path) as reader:
        connection = next(each for each in reader.connections if each.topic == "/field_gradient")
        return np.array(
            [np.frombuffer(message, "<f8", 18, len(message) - 145) for _, _, message in reader.messages([connection])]
        )


@pytest.mark.parametrize("source", ["run.csv", "run"])
def test_every_output_holds_the_same_results(folder, source):
    """CSV, folder and .mcap hold what `Calibration.correct` returns."""
    expected = read_calibration("c.yaml").correct(read_recording(source))
    for output in ("out.csv", "out", "out.mcap"):
        run(source, "--calibration", "c.yaml", "-o", output)
    for output in ("out", "out.mcap"):
        cloud = read_cloud(folder / output)
        assert cloud[:, :9].tolist() == expected.outputs.tolist()
        assert cloud[0, 9:].tolist() == expected.standard_errors.tolist()
    table = np.loadtxt("out.csv", delimiter=",", skiprows=1)
    assert table[:, 0].tolist() == expected.time_s.tolist()
    assert_allclose(table[:, 1:] / 1e9, expected.outputs, rtol=3e-16)


def test_a_bag_keeps_the_raw_topics(folder):
    """What was in the bag is in the corrected bag too."""
    run("run", "--calibration", "c.yaml", "-o", "out")
    again = read_recording("out")
    assert again.readings_T.tolist() == read_recording("run").readings_T.tolist()


def test_a_summary_is_told(folder, recording):
    """People get one line, programs JSON."""
    assert (
        "out.csv: 600 samples corrected, |B| 50000" in run("run.csv", "--calibration", "c.yaml", "-o", "out.csv").stdout
    )
    summary = json.loads(run("run", "--calibration", "c.yaml", "-o", "out.csv", "--json").stdout)
    assert summary["samples"] == 600
    assert summary["standard_errors"]["gxy_nT_per_m"] == pytest.approx(2, rel=0.1)


def test_the_array_is_compared(folder):
    """With the right array file the result is the same."""
    run("run.csv", "--calibration", "c.yaml", "--array", "array.yaml", "-o", "out.csv")


def test_pieces_give_the_whole(folder, monkeypatch):
    """A bag that is corrected in many pieces holds bit by bit the results of the whole, and the same summary."""
    run("run", "--calibration", "c.yaml", "-o", "whole")
    whole = run("run", "--calibration", "c.yaml", "-o", "whole.csv", "--json").stdout
    monkeypatch.setattr("tam_calibration.files.bag.BATCH", 100)
    monkeypatch.setattr("tam_calibration.files.bag_sqlite3.ROWS", 64)
    run("run", "--calibration", "c.yaml", "-o", "pieces")
    pieces = run("run", "--calibration", "c.yaml", "-o", "pieces.csv", "--json").stdout
    assert read_cloud(folder / "pieces").tolist() == read_cloud(folder / "whole").tolist()
    assert (folder / "pieces.csv").read_text() == (folder / "whole.csv").read_text()
    assert json.loads(pieces)["intensity_mean_nT"] == pytest.approx(json.loads(whole)["intensity_mean_nT"])


def test_readings_in_another_unit_are_refused_after_some_that_are_none(folder, recording, monkeypatch):
    """A few pieces of nonsense are corrected like the rest; when most are not in tesla, nothing is written."""
    monkeypatch.setattr("tam_calibration.files.bag.BATCH", 500)
    monkeypatch.setattr("tam_calibration.files.bag_sqlite3.ROWS", 500)
    for name, bad in (("few", slice(100, 200)), ("most", slice(100, 600))):
        readings = recording.readings_T.copy()
        readings[bad] *= 1e9
        write_recording(name, replace(recording, readings_T=readings))
    run("few", "--calibration", "c.yaml", "-o", "few_out")
    result = CliRunner().invoke(main, ["correct", "most", "--calibration", "c.yaml", "-o", "most_out"])
    assert result.exit_code == 2 and "nT given as T" in result.stderr
    assert not (folder / "most_out").exists()


def test_a_calibration_of_another_array_is_refused_by_the_scalar(folder):
    """Where |B| contradicts the scalar beside it nothing is written, unless that is accepted; the figures are told."""
    calibration = read_calibration("c.yaml")
    wrong = replace(calibration.errors, bias_T=calibration.errors.bias_T + np.array([10e-6, 0, 0]))
    write_calibration("wrong.yaml", replace(calibration, errors=wrong))
    arguments = ["correct", "run.csv", "--calibration", "wrong.yaml", "-o", "out.csv"]
    refused = CliRunner().invoke(main, arguments)
    assert refused.exit_code == 1 and not (folder / "out.csv").exists()
    assert "nothing is written, |B| − scalar is" in refused.stderr and "accept residual" in refused.stderr
    accepted = run(*arguments[1:], "--accept", "residual", "--json")
    assert (folder / "out.csv").exists() and json.loads(accepted.stdout)["scalar_residual_nT"] > 1000
    assert "warning: |B| − scalar is" in accepted.stderr


def test_a_calibration_that_has_aged_is_a_warning(folder):
    """A bias that has drifted by some nT is told, with the residual beside the noise floor."""
    calibration = read_calibration("c.yaml")
    aged = replace(calibration.errors, bias_T=calibration.errors.bias_T + np.array([40e-9, 0, 0]))
    write_calibration("aged.yaml", replace(calibration, errors=aged))
    result = run("run.csv", "--calibration", "aged.yaml", "-o", "out.csv")
    assert "nT: calibrate again" in result.stderr
    assert run("run.csv", "--calibration", "c.yaml", "-o", "again.csv").stderr == ""
