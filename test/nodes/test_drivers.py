"""Drivers with clocks of their own: processes that share no stamp, as on a robot."""

import re
import time
from pathlib import Path

import numpy as np
import pytest

from tam_calibration.files.calibration_yaml import calibration_from_yaml

std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")

DRIVER = str(Path(__file__).parent / "sensor_driver.py")
SPAN_S = 20.0
NOISE_T = 1e-9


def field_of_array(time_s):
    """Return the field (N, 3) in the frame of an array that is turned at some 100°/s through all directions."""
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_euler("zxy", np.outer(time_s, [90.0, 37.0, 23.0]), degrees=True)
    return turned.inv().apply([12e-6, 18e-6, -45e-6])


def write_driver(folder, name, stamps_s, readings_T):
    """Write what a driver publishes and return its command."""
    path = folder / f"{name.replace('/', '_')}.npz"
    np.savez(path, stamps_s=stamps_s, readings_T=readings_T)
    return [DRIVER, name, str(path)]


def drivers(folder, errors, periods_s, offsets_s, jitter_s, scalar_period_s):
    """Return the commands of four sensors' drivers and of the scalar's; readings are of the times of their stamps."""
    random = np.random.default_rng(4)
    commands = {}
    for sensor, (period, offset) in enumerate(zip(periods_s, offsets_s, strict=True)):
        count = int(SPAN_S / period)
        stamps = offset + period * np.arange(count) + random.uniform(-jitter_s, jitter_s, count) + jitter_s
        readings = errors.distort(field_of_array(stamps))[:, sensor] + NOISE_T * random.normal(size=(count, 3))
        commands[f"driver_{sensor + 1}"] = write_driver(folder, f"tam_{sensor + 1}/magnetic_field", stamps, readings)
    stamps = 1e-3 + scalar_period_s * np.arange(int(SPAN_S / scalar_period_s))
    intensity = np.linalg.norm(field_of_array(stamps), axis=1) + 1e-10 * random.normal(size=len(stamps))
    commands["driver_scalar"] = write_driver(folder, "scalar/intensity", stamps, intensity[:, None] * [1, 0, 0])
    return commands


CASES = {
    "offsets": ((0.01,) * 4, (0, 2.5e-3, 5e-3, 7.5e-3), 0.0, 0.01),
    "free clocks, jitter, half the rate, slow scalar": ((0.01, 0.01 * (1 + 1e-4), 0.01, 0.02), (0,) * 4, 2e-3, 0.1),
}
"""Periods, offsets and jitter of the sensors and period of the scalar, seconds."""


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_sensors_with_clocks_of_their_own_are_calibrated(bench, true_errors, tmp_path, case):
    """99 % of sensor 1's readings are used, and the gradient's error is that of the noise."""
    from rclpy.qos import DurabilityPolicy, QoSProfile

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    bench.start_nodes(collector={}, calibrator={})
    commands = drivers(tmp_path, true_errors, *case)
    bench.start(commands)
    begin = bench.node.create_publisher(std_msgs.Float64, "begin", latched)
    bench.spin_until(lambda: begin.get_subscription_count() == len(commands), "the drivers are there")
    heard = {f"publishers./tam_{sensor}/magnetic_field" for sensor in (1, 2, 3, 4)}
    bench.health("collector", lambda _, figures: heard <= {k for k, v in figures.items() if v == "1"}, "they are heard")
    begin.publish(std_msgs.Float64(data=time.time() + 0.2))
    count = int(SPAN_S / case[0][0])
    bench.health("collector", lambda _, figures: figures.get("tam_1.received") == str(count), "all readings have come")
    answer = bench.call("/calibrator/calibrate")
    assert answer.success, answer.message
    used = re.search(r"(\d+) of \d+ samples of sensor 1 used", answer.message)
    assert int(used[1]) >= 0.99 * count
    calibrations = bench.listen(std_msgs.String, "calibration", latched=True)
    bench.spin_until(lambda: calibrations, "the calibration is published")
    calibration = calibration_from_yaml(calibrations[0].data, "the topic")
    assert calibration.in_sample.tensor_rmse_T_per_m < 1.05 * calibration.floor.tensor_rmse_T_per_m
