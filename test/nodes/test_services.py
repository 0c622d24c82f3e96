"""The services of the nodes: what they do, and the reason that they give when they cannot."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from ros_bench import node_command

from tam_calibration.fit import calibrate
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.data_sheet import Tolerances
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import write_array
from tam_calibration.results import calibration_from_yaml, read_calibration, write_calibration

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")


def test_reset_starts_over(board, recording):
    """collector/reset empties coverage, losses and the calibrator's store."""
    board.play(recording.take(slice(0, 100)))
    _, figures = board.bench.health("collector", lambda _, figures: figures["samples"] == "100", "coverage is told")
    assert float(figures["fraction"]) > 0.2
    board.play(recording.take(slice(100, 110)))
    _, figures = board.bench.health("collector", lambda _, figures: figures["samples"] == "10", "coverage is told")
    assert float(figures["fraction"]) < 0.1


def test_services_answer_with_the_reason_when_there_is_nothing(board):
    """Without samples the services say what is missing."""
    board.start_over()
    for service in ("calibrate", "diagnose"):
        answer = board.ask(service)
        assert not answer.success and "no samples" in answer.message


def test_save_writes_what_was_calibrated(bench, recording, tmp_path):
    """calibrator/save writes the file that it was given, which the next calibrator hands on from its start."""
    path = tmp_path / "calibration.yaml"
    first = bench.start_nodes(collector={}, calibrator={"calibration_file": path})
    answer = bench.call("calibrator/save")
    assert not answer.success and "no calibration" in answer.message and "calibrator/calibrate" in answer.message
    assert not path.exists()
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=60)
    bench.stored(60)
    assert bench.call("calibrator/calibrate").success
    answer = bench.call("calibrator/save")
    assert answer.success and str(path) in answer.message
    assert first.end_one("calibrator") == 0

    bench.start_nodes(calibrator={"calibration_file": path})
    latched = bench.listen(std_msgs.String, "calibration", latched=True)
    bench.spin_until(lambda: latched, "the loaded calibration is handed on")
    assert_allclose(
        calibration_from_yaml(latched[0].data, "topic").errors.to_vector(),
        read_calibration(path).errors.to_vector(),
        rtol=0,
        atol=1e-15,
    )


def test_every_call_of_a_storm_is_answered(board, recording):
    """Of 200 calls at once one calibrates, all others are told at once what the calibrator is busy with."""
    board.play(recording.take(slice(0, 60)))
    answers = board.bench.storm("calibrator/calibrate")
    done = [answer for answer in answers if answer.success]
    busy = [answer for answer in answers if answer.message == "busy with calibrate: call again when that is answered"]
    assert len(done) >= 1 and len(done) + len(busy) == len(answers) == 200
    assert {answer.success for answer in board.bench.storm("collector/usage")} == {True}
    assert {answer.success for answer in board.bench.storm("calibrator/save")} == {False}


HELD = str(Path(__file__).parent / "held_calibrator.py")


def test_who_asks_during_a_diagnosis_is_told_how_far_it_is(bench, recording, tmp_path):
    """Calibrate waits for nothing: it is refused with the progress; save works meanwhile, and samples are stored."""
    path, pipe = tmp_path / "calibration.yaml", tmp_path / "pipe"
    os.mkfifo(pipe)
    parameters = node_command("calibrator", {"calibration_file": path})[3:]
    bench.start_nodes(collector={})
    bench.fork({"calibrator": [HELD, str(pipe), *parameters]})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=60)
    bench.stored(60)
    assert bench.call("calibrator/calibrate").success

    def meanwhile():
        bench.health("calibrator", lambda _, figures: "% done" in figures["busy_with"], "it works")
        told = bench.call("calibrator/calibrate").message
        assert re.fullmatch(r"busy with diagnose, \d+% done: call again when that is answered", told)
        assert bench.call("calibrator/save").success and path.exists()
        bench.play(recording, publish, samples, first=60, last=80)
        bench.stored(80)
        pipe.write_bytes(b"go on")

    assert bench.call("calibrator/diagnose", meanwhile).success


def test_what_a_mission_needs_is_set_at_run_time(board, recording, tmp_path):
    """Method and files take effect at the next call; a value that cannot be used is refused with the reason."""
    board.play(recording.take(slice(0, 60)))
    path = tmp_path / "calibration.yaml"
    for name, value, reason in (
        ("method", "guess", "guess is not one of: maximum_likelihood"),
        ("calibration_file", str(tmp_path), f"{tmp_path} is a folder: name a file"),
        ("gap_file", str(tmp_path / "no" / "gap.json"), f"cannot be written: there is no folder {tmp_path}/no"),
        ("accept", "all", "choose among alternating, few_samples"),
    ):
        assert reason in board.set_parameter(name, value)
    assert board.set_parameter("method", "two_step_linear") == ""
    assert board.set_parameter("calibration_file", str(path)) == ""
    assert "; two_step_linear on 60 samples" in board.ask("calibrate").message
    assert board.ask("save").success and read_calibration(path).method == "two_step_linear"


def test_a_corrector_loads_at_run_time(bench, recording, cross, tmp_path):
    """A file that cannot be read is refused with the reason; one that can is in force."""
    path = tmp_path / "calibration.yaml"
    write_calibration(path, calibrate(recording, cross))
    children = bench.start_nodes(corrector={})
    missing = str(tmp_path / "none.yaml")
    assert f"{missing} cannot be read" in bench.set_parameter("corrector", "calibration_file", missing)
    assert bench.set_parameter("corrector", "calibration_file", str(path)) == ""
    bench.health("corrector", lambda _, figures: figures.get("calibration") == "maximum_likelihood", "it is loaded")
    told = re.escape(f"calibration {path}, ") + r"\d+ days old: Good: tensor residual"
    bench.spin_until(lambda: re.search(told, children.log("corrector")), "it is logged")


def test_what_is_refused_can_be_accepted(board, recording):
    """By the name of the finding, as at the command line."""
    board.play(recording.take(slice(0, 17)))
    answer = board.ask("calibrate")
    assert not answer.success and answer.message.endswith("accept it by name: few_samples")
    assert board.set_parameter("accept", "few_samples") == ""
    assert board.ask("calibrate").success


AUTOSAVED = {"": "saved to {}", "missing": "not saved: {} cannot be written"}


@pytest.mark.parametrize("folder", AUTOSAVED)
def test_a_calibration_is_saved_without_being_asked(board, recording, tmp_path, folder):
    """With ``autosave`` the answer names the file, or why it could not be written; the calibration holds either way."""
    path = tmp_path / folder / "calibration.yaml"
    path.parent.mkdir(exist_ok=True)
    board.play(recording.take(slice(0, 60)), autosave=True, calibration_file=path)
    if folder:
        path.parent.rmdir()
    answer = board.ask("calibrate")
    assert answer.success and AUTOSAVED[folder].format(path) in answer.message
    assert path.exists() == (not folder)


def test_a_loaded_calibration_is_the_prior_where_that_is_asked_for(bench, recording, cross, tmp_path):
    """The answer says so."""
    path = tmp_path / "calibration.yaml"
    pier = replace(recording, time_s=recording.time_s - 86_400)
    write_calibration(path, maximum_likelihood(pier, cross))
    bench.start_nodes(collector={}, calibrator={"calibration_file": path, "prior": True})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=60)
    bench.stored(60)
    answer = bench.call("calibrator/calibrate")
    assert answer.success and "maximum_a_posteriori" in answer.message and "Prior: " in answer.message


def test_tolerances_of_the_array_file_are_a_prior_on_board(bench, true_errors, cross, tmp_path):
    """Directions within some degrees of one: refused without, calibrated with them, what is left to them is told."""
    rng = np.random.default_rng(3)
    field = np.column_stack([0.05 * rng.normal(size=(100, 2)), np.ones(100)])
    field *= 50e-6 / np.linalg.norm(field, axis=1, keepdims=True)
    readings = true_errors.distort(field) + 1e-9 * rng.normal(size=(100, 4, 3))
    intensity = np.linalg.norm(field, axis=1) + 1e-10 * rng.normal(size=100)
    narrow = Recording(1.7e9 + np.arange(100) / 100, readings, intensity)
    with pytest.raises(InputError, match="do not determine"):
        calibrate(narrow, cross)
    path = tmp_path / "array.yaml"
    write_array(path, replace(cross, tolerances=Tolerances(0.1, 0.05, 3e-6, 0.05)))
    bench.start_nodes(collector={"array_file": path}, calibrator={"array_file": path})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(narrow, publish, samples)
    bench.stored(100)
    answer = bench.call("calibrator/calibrate")
    assert answer.success and "maximum_a_posteriori" in answer.message
    assert "left to the tolerances of the array file" in answer.message
