"""Shared fixtures: a recording with a known truth, a ROS domain of its own, nodes as processes and a client of them."""

import fcntl
import os
import tempfile
import time
from importlib.resources import files
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from tam_calibration.array import Array
from tam_calibration.errors import SensorErrors
from tam_calibration.recording import Recording
from tam_calibration.units import from_degrees, from_nanotesla

# Messages read this when they are imported: a field of the wrong type is then refused, not sent as rubbish.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"


def pytest_configure(config):
    """Let pass what ROS's message packages warn of: an old parser of theirs."""
    config.addinivalue_line("filterwarnings", "ignore:module 'sre_:DeprecationWarning")


NO_ROS = "rclpy is not installed: pip install 'tam_calibration[ros]'"


@pytest.fixture(scope="session")
def cross():
    """Return the array that the nodes have without an array file."""
    return Array.cross(0.5, vector_noise_T=1e-9, scalar_noise_T=1e-10)


@pytest.fixture(scope="session")
def true_errors():
    """Return errors of the size of Wu 2025 Table 1."""
    rng = np.random.default_rng(2025)
    misalignment = from_degrees(rng.uniform(-2, 2, (4, 3)))
    misalignment[0] = 0
    return SensorErrors(
        1 + rng.uniform(-0.02, 0.02, (4, 3)),
        from_degrees(rng.uniform(-1, 1, (4, 3))),
        from_nanotesla(rng.uniform(-900, 900, (4, 3))),
        misalignment,
    )


@pytest.fixture(scope="session")
def recording(true_errors):
    """Return 600 samples at 100 Hz of a cross that is turned through all directions in 50 µT, with 1 nT of noise."""
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(600, 3))
    intensity = 50e-6 + 5e-9 * np.sin(np.linspace(0, 6, 600))
    field = direction / np.linalg.norm(direction, axis=1, keepdims=True) * intensity[:, None]
    readings = true_errors.distort(field) + 1e-9 * rng.normal(size=(600, 4, 3))
    return Recording(1.7e9 + np.arange(600) / 100, readings, intensity + 1e-10 * rng.normal(size=600))


@pytest.fixture(scope="session")
def passing(true_errors, cross):
    """Return 600 samples of a platform that passes a dipole at 1.5 m/s eastwards while it turns, 3.4 m away at best."""
    from scipy.spatial.transform import Rotation

    from tam_calibration.localization.dipole import Dipole

    time = np.arange(600) / 20
    place = np.outer(time, [1.5, 0, 0])
    turns = Rotation.from_euler("zyx", np.stack([0.6 * np.sin(time / 3), 0.1 * np.sin(time), 0.2 * np.cos(time)], 1))
    dipole = Dipole(np.array([30.0, 2.5, -2.3]), np.array([40.0, -60.0, 150.0]))
    sensors = place[:, None] + np.einsum("nij,kj->nki", turns.as_matrix(), cross.positions_m)
    world = np.array([1e-6, 21e-6, -43e-6]) + dipole.field_T(sensors)
    fields = np.einsum("nji,nkj->nki", turns.as_matrix(), world)
    noise = 1e-9 * np.random.default_rng(30).normal(size=fields.shape)
    return Recording(1.7e9 + time, true_errors.distort(fields) + noise, attitude=turns.as_quat())


@pytest.fixture(scope="session")
def gap():
    """Return the gap of 400 samples of a cross whose sensor 2 drifts with a temperature that rises by 10 °C."""
    from tam_calibration.effects.fitted import Contribution, FittedEffect
    from tam_calibration.gap.result import Cause, Considered, Gap, Residue, Size, Where

    rng = np.random.default_rng(8)
    direction = rng.normal(size=(400, 3))
    temperature = np.linspace(15.0, 25.0, 400)
    floor = np.append(np.full(12, 1e-9), 1e-10)
    after, twin = floor * rng.normal(size=(400, 13)), floor * rng.normal(size=(400, 13))
    before = after.copy()
    before[:, 3:6] += 1e-9 * (temperature - 20)[:, None]
    residue = Residue(
        np.arange(400) / 100,
        direction / np.linalg.norm(direction, axis=1, keepdims=True),
        before,
        after,
        twin,
        floor,
        temperature,
    )
    offsets = [Contribution(1, axis, "offset", {"offset": 1e-9 * (axis + 1)}, {"offset": 2e-11}) for axis in range(3)]
    fitted = FittedEffect("temperature_drift", {"time constant": 60.0}, tuple(offsets), {"time constant": 5.0})
    units = {"offset": "T/K", "time constant": "s"}
    cause = Cause(fitted, units, (2,), ("x", "y", "z"), 0.98, 1.0, 640.0, 0.97, ("bias_jump",))
    return Gap(
        "explained",
        Size(1.9, 0.08, 1.9e-9, 8e-11, 5.4e-9, 2.2e-10, 1e-9, 0.998, (0.99, 1.0)),
        Where((2,), ("x", "y", "z"), None, (0.0, 0.5), {"differential": 1.9, "common_mode": float("nan")}),
        (cause,),
        (
            Considered("temperature_drift", "supported", "explains 97 % of the gap out of sample", 640.0, 0.97),
            Considered("hysteresis", "not_supported", "explains 2 % of the gap out of sample", -12.0, 0.02),
            Considered("flexure", "channel_missing", "needs the attitude"),
            Considered("eddy_current", "not_identifiable", "the array was at rest"),
        ),
        {"no_gap": 0.0, "temperature_drift": 0.98, "bias_jump": 0.015, "none_of_these": 0.005},
        "Record 20 min at rest while it warms up: that tells temperature_drift from bias_jump.",
        "The readings of sensor 2 drift with its temperature, which explains the gap.",
        residue,
    )


@pytest.fixture(scope="session")
def wu2025_sweeps():
    """Return the sweeps of Wu 2025 with two runs a point; few groups in the jackknife make the fits quick."""
    from functools import partial
    from importlib import import_module

    from tam_calibration.files.scenario import read_scenario
    from tam_calibration.reproduce.sweep import sweeps_of, tasks_of
    from tam_calibration.reproduce.wu2025_sweeps import plans, score

    planned = plans(read_scenario("wu_table_1"))
    with pytest.MonkeyPatch.context() as patch:
        lossless = import_module("tam_calibration.fit.lossless")
        patch.setattr(lossless, "gather", partial(lossless.gather, groups=2))
        results = [score(*task) for task in tasks_of(list(planned.values()), 2)]
    return dict(zip(planned, sweeps_of(list(planned.values()), results), strict=True))


@pytest.fixture
def ros_domain(monkeypatch, tmp_path_factory):
    """Give the test a ROS domain that no other test of this machine uses, and a place for logs; return that place."""
    pytest.importorskip("rclpy", reason=NO_ROS)
    logs = tmp_path_factory.mktemp("ros")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(logs))
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(files("tam_calibration") / "config" / "fastdds.xml"))
    domain, lock = _lock_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    yield logs
    os.close(lock)


def _lock_domain():
    for domain in range(1, 102):
        lock = os.open(Path(tempfile.gettempdir()) / f"ros_domain_{domain}.lock", os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
        else:
            return domain, lock
    raise RuntimeError("all ROS domains from 1 to 101 are taken")


def figures_of(status):
    """Return the figures of a status as a dictionary."""
    return {value.key: value.value for value in status.values}


class Bench:
    """A ROS client in the test, and the processes that it watches."""

    def __init__(self, logs):
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        self.logs = logs
        self.children = []
        self.context = rclpy.Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("bench", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._health = None
        self._sensor_topics = []

    def close(self):
        """End the processes and check that each ended well."""
        codes = [children.end() for children in self.children]
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
        assert all(code == 0 for each in codes for code in each.values()), codes

    def start(self, commands):
        """Start processes of the Python interpreter: a mapping of names to arguments."""
        from tam_calibration.nodes.children import Children

        children = Children(commands, self.logs / str(len(self.children))).__enter__()
        self.children.append(children)
        return children

    def start_nodes(self, **parameters):
        """Start nodes, each with its parameters, and wait until they are seen."""
        commands = {
            name: ["-m", f"tam_calibration.nodes.{name}", "--ros-args"]
            + [part for key, value in own.items() for part in ("-p", f"{key}:={value}")]
            for name, own in parameters.items()
        }
        children = self.start(commands)
        self.spin_until(lambda: set(commands) <= set(self.node.get_node_names()), f"{list(commands)} are seen")
        return children

    def spin_until(self, condition, what, timeout_s=15.0):
        """Spin until a condition holds; fail at once, with its output, when a process has ended."""
        limit = time.monotonic() + timeout_s
        while not condition():
            for children in self.children:
                children.check()
            assert time.monotonic() < limit, f"not within {timeout_s} s: {what}"
            self.executor.spin_once(timeout_sec=0.02)

    def listen(self, message_type, topic, latched=False):
        """Return a list to which the messages of a topic are appended, once a publisher has been matched."""
        from rclpy.qos import DurabilityPolicy, QoSProfile

        quality = QoSProfile(depth=1000)
        if latched:
            quality.durability = DurabilityPolicy.TRANSIENT_LOCAL
        received = []
        self.node.create_subscription(message_type, topic, received.append, quality)
        self.spin_until(lambda: self.node.count_publishers(topic), f"{topic} is published")
        return received

    def call(self, service):
        """Call a Trigger service and return its response."""
        from std_srvs.srv import Trigger

        client = self.node.create_client(Trigger, service)
        self.spin_until(client.service_is_ready, f"{service} is there")
        future = client.call_async(Trigger.Request())
        self.spin_until(future.done, f"{service} answers")
        self.node.destroy_client(client)
        return future.result()

    def health(self, name, condition, what):
        """Spin until a node's next status and figures in /diagnostics fulfil a condition, and return both."""
        from diagnostic_msgs.msg import DiagnosticArray

        if self._health is None:
            self._health = self.listen(DiagnosticArray, "/diagnostics")
        self._health.clear()
        found = []

        def is_found():
            statuses = [status for message in self._health for status in message.status if name in ("", status.name)]
            found[:] = [(each, figures) for each in statuses if condition(each, figures := figures_of(each))]
            return found

        self.spin_until(is_found, what)
        return found[-1]

    def connect(self, **subscribers):
        """Wait until nodes have matched so many subscribers of their topics, and the collector all sensors."""
        missing = {
            name: {(f"subscribers./{topic}", str(number)) for topic, number in topics.items()}
            for name, topics in subscribers.items()
        }
        missing["collector"] |= {(f"publishers./{topic}", "1") for topic in self._sensor_topics}

        def is_connected(status, figures):
            if missing.get(status.name, set()) <= figures.items():
                missing.pop(status.name, None)
            return not missing

        self.health("", is_connected, f"{subscribers} are connected")

    def publish_sensors(self, sensors=(1, 2, 3, 4), scalar=True):
        """Return a function that publishes samples of a recording on the sensors' topics."""
        from sensor_msgs.msg import MagneticField

        topics = [f"tam_{sensor}/magnetic_field" for sensor in sensors] + ["scalar/intensity"] * scalar
        publishers = [self.node.create_publisher(MagneticField, topic, 1000) for topic in topics]
        self.spin_until(lambda: all(each.get_subscription_count() for each in publishers), "the sensors are subscribed")
        self._sensor_topics += topics
        columns = [sensor - 1 for sensor in sensors]

        def publish(recording, index):
            lap, row = divmod(index, recording.sample_count)
            fields = recording.readings_T[row, columns].tolist()
            if scalar:
                fields.append([float(recording.scalar_T[row]), 0.0, 0.0])
            for publisher, field in zip(publishers, fields, strict=True):
                publisher.publish(_message(recording.time_s[row] + 10 * lap, field))

        return publish

    def stream(self, recording, publishers):
        """Publish samples at 100 Hz while the bench spins, by each function of a list."""
        indices = count()

        def publish_next():
            index = next(indices)
            for publish in publishers:
                publish(recording, index)

        self.node.create_timer(0.01, publish_next)

    def play(self, recording, publish, samples, first=0, last=None):
        """Publish samples one after another, no faster than they come back as messages on `samples`."""
        before = len(samples)
        for done, index in enumerate(range(first, recording.sample_count if last is None else last)):
            publish(recording, index)
            self.spin_until(lambda done=done: len(samples) >= before + done - 20, f"sample {index} comes back")
        self.spin_until(lambda: len(samples) == before + done + 1, "all samples come back")


def _message(time_s, field):
    from geometry_msgs.msg import Vector3
    from rclpy.time import Time
    from sensor_msgs.msg import MagneticField

    message = MagneticField(magnetic_field=Vector3(x=field[0], y=field[1], z=field[2]))
    message.header.stamp = Time(nanoseconds=round(time_s * 1e9)).to_msg()
    return message


@pytest.fixture
def bench(ros_domain):
    """Return a ROS client; at the end its processes must end with exit code 0."""
    bench = Bench(ros_domain)
    yield bench
    bench.close()
