"""calibrator/compare: what was collected beside a simulator's recording, in the answer and in files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.model.recording import Recording
from tam_calibration.recordings import write_array
from tam_calibration.results import write_recording

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")


@pytest.fixture
def simulation(true_errors, tmp_path):
    """Return the path of a simulator's recording: another path of the same array, in the same field."""
    rng = np.random.default_rng(2)
    direction = rng.normal(size=(400, 3))
    field = 50e-6 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    readings = true_errors.distort(field) + 1e-9 * rng.normal(size=(400, 4, 3))
    path = tmp_path / "simulation.csv"
    write_recording(path, Recording(np.arange(400) / 100, readings, 50e-6 + 1e-10 * rng.normal(size=400)))
    return path


@pytest.fixture
def disturbed(recording):
    """Return the recording with a magnet at sensor 2 from its middle on."""
    recording = recording.take(slice(0, 300))
    readings = recording.readings_T.copy()
    readings[150:, 1] += [20e-9, -10e-9, 15e-9]
    return replace(recording, readings_T=readings)


@pytest.fixture
def ask(bench):
    """Return a function that plays a recording into the nodes, calls calibrator/compare and returns its response."""

    def ask(recording, **parameters):
        from std_srvs.srv import Trigger

        bench.start_nodes(collector={}, calibrator=parameters)
        samples = bench.listen(sensor_msgs.PointCloud2, "samples")
        publish = bench.publish_sensors()
        bench.connect(collector={"samples": 2})
        bench.play(recording, publish, samples)
        client = bench.node.create_client(Trigger, "calibrator/compare")
        bench.spin_until(client.service_is_ready, "calibrator/compare is there")
        future = client.call_async(Trigger.Request())
        bench.spin_until(future.done, "calibrator/compare answers", timeout_s=180.0)
        return future.result()

    return ask


def test_what_the_simulation_lacks_is_told(ask, disturbed, simulation, tmp_path):
    """A step of the bias is named in the answer, on one line, and the files that were named are written."""
    files = {
        "comparison_file": tmp_path / "compare.json",
        "comparison_report_file": tmp_path / "compare.html",
        "mend_file": tmp_path / "mend.yaml",
    }
    answer = ask(disturbed, simulation=simulation, **files)
    assert answer.success, answer.message
    assert answer.message.startswith("Different: ") and "sensor 2" in answer.message and "\n" not in answer.message
    content = json.loads(files["comparison_file"].read_text())
    (missing,) = content["missing_in_simulation"]
    assert (missing["effect"], missing["sensors"]) == ("bias_jump", [2])
    assert content["simulation"]["name"] == "simulation.csv" and content["recording"] is None
    assert files["comparison_report_file"].read_text().startswith("<!DOCTYPE html>")
    assert "bias_jump" in files["mend_file"].read_text()


def test_a_simulation_of_the_same_is_told_to_be(ask, recording, simulation):
    """With other attitudes and other noise, and nothing else."""
    answer = ask(recording.take(slice(0, 300)), simulation=simulation)
    assert answer.success and answer.message.startswith("The same: "), answer.message


def test_without_a_simulation_the_answer_is_no(bench):
    """It says which parameter to set."""
    bench.start_nodes(calibrator={})
    answer = bench.call("calibrator/compare")
    assert not answer.success and "set the parameter simulation of calibrator" in answer.message


def test_without_samples_the_answer_is_no(bench, simulation):
    """As there is nothing to compare."""
    bench.start_nodes(calibrator={"simulation": simulation})
    answer = bench.call("calibrator/compare")
    assert not answer.success and "no samples" in answer.message


def test_a_simulation_that_cannot_be_used_is_told(ask, recording, cross, tmp_path):
    """One of three sensors, by its side."""
    write_recording(tmp_path / "three.csv", replace(recording, readings_T=recording.readings_T[:, :3]))
    write_array(tmp_path / "array.yaml", cross)
    files = {"simulation": tmp_path / "three.csv", "simulation_array_file": tmp_path / "array.yaml"}
    answer = ask(recording.take(slice(0, 60)), **files)
    assert not answer.success
    assert answer.message.startswith("the simulation: ") and "3 sensors, not 4" in answer.message


def test_no_file_that_is_read_is_overwritten(ask, recording, simulation):
    """The mend would take the place of the simulation."""
    answer = ask(recording.take(slice(0, 60)), simulation=simulation, mend_file=simulation)
    assert not answer.success and "would be overwritten" in answer.message
