"""What `streaming.py` measures with: sensors before a dipole, processor time of nodes, and what comes out of them."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from localizer import PLACE, START_S
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu, MagneticField

from tam_calibration.correction.calibration import Calibration
from tam_calibration.messages.point_cloud import CHANNEL_TOPICS, sensor_topic
from tam_calibration.model.geomagnetic_field import field_at
from tam_calibration.model.units import FloatArray
from tam_calibration.nodes.session import Children
from tam_calibration.nodes.topics import STAMP, MessageWriter, from_stamp, to_stamp
from tam_calibration.sources.dipole import Dipole

SENSOR_TOPICS = [*(sensor_topic(sensor) for sensor in (1, 2, 3, 4)), CHANNEL_TOPICS["scalar"]]
IMU_TOPIC = CHANNEL_TOPICS["attitude"]
IMU_HZ = 100.0
"""Rate of the attitude, as usual of inertial units."""

QUALITY = QoSProfile(depth=10_000)
SETTLE_S = 3.0
"""Time after the last sample in which outputs still arrive, seconds."""


class Bench(Node):
    """Publishes the topics of the sensors, and keeps stamps and times of arrival of what the nodes make of them."""

    def __init__(self, executor: Executor) -> None:
        super().__init__("bench")
        self._executor = executor
        self._publishers_of_sensors = [self.create_publisher(MagneticField, topic, QUALITY) for topic in SENSOR_TOPICS]
        self._imu = self.create_publisher(Imu, IMU_TOPIC, QUALITY)
        self._field_writer = MessageWriter(MagneticField(), 12)
        self._imu_writer = MessageWriter(Imu(), 4, behind=8 * 33)
        self.figures: dict[str, dict[str, str]] = {}
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take_health, 100)
        executor.add_node(self)
        # Not in the executor: what it receives is taken between the samples, and costs no other time.
        self._ears = Node("ears")
        self._heard: dict[str, Subscription] = {}
        self.last_stamp_ns: dict[int, int] = {}
        self.arrivals_ns: dict[str, dict[int, int]] = {}

    def hear(self, message_type: type, topic: str) -> None:
        """Take the messages of a topic."""
        self._heard[topic] = self._ears.create_subscription(message_type, topic, lambda _: None, QUALITY, raw=True)
        self.arrivals_ns[topic] = {}

    def close(self) -> None:
        """End the nodes of the bench."""
        self._executor.remove_node(self)
        self._executor.shutdown()
        self._ears.destroy_node()
        self.destroy_node()

    def spin_until(self, limit_s: float) -> None:
        """Take statuses until a time of the clock."""
        while (left := limit_s - time.perf_counter()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def wait_for(self, children: Children, node: str, figures: Mapping[str, str]) -> None:
        """Wait until a node tells these figures."""
        limit = time.perf_counter() + START_S
        while not figures.items() <= self.figures.get(node, {}).items():
            children.check()
            if time.perf_counter() > limit:
                raise TimeoutError(f"{node} does not tell {figures} within {START_S} s, but {self.figures}")
            self.spin_until(time.perf_counter() + 0.05)

    def publish(self, readings: FloatArray, scalar: float, attitude: FloatArray | None) -> None:
        """Publish a sample (4, 3) at the time of the clock, the attitude first."""
        stamp_ns = time.time_ns()
        stamp, covariance = to_stamp(stamp_ns), bytes(72)
        if attitude is not None:
            self._imu.publish(self._imu_writer.message(stamp, attitude.tobytes()))
        fields = [*readings, np.array([scalar, 0.0, 0.0])]
        for publisher, field in zip(self._publishers_of_sensors, fields, strict=True):
            publisher.publish(self._field_writer.message(stamp, field.tobytes() + covariance))
        self.last_stamp_ns[stamp_ns] = time.time_ns()

    def take(self) -> None:
        """Take what has come, with the time at which it came."""
        for topic, subscription in self._heard.items():
            with subscription.handle:
                while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
                    self.arrivals_ns[topic][from_stamp(taken[0][STAMP])] = taken[1]["received_timestamp"]

    def latencies_ms(self, topic: str) -> FloatArray:
        """Return the times from the last message of each sample to what came of it."""
        arrivals = self.arrivals_ns[topic].items()
        return np.array([(arrived - self.last_stamp_ns[stamp]) / 1e6 for stamp, arrived in arrivals])

    def _take_health(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.figures[status.name] = {value.key: value.value for value in status.values}


def samples(calibration: Calibration, count: int, rate_hz: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return readings (N, 4, 3), scalar (N,) and attitude (N, 4) of an array that turns 3 m from a dipole."""
    time_s = np.arange(count) / rate_hz
    turns = Rotation.from_euler("zyx", np.stack([0.3 * time_s, 0.2 * np.sin(time_s), 0.2 * np.cos(time_s)], axis=1))
    dipole = Dipole(np.array([2.0, 1.5, -1.7]), np.array([50.0, -80.0, 120.0]))
    matrix = turns.as_matrix()
    world = field_at(PLACE) + dipole.field_T(np.einsum("nij,kj->nki", matrix, calibration.array.positions_m))
    noise = 1e-9 * np.random.default_rng(1000).normal(size=world.shape)
    fields = np.einsum("nji,nkj->nki", matrix, world) + noise
    scalar = np.linalg.norm(fields.mean(axis=1), axis=1)
    return calibration.errors.distort(fields), scalar, turns.as_quat()


def cpu_s(pid: int) -> float:
    """Return the processor time of all threads of a process so far."""
    threads = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((thread / "schedstat").read_text().split()[0]) for thread in threads) / 1e9


def run(
    bench: Bench, data: tuple[FloatArray, FloatArray, FloatArray], rate_hz: float, pids: Mapping[str, int]
) -> dict[str, float]:
    """Publish samples at a rate and return the processor time that each process took for one, seconds."""
    every, pause = max(1, round(rate_hz / IMU_HZ)), max(1, round(rate_hz / 50))
    before = {name: cpu_s(pid) for name, pid in pids.items()}
    start = time.perf_counter() + 0.01
    for index, (readings, scalar, attitude) in enumerate(zip(*data, strict=True)):
        bench.spin_until(start + index / rate_hz)
        bench.publish(readings, float(scalar), attitude if index % every == 0 else None)
        if index % pause == 0:
            bench.take()
    spent = {name: cpu_s(pid) - before[name] for name, pid in pids.items()}
    limit = time.perf_counter() + SETTLE_S
    while time.perf_counter() < limit:
        bench.spin_until(time.perf_counter() + 0.05)
        bench.take()
    return {name: seconds / len(data[0]) for name, seconds in spent.items()}


def in_pieces(
    data: tuple[FloatArray, FloatArray, FloatArray], count: int
) -> Sequence[tuple[FloatArray, FloatArray, FloatArray]]:
    """Return samples in so many pieces of equal size."""
    readings, scalar, attitude = (np.split(part, count) for part in data)
    return list(zip(readings, scalar, attitude, strict=True))
