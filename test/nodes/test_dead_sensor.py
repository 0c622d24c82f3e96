"""A sensor whose driver dies: samples, field and gradient go on with the others, and say so, until it returns."""

import signal
import time

import numpy as np
import pytest
from ros_bench import field_of_array, write_driver

from tam_calibration.fit import calibrate
from tam_calibration.model.array import OUTPUT_NAMES
from tam_calibration.results import write_calibration

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")

SPAN_S = 300.0
"""Longer than the test takes where all cores are busy."""
PERIOD_S = 0.02
SILENCE_S = 1.0
"""Longer than a busy machine holds up a driver."""
NOISE_T = 1e-9
ERROR, WARN, OK = b"\x02", b"\x01", b"\x00"


class Array:
    """Drivers of four sensors in processes of their own, and the outputs of the corrector."""

    def __init__(self, bench, folder, errors):
        from rclpy.qos import DurabilityPolicy, QoSProfile

        random, stamps = np.random.default_rng(5), PERIOD_S * np.arange(int(SPAN_S / PERIOD_S))
        readings = errors.distort(field_of_array(stamps))
        readings += NOISE_T * random.normal(size=readings.shape)
        self.bench = bench
        self.commands = {
            sensor: write_driver(folder, f"tam_{sensor}/magnetic_field", stamps, readings[:, sensor - 1])
            for sensor in (1, 2, 3, 4)
        }
        self.drivers = {}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.begin = bench.node.create_publisher(std_msgs.Float64, "begin", latched)
        for sensor in self.commands:
            self.start(sensor)
        self.outputs = bench.listen(sensor_msgs.PointCloud2, "field_gradient")
        self.centers = bench.listen(sensor_msgs.MagneticField, "center")
        bench.spin_until(lambda: self.begin.get_subscription_count() == 4, "the drivers are there")
        heard = {f"publishers./tam_{sensor}/magnetic_field" for sensor in (1, 2, 3, 4)}
        bench.health(
            "collector", lambda _, figures: heard <= {k for k, v in figures.items() if v == "1"}, "they are heard"
        )
        self.start_s = time.time() + 0.1
        self.begin.publish(std_msgs.Float64(data=self.start_s))

    def start(self, sensor):
        """Start the driver of a sensor, which goes on where it would be now."""
        self.drivers[sensor] = self.bench.fork({f"driver_{sensor}": self.commands[sensor]})

    def kill(self, sensor):
        """Kill the driver of a sensor."""
        driver = self.drivers.pop(sensor)
        self.bench.children.remove(driver)
        driver.end_one(f"driver_{sensor}", signal.SIGKILL)

    def wait_for(self, count):
        """Wait for so many outputs more, and return these."""
        before = len(self.outputs)
        self.bench.spin_until(lambda: len(self.outputs) >= before + count, f"{count} outputs come")
        return self.outputs[before : before + count]

    def pulls(self, clouds):
        """Return the errors (N, 9) of outputs over their standard errors; the true field is known and uniform."""
        from tam_calibration.nodes.topics import read_cloud

        rows = np.concatenate([read_cloud(cloud)[1] for cloud in clouds])
        stamps = [cloud.header.stamp.sec - self.start_s + 1e-9 * cloud.header.stamp.nanosec for cloud in clouds]
        truth = np.zeros((len(rows), 9))
        truth[:, :3] = field_of_array(np.array(stamps))
        return (rows[:, :9] - truth) / rows[:, 9:]


@pytest.fixture
def array(bench, recording, cross, true_errors, tmp_path):
    """Start nodes with a calibration, and the drivers."""
    path = tmp_path / "calibration.yaml"
    write_calibration(path, calibrate(recording, cross))
    calibrated = {"calibration_file": str(path)}
    bench.start_nodes(collector={"silence_s": SILENCE_S}, corrector=calibrated, calibrator={})
    return Array(bench, tmp_path, true_errors)


def is_about_one(pulls):
    """Whether the root mean square of each output's errors over its standard errors is one, within 5 sigma of it."""
    assert np.sqrt(np.mean(pulls**2, axis=0)) == pytest.approx(1.0, abs=5 / np.sqrt(2 * len(pulls)))
    assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1.0, abs=0.1)


def is_missing(bench, sensors):
    """Wait until collector and corrector say that sensors are missing, and return the corrector's figures."""
    names = [f"tam_{sensor}" for sensor in sensors]
    status, _ = bench.health(
        "collector",
        lambda status, _: f"samples go on without {' and '.join(names)}" in status.message,
        f"{names} are named",
    )
    assert status.level == ERROR and f"nothing from {names[0]} since 20" in status.message
    told = f"no reading of sensor {' and '.join(map(str, sensors))}:"
    status, figures = bench.health("corrector", lambda status, _: told in status.message, "it is missing")
    assert status.level == WARN and figures["missing_sensors"] == " ".join(map(str, sensors))
    return figures


def test_outputs_go_on_without_a_sensor_until_it_returns(bench, array):
    """Also where it sets the pace. ERROR all the while; errors are as stated; what is not determined is NaN."""
    array.kill(1)
    assert is_missing(bench, [1])["not_determined"] == ""
    is_about_one(array.pulls(array.wait_for(200)))
    array.kill(3)
    assert is_missing(bench, [1, 3])["not_determined"] == "gxx gxz gzz"
    bench.spin_until(lambda: np.isnan(array.pulls(array.outputs[-1:])).any(), "outputs without them come")
    centers = len(array.centers)
    pulls = array.pulls(array.wait_for(200))
    unknown = np.isin(OUTPUT_NAMES, ["gxx", "gxz", "gzz"])
    assert np.isnan(pulls[:, unknown]).all()
    is_about_one(pulls[:, ~unknown])
    assert np.isfinite(array.centers[centers].magnetic_field_covariance).all()
    bench.health("calibrator", lambda _, figures: int(figures["partial"]) > 300, "the calibrator keeps them apart")
    assert "defect" not in bench.call("calibrator/calibrate").message
    array.start(1)
    array.start(3)
    bench.health("corrector", lambda status, _: status.level == OK, "all sensors are back")
    bench.health("collector", lambda status, _: status.level == OK, "nothing is silent")
    is_about_one(array.pulls(array.wait_for(200)))
