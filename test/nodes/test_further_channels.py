"""Further currents and actuators over DDS: they join the samples, and the corrector takes off what follows them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from ros_bench import rows_of

from tam_calibration.correction.parts import EffectSize
from tam_calibration.correction.streaming import Correction
from tam_calibration.fit import calibrate
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.recordings.array_yaml import write_array
from tam_calibration.results import write_calibration

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")

NAMES = ("current_2_A", "actuator_rudder")
LAYOUT = SampleLayout.whole(4, NAMES)
COUNT = 50
HULL = FittedEffect(
    "platform_field",
    {"time_constant_s": 0.05},
    (
        Contribution(ALL, None, "first mode, gradient", {"first mode, gradient xy, x of the field": 1e-2}),
        Contribution(SCALAR, None, "first mode", {"first mode, x of the field on y": 1e-3}),
        Contribution(0, None, "current_2_A", {"current_2_A x": 2e-8}),
        Contribution(2, None, "actuator_rudder", {"actuator_rudder z": 5e-8}),
    ),
)
SIZE = EffectSize(np.full(9, 1e-8), np.full(9, 1e-9))


def test_what_follows_them_is_taken_off_as_offline(bench, recording, cross, tmp_path):
    """One list in the array file names the channels to all nodes; without their values the effect stays in, as told."""
    array = replace(cross, further_channels=NAMES)
    calibration = replace(calibrate(recording, array), effects=(HULL,), effect_sizes=(SIZE,))
    write_array(tmp_path / "array.yaml", array)
    write_calibration(tmp_path / "calibration.yaml", calibration)
    files = {"array_file": tmp_path / "array.yaml"}
    bench.start_nodes(collector=files, corrector=files | {"calibration_file": tmp_path / "calibration.yaml"})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    outputs = bench.listen(sensor_msgs.PointCloud2, "field_gradient")
    channels = [
        bench.node.create_publisher(std_msgs.Float64, topic, 1000)
        for topic in ("currents/current_2", "actuators/rudder")
    ]
    bench.spin_until(lambda: all(each.get_subscription_count() for each in channels), "the channels are subscribed")
    sensors = bench.publish_sensors()
    bench.connect(collector={"samples": 2}, corrector={"field_gradient": 1})

    def publish(run, index):
        for publisher, value in zip(channels, (2.0 + index % 3, 0.1 * np.sin(0.1 * index)), strict=True):
            publisher.publish(std_msgs.Float64(data=float(value)))
        sensors(run, index)

    bench.play(recording, publish, samples, last=COUNT)
    bench.spin_until(lambda: len(outputs) == COUNT, "all are corrected")
    rows = rows_of(samples)
    taken = LAYOUT.recording(rows)
    assert list(taken.further) == list(NAMES)
    known = np.isfinite(rows[:, -2:]).all(axis=1)
    assert known[10:].all()
    offline = Correction(calibration).correct(taken)
    assert_allclose(rows_of(outputs)[:, :9], offline.outputs, rtol=1e-9, atol=1e-20)
    assert np.abs(calibration.apply(taken.readings_T)[known] - offline.outputs[known]).max() > 1e-9
    assert offline.scalar_T is not None and np.ptp(offline.scalar_T - taken.scalar_T) > 1e-12

    bench.play(recording, sensors, samples, first=COUNT, last=COUNT + 250)
    bench.health(
        "corrector",
        lambda status, _: "needs the current_2_A and actuator_rudder, and none arrives" in status.message,
        "silent channels are told",
    )
