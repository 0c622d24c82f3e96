"""A calibration that is updated while samples flow, over DDS and in processes of its own."""

import signal
from types import SimpleNamespace

import numpy as np
import pytest
from live_mission import moved
from ros_bench import field_of_array

from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.recording import Recording
from tam_calibration.results import calibration_from_yaml, write_calibration
from tam_calibration.results.sample_file import read_live_state

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")

COUNT, CHANGE = 1000, 300


@pytest.fixture(scope="module")
def mission(true_errors):
    """Return 100 s at 10 Hz, after 30 of which the bias of sensor 2 moves by 40 nT, and the errors then."""
    generator = np.random.default_rng(3)
    time_s = np.arange(COUNT) / 10
    after = moved(true_errors, 2, bias_T=np.array([32e-9, 0, -24e-9]))
    field = field_of_array(time_s / 3)
    readings = np.concatenate([true_errors.distort(field[:CHANGE]), after.distort(field[CHANGE:])])
    readings += 1e-9 * generator.normal(size=readings.shape)
    scalar = np.linalg.norm(field, axis=1) + 1e-10 * generator.normal(size=len(field))
    return Recording(1.7e9 + 3600 + time_s, readings, scalar), after


def _is_kept(samples_file, text):
    """Whether the state on disk is that of the calibration that was published last."""
    kept, _ = read_live_state(samples_file.with_name(samples_file.name + ".live"), 4)
    return np.allclose(kept.published.errors.bias_T, calibration_from_yaml(text, "").errors.bias_T, rtol=0, atol=1e-15)


def test_a_change_is_told_and_learned_and_outlasts_a_restart(bench, recording, cross, mission, tmp_path):
    """Sensor and errors are named, the corrector has the new calibration, and the next calibrator goes on with it."""
    run, after = mission
    path, samples_file = tmp_path / "calibration.yaml", tmp_path / "samples"
    write_calibration(path, maximum_likelihood(recording, cross))
    parameters = {"calibration_file": path, "samples_file": samples_file, "update": True, "on_change": "learn"}
    bench.start_nodes(collector={}, corrector={})
    first = bench.start_nodes(calibrator=parameters)
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    calibrations = bench.listen(std_msgs.String, "calibration", latched=True)
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 3}, calibrator={"calibration": 2})
    bench.play(run, publish, samples)

    status, figures = bench.health("calibrator", lambda _, figures: figures.get("changes") == "1", "a change is told")
    assert [figures[f"changed_{part}"] for part in ("law", "sensor", "parameters")] == ["offset", "2", "bias"]
    assert "bias of sensor 2 by x +3" in status.message and "it is learned anew" in status.message
    bench.spin_until(lambda: len(calibrations) > 1, "what is learned is published")
    bench.spin_until(lambda: _is_kept(samples_file, calibrations[-1].data), "what was published is kept")
    learned = calibration_from_yaml(calibrations[-1].data, "calibration")
    deviation = (learned.errors.bias_T[1] - after.bias_T[1]) / learned.standard_errors[1, 6:9]
    assert np.abs(deviation).max() < 4
    count = str(learned.samples)
    bench.health("corrector", lambda _, figures: figures["calibration_samples"] == count, "the corrector has it")
    first.end_one("calibrator", signal.SIGKILL)

    before = len(calibrations)
    second = bench.start_nodes(calibrator=parameters)
    bench.spin_until(lambda: "goes on with what was learned from" in second.log("calibrator"), "it goes on")
    bench.spin_until(lambda: len(calibrations) > before, "it publishes")
    again = calibration_from_yaml(calibrations[-1].data, "calibration")
    assert np.abs((again.errors.bias_T - learned.errors.bias_T) / learned.standard_errors[:, 6:9]).max() < 0.5
    _, figures = bench.health("calibrator", lambda _, figures: "learned" in figures, "it is there")
    assert int(figures["learned"]) > COUNT / 2 and figures["changes"] == "1"
    assert bench.call("calibrator/save").success
    answer = bench.call("calibrator/calibrate")
    assert answer.success and " samples before " in answer.message
    assert " are left out: offset, in a step: bias of sensor 2 by x +3" in answer.message
    fitted = calibration_from_yaml(calibrations[-1].data, "calibration")
    assert np.abs((fitted.errors.bias_T[1] - after.bias_T[1]) / fitted.standard_errors[1, 6:9]).max() < 4


def test_what_was_learned_of_another_array_is_set_aside(bench, recording, cross, tmp_path):
    """One sentence names where it is now; without a calibration the update waits for one, and services answer."""
    (tmp_path / "samples.live").write_text("nothing")
    children = bench.start_nodes(calibrator={"samples_file": tmp_path / "samples", "update": True})
    aside = tmp_path / "samples.live.1"
    bench.spin_until(
        lambda: f"it is now {aside}, and the update begins anew" in children.log("calibrator"), "it says so"
    )
    assert aside.read_text() == "nothing"
    bench.health("calibrator", lambda status, _: "updates once there is a calibration" in status.message, "it waits")
    assert not bench.call("calibrator/calibrate").success


def test_what_is_learned_is_kept_once_there_is_room(cross, tmp_path, monkeypatch):
    """While the disk is full that is told at WARN, once in the log, and tried again with every saving."""
    from tam_calibration.model.exceptions import InputError
    from tam_calibration.nodes.base import OK, WARN
    from tam_calibration.nodes.calibrator_state import LiveUpdate

    logged, written, is_full = [], [], [True]

    def write(path, state, calibration):
        if is_full[0]:
            raise InputError(f"{path} cannot be written: No space left on device")
        written.append(state)

    monkeypatch.setattr("tam_calibration.nodes.calibrator_state.write_live_state", write)
    node = SimpleNamespace(value=lambda name: True, get_logger=lambda: SimpleNamespace(warning=logged.append))
    update = LiveUpdate(node, cross, tmp_path / "samples", lambda calibration: None)
    update._live = SimpleNamespace(state=SimpleNamespace(changes=(), paused_by=""), sentence="learns")
    for _ in range(3):
        update.save()
        assert update.level == WARN and "what is learned is not kept: " in update.sentence()
    assert len(logged) == 1 and not written
    is_full[0] = False
    update.save()
    update.save()
    assert written == [update._live.state] and (update.level, update.sentence()) == (OK, "learns")


def test_samples_before_a_change_of_a_sensor_enter_no_calibration(recording, cross, tmp_path):
    """Nor after the next calibration; a change of the field, and one of a later run, leave all samples in."""
    from tam_calibration.live.live import Change
    from tam_calibration.nodes.calibrator_state import LiveUpdate

    update = LiveUpdate(SimpleNamespace(value=lambda name: True), cross, None, lambda calibration: None)
    assert update.since_change(recording) == (recording, "")

    def found(*changes):
        update._live = SimpleNamespace(state=SimpleNamespace(changes=changes))

    field = Change(recording.time_s[80], "offset, in a step: near a source", 0, ("gradient of the field", "bias"))
    found(field)
    assert update.since_change(recording) == (recording, "")
    knock = Change(recording.time_s[40], "offset, in a step: bias of sensor 2; it is not learned", 2, ("bias",))
    found(knock, field)
    for _ in range(2):
        kept, remark = update.since_change(recording)
        assert kept.sample_count == recording.sample_count - 40
        assert remark.startswith("40 samples before ") and remark.endswith(f"are left out: {knock.sentence}")
        update.begin(None)
    found(Change(recording.time_s[-1] + 1, "later", 2, ("bias",)))
    assert update.since_change(recording) == (recording, "")
