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


def test_reset_starts_over(bench, recording):
    """collector/reset empties coverage, losses and the calibrator's store."""
    bench.start_nodes(collector={}, calibrator={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=200)
    _, figures = bench.health("collector", lambda status, _: True, "coverage is told")
    assert float(figures["fraction"]) > 0.3
    assert bench.call("collector/reset").success
    bench.play(recording, publish, samples, first=200, last=220)
    _, figures = bench.health("collector", lambda status, _: True, "coverage is told")
    assert float(figures["fraction"]) < 0.15 and figures["samples"] == "20"
    bench.health("calibrator", lambda status, _: "20 samples" in status.message, "20 samples are stored")


def test_save_writes_what_was_calibrated(bench, recording, tmp_path):
    """calibrator/save writes the file that it was given, which the next calibrator hands on from its start."""
    path = tmp_path / "calibration.yaml"
    first = bench.start_nodes(collector={}, calibrator={"calibration_file": path})
    answer = bench.call("calibrator/save")
    assert not answer.success and "calibrator/calibrate" in answer.message and not path.exists()
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=200)
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


def test_services_answer_with_the_reason_when_there_is_nothing(bench):
    """Without samples, calibration or path the services say what is missing."""
    bench.start_nodes(calibrator={})
    answer = bench.call("calibrator/calibrate")
    assert not answer.success and "no samples" in answer.message
    answer = bench.call("calibrator/save")
    assert not answer.success and "no calibration" in answer.message


def test_every_call_of_a_storm_is_answered(bench, recording):
    """Of 200 calls at once one calibrates, all others are told at once what the calibrator is busy with."""
    bench.start_nodes(collector={}, calibrator={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=200)
    answers = bench.storm("calibrator/calibrate")
    done = [answer for answer in answers if answer.success]
    busy = [answer for answer in answers if answer.message == "busy with calibrate: call again when that is answered"]
    assert len(done) >= 1 and len(done) + len(busy) == len(answers) == 200
    assert {answer.success for answer in bench.storm("collector/usage")} == {True}
    assert {answer.success for answer in bench.storm("calibrator/save")} == {False}


HELD = str(Path(__file__).parent / "held_calibrator.py")


def test_who_asks_during_a_diagnosis_is_told_how_far_it_is(bench, recording, tmp_path):
    """Calibrate waits for nothing: it is refused with the progress; save works meanwhile."""
    from std_srvs.srv import Trigger

    path, pipe = tmp_path / "calibration.yaml", tmp_path / "pipe"
    os.mkfifo(pipe)
    parameters = node_command("calibrator", {"calibration_file": path})[3:]
    bench.start_nodes(collector={})
    bench.fork({"calibrator": [HELD, str(pipe), *parameters]})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=300)
    assert bench.call("calibrator/calibrate").success
    client = bench.node.create_client(Trigger, "calibrator/diagnose")
    bench.spin_until(client.service_is_ready, "calibrator/diagnose is there")
    future = client.call_async(Trigger.Request())
    bench.health("calibrator", lambda _, figures: "% done" in figures["busy_with"], "it works")
    told = bench.call("calibrator/calibrate").message
    assert re.fullmatch(r"busy with diagnose, \d+% done: call again when that is answered", told)
    assert bench.call("calibrator/save").success and path.exists()
    pipe.write_bytes(b"go on")
    bench.spin_until(future.done, "the diagnosis is answered")
    assert future.result().success


def test_what_a_mission_needs_is_set_at_run_time(bench, recording, tmp_path):
    """Method and files take effect at the next call; a value that cannot be used is refused with the reason."""
    nodes = bench.start_nodes(collector={}, calibrator={}, corrector={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 3})
    bench.play(recording, publish, samples, last=200)
    path = tmp_path / "calibration.yaml"
    for name, value, reason in (
        ("method", "guess", "guess is not one of: maximum_likelihood"),
        ("calibration_file", str(tmp_path), f"{tmp_path} is a folder: name a file"),
        ("gap_file", str(tmp_path / "no" / "gap.json"), f"cannot be written: there is no folder {tmp_path}/no"),
    ):
        assert reason in set_parameter(bench, "calibrator", name, value)
    assert set_parameter(bench, "calibrator", "method", "two_step_linear") == ""
    assert set_parameter(bench, "calibrator", "calibration_file", str(path)) == ""
    bench.health("calibrator", lambda _, figures: figures["samples"] == "200", "all samples are stored")
    assert "; two_step_linear on 200 samples" in bench.call("calibrator/calibrate").message
    assert bench.call("calibrator/save").success
    assert f"{tmp_path}/none.yaml cannot be read" in set_parameter(
        bench, "corrector", "calibration_file", str(tmp_path / "none.yaml")
    )
    assert nodes.end_one("calibrator") == 0
    assert set_parameter(bench, "corrector", "calibration_file", str(path)) == ""
    bench.health("corrector", lambda _, figures: figures.get("calibration") == "two_step_linear", "it is loaded")


def test_channels_that_no_sensor_makes_are_refused_unless_accepted(bench, recording):
    """As at the command line; a name that is none is refused when it is set."""
    readings = recording.readings_T.copy()
    readings[:, 2] = np.round(readings[:, 2], 6)
    bench.start_nodes(collector={}, calibrator={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(Recording(recording.time_s, readings, recording.scalar_T), publish, samples, last=300)
    answer = bench.call("calibrator/calibrate")
    assert not answer.success and answer.message.startswith("sensor 3 axis x reads in steps of 1000 nT")
    assert "choose among alternating, few_samples" in set_parameter(bench, "calibrator", "accept", "all")
    assert set_parameter(bench, "calibrator", "accept", "quantised") == ""
    answer = bench.call("calibrator/calibrate")
    assert answer.success and "sensor 3 axis x reads in steps of 1000 nT" in answer.message


def set_parameter(bench, node, name, value):
    """Set a parameter of a node and return the reason of its refusal; empty when it is set."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    client = bench.node.create_client(SetParameters, f"{node}/set_parameters")
    bench.spin_until(client.service_is_ready, f"{node} is there")
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    future = client.call_async(request)
    bench.spin_until(future.done, f"{node} answers")
    [result] = future.result().results
    assert result.successful != bool(result.reason)
    return result.reason


def test_a_loaded_calibration_is_the_prior_where_that_is_asked_for(bench, recording, cross, tmp_path):
    """The answer says so."""
    path = tmp_path / "calibration.yaml"
    pier = replace(recording, time_s=recording.time_s - 86_400)
    write_calibration(path, maximum_likelihood(pier, cross))
    bench.start_nodes(collector={}, calibrator={"calibration_file": path, "prior": True})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=200)
    answer = bench.call("calibrator/calibrate")
    assert answer.success and "maximum_a_posteriori" in answer.message and "Prior: " in answer.message


def test_tolerances_of_the_array_file_are_a_prior_on_board(bench, true_errors, cross, tmp_path):
    """Directions within some degrees of one: refused without, calibrated with them, what is left to them is told."""
    rng = np.random.default_rng(3)
    field = np.column_stack([0.05 * rng.normal(size=(200, 2)), np.ones(200)])
    field *= 50e-6 / np.linalg.norm(field, axis=1, keepdims=True)
    readings = true_errors.distort(field) + 1e-9 * rng.normal(size=(200, 4, 3))
    intensity = np.linalg.norm(field, axis=1) + 1e-10 * rng.normal(size=200)
    narrow = Recording(1.7e9 + np.arange(200) / 100, readings, intensity)
    with pytest.raises(InputError, match="do not determine"):
        calibrate(narrow, cross)
    path = tmp_path / "array.yaml"
    write_array(path, replace(cross, tolerances=Tolerances(0.1, 0.05, 3e-6, 0.05)))
    bench.start_nodes(collector={"array_file": path}, calibrator={"array_file": path})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(narrow, publish, samples)
    answer = bench.call("calibrator/calibrate")
    assert answer.success and "maximum_a_posteriori" in answer.message
    assert "left to the tolerances of the array file" in answer.message
