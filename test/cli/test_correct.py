"""`tam correct`: CSV and bags in, CSV and bags out, all with the same numbers."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from click.testing import CliRunner
from commands import tam
from inspected import message, write_bag
from numpy.testing import assert_allclose

from tam_calibration.cli.main import main
from tam_calibration.recordings import read_recording
from tam_calibration.recordings.bag_reader import open_bag, raw_messages
from tam_calibration.results import read_calibration, write_calibration, write_recording

run = partial(tam, "correct")


def read_cloud(path):
    """Return the numbers of the field_gradient messages of a bag."""
    with open_bag(path) as reader:
        connection = next(each for each in reader.connections if each.topic == "/field_gradient")
        messages = [message for *_, message in raw_messages(reader, [connection])]
        return np.array([np.frombuffer(message, "<f8", 18, len(message) - 145) for message in messages])


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


@pytest.fixture
def turned_slowly(recording, true_errors):
    """Return the recording of an array that turns by 3° from sample to sample."""
    angle = np.linspace(0, 30, 600)
    direction = np.stack([np.cos(angle), np.sin(angle) * np.cos(angle / 9), np.sin(angle) * np.sin(angle / 9)], axis=1)
    noise_T = 1e-9 * np.random.default_rng(6).normal(size=(600, 4, 3))
    readings_T = true_errors.distort(50e-6 * direction) + noise_T
    return replace(recording, readings_T=readings_T, scalar_T=np.full(600, 50e-6))


@pytest.mark.parametrize("is_bag", [False, True])
def test_missing_readings_are_named(folder, turned_slowly, is_bag):
    """Sensor, reason and time, for people and programs; rows are corrected without it, messages are interpolated."""
    recording = turned_slowly
    readings = recording.readings_T.copy()
    readings[150, 1] = -409.6e-6
    readings[[300, 301], 2] = 0
    write_recording("odd" if is_bag else "odd.csv", replace(recording, readings_T=readings))
    told = run("odd" if is_bag else "odd.csv", "--calibration", "c.yaml", "-o", "out.csv").stdout
    expected = (
        "1 of 600 readings of sensor 2 is far outside the range of the others, first at 1.50 s",
        "2 of 600 readings of sensor 3 are zero on all axes, first at 3.00, 3.01 s",
    )
    assert ("1 of them without sensor 2, 2 of them without sensor 3" in told) != is_bag
    assert all(each in told for each in expected) and told.count("\n") == 1
    again = run("odd" if is_bag else "odd.csv", "--calibration", "c.yaml", "-o", "again.csv", "--json").stdout
    assert sorted(json.loads(again)["missing"]) == sorted(expected)
    whole = read_calibration("c.yaml").correct(recording).outputs
    table = np.loadtxt("out.csv", delimiter=",", skiprows=1)[:, 1:] / 1e9
    assert_allclose(np.delete(table, [150, 300, 301], 0), np.delete(whole, [150, 300, 301], 0), atol=1e-18)
    if not is_bag:
        assert_allclose(table[[150, 300, 301], :3], whole[[150, 300, 301], :3], atol=5e-9)


def test_a_sensor_that_fails_is_left_out_without_a_scalar(folder, recording):
    """From the middle on, and told; before it all sensors count."""
    readings_T = recording.readings_T.copy()
    readings_T[300:, 2] *= -1
    write_recording("odd.csv", replace(recording, readings_T=readings_T, scalar_T=None))
    told = run("odd.csv", "--calibration", "c.yaml", "-o", "out.csv").stdout
    assert "300 of them without sensor 3" in told
    assert "300 of 600 readings of sensor 3 contradict the others and are left out, first at" in told
    table = np.loadtxt("out.csv", delimiter=",", skiprows=1)[:, 1:] / 1e9
    whole = read_calibration("c.yaml").correct(recording).outputs
    assert_allclose(table[:300], whole[:300], atol=1e-18)
    assert_allclose(table[300:, :3], whole[300:, :3], atol=5e-9)


@pytest.mark.parametrize("is_bag", [False, True])
@pytest.mark.parametrize("death", ["zeros", "noise"])
def test_a_sensor_that_dies_early_costs_no_run(folder, turned_slowly, is_bag, death):
    """Most of its readings are missing, or nonsense: the others correct those samples, and the first line says so."""
    readings_T = turned_slowly.readings_T.copy()
    readings_T[200:, 2] = 0 if death == "zeros" else 1e-9 * np.random.default_rng(7).normal(size=(400, 3))
    name = "odd" if is_bag else "odd.csv"
    write_recording(name, replace(turned_slowly, readings_T=readings_T))
    told = run(name, "--calibration", "c.yaml", "-o", "out.csv").stdout
    table = np.loadtxt("out.csv", delimiter=",", skiprows=1)
    assert f"{len(table)} samples corrected, {len(table) - 200} of them without sensor 3" in told
    assert "400 of 600 readings of sensor 3" in told
    lost = 200 if is_bag and death == "zeros" else 0  # until the sensor counts as silent
    assert len(table) == 600 - lost
    whole = read_calibration("c.yaml").correct(turned_slowly).outputs
    assert_allclose(table[:200, 1:] / 1e9, whole[:200], atol=1e-18)
    assert_allclose(table[200:, 1:4] / 1e9, whole[200 + lost :, :3], atol=5e-9)


def test_a_bag_whose_choice_needs_the_array_is_corrected_into_a_bag(folder, recording):
    """Twelve numbers without names are the four sensors of the calibration's array; their topic is kept."""
    stamps = (recording.time_s * 1e9).round().astype(int)
    kind = "std_msgs/msg/Float64MultiArray"
    layout = message("std_msgs/msg/MultiArrayLayout", [], 0)
    rows = [message(kind, layout, row) for row in recording.readings_T.reshape(-1, 12)]
    write_bag(folder / "odd", {"/adc": (rows, stamps)})
    run("odd", "--calibration", "c.yaml", "-o", "out")
    assert_allclose(
        read_cloud(folder / "out")[:, :9], read_calibration("c.yaml").correct(recording).outputs, atol=1e-15
    )


def test_the_array_is_compared(folder):
    """With the right array file the result is the same."""
    run("run.csv", "--calibration", "c.yaml", "--array", "array.yaml", "-o", "out.csv")


def test_pieces_give_the_whole(folder, monkeypatch):
    """A bag that is corrected in many pieces holds bit by bit the results of the whole, and the same summary."""
    run("run", "--calibration", "c.yaml", "-o", "whole")
    whole = run("run", "--calibration", "c.yaml", "-o", "whole.csv", "--json").stdout
    monkeypatch.setattr("tam_calibration.recordings.bag_source.BATCH", 100)
    monkeypatch.setattr("tam_calibration.recordings.bag_sqlite3.ROWS", 64)
    monkeypatch.setattr("tam_calibration.messages.cdr.COUNT", 64)
    run("run", "--calibration", "c.yaml", "-o", "pieces")
    pieces = run("run", "--calibration", "c.yaml", "-o", "pieces.csv", "--json").stdout
    assert read_cloud(folder / "pieces").tolist() == read_cloud(folder / "whole").tolist()
    assert (folder / "pieces.csv").read_text() == (folder / "whole.csv").read_text()
    assert json.loads(pieces)["intensity_mean_nT"] == pytest.approx(json.loads(whole)["intensity_mean_nT"])


def test_readings_in_another_unit_are_refused_after_some_that_are_none(folder, recording, monkeypatch):
    """A few pieces of nonsense are corrected like the rest; when most are not in tesla, nothing is written."""
    monkeypatch.setattr("tam_calibration.recordings.bag_source.BATCH", 500)
    monkeypatch.setattr("tam_calibration.recordings.bag_sqlite3.ROWS", 500)
    monkeypatch.setattr("tam_calibration.messages.cdr.COUNT", 500)
    for name, bad in (("few", slice(100, 200)), ("most", slice(100, 600))):
        readings = recording.readings_T.copy()
        readings[bad] *= 1e9
        write_recording(name, replace(recording, readings_T=readings))
    run("few", "--calibration", "c.yaml", "-o", "few_out")
    result = CliRunner().invoke(main, ["correct", "most", "--calibration", "c.yaml", "-o", "most_out"])
    assert result.exit_code == 2 and "do these have another unit?" in result.stderr
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


def test_beside_a_source_no_calibration_is_advised(folder):
    """A large gradient bends the field within the array, where scalar and centre do not compare."""
    seen = read_recording("run.csv")
    readings_T = seen.readings_T.copy()
    readings_T[:, 0, 0] += 500e-9
    readings_T[:, 2, 0] -= 500e-9
    write_recording("near.csv", replace(seen, readings_T=readings_T, scalar_T=seen.scalar_T + 10e-9))
    assert run("near.csv", "--calibration", "c.yaml", "-o", "out.csv").stderr == ""
    write_recording("aged.csv", replace(seen, scalar_T=seen.scalar_T + 10e-9))
    assert "calibrate again" in run("aged.csv", "--calibration", "c.yaml", "-o", "out.csv").stderr
