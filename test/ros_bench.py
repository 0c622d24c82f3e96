"""Fixtures with ROS: a domain that no other test uses, nodes as processes and a client of them."""

import os
import signal
import time
from contextlib import contextmanager
from itertools import count
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest
from forked_children import ForkedChildren, end_forked, start_server
from ros_domains import lock_domain

from tam_calibration.files.text_files import configuration_folder
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.nodes.session import START, Children

NO_ROS = "rclpy is not installed: pip install 'tam_calibration[ros]'"

_PATIENCE_S = 60.0
"""For whatever will come, also beside others on few cores."""

_LOOK_S = 0.1
"""From one look at whether processes still run to the next."""

_AHEAD_S = 0.2
"""Less than the 0.25 s of stamps that a collector waits for a sensor whose messages come later than those of others."""

DRIVER = str(Path(__file__).parent / "nodes" / "sensor_driver.py")


@pytest.fixture
def ros_domain(monkeypatch, tmp_path_factory):
    """Give the test a ROS domain that no other test of this machine uses, and a place for logs; return that place."""
    with own_domain(monkeypatch, tmp_path_factory) as logs:
        yield logs


@contextmanager
def own_domain(monkeypatch, tmp_path_factory):
    """Set the variables of such a domain, and end what is left there when it is over."""
    pytest.importorskip("rclpy", reason=NO_ROS)
    logs, others = tmp_path_factory.mktemp("ros"), active_children()
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(logs))
    monkeypatch.setenv("ROS_HOME", str(logs))
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(configuration_folder() / "fastdds.xml"))
    domain, lock = lock_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    yield logs
    end_forked(others)  # of a test that failed, as what is started: the next one has this domain
    for process in processes_of(logs):
        os.kill(process, signal.SIGKILL)
    os.close(lock)


def figures_of(status):
    """Return the figures of a status as a dictionary."""
    return {value.key: value.value for value in status.values}


def rows_of(clouds):
    """Return the rows of one-row clouds, one below the other."""
    from tam_calibration.nodes.topics import read_cloud

    return np.concatenate([read_cloud(cloud)[1] for cloud in clouds])


def processes_of(logs):
    """Return the numbers of the processes, of any parent, that were started with this place for logs."""
    marked = f"ROS_LOG_DIR={logs}\0".encode()
    return [int(folder.name) for folder in Path("/proc").glob("[0-9]*") if marked in _environment(folder)]


def _environment(folder):
    try:
        return (folder / "environ").read_bytes()
    except OSError:  # it has ended, or is another user's
        return b""


def node_command(name, parameters):
    """Return the arguments of the Python interpreter that run a node with parameters."""
    settings = [part for key, value in parameters.items() for part in ("-p", f"{key}:={value}")]
    return [*START, name, "--ros-args", *settings]


def own_lines(log):
    """Return the lines that a process said itself: Fast DDS writes of a port of shared memory into the same log.

    Where many processes begin at once on few cores, it waits 2 s for the lock of a port, says that it has not got it,
    and takes the next (eProsima/Fast-DDS, issue 6117).
    """
    return [line for line in log.splitlines() if "RTPS_TRANSPORT_SHM" not in line]


class Bench:
    """A ROS client in the test, and the processes that it watches."""

    def __init__(self, logs):
        import rclpy
        from rclpy.experimental.events_executor import EventsExecutor
        from rclpy.signals import SignalHandlerOptions

        self.logs = logs
        self.children = []
        self.context = rclpy.Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("bench", context=self.context)
        self.executor = EventsExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._health = None
        self._next_look_s = 0.0
        self._sensor_topics = []

    def close(self):
        """End the processes and check that each ended well."""
        codes = [children.end() for children in self.children]
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
        assert all(code == 0 for each in codes for code in each.values()), codes

    def start(self, commands, kind=Children):
        """Start processes of the Python interpreter: a mapping of names to arguments."""
        children = kind(commands, self.logs / str(len(self.children))).__enter__()
        self.children.append(children)
        return children

    def fork(self, commands):
        """Start the same with their libraries loaded, where a test is not about how a process begins or ends."""
        return self.start(commands, ForkedChildren)

    def start_nodes(self, **parameters):
        """Start nodes, each with its parameters, and wait until they are seen."""
        children = self.fork({name: node_command(name, own) for name, own in parameters.items()})
        self.spin_until(lambda: set(parameters) <= set(self.node.get_node_names()), f"{list(parameters)} are seen")
        return children

    def spin_until(self, condition, what, timeout_s=_PATIENCE_S):
        """Spin until a condition holds; fail at once, with its output, when a process has ended otherwise."""
        limit = time.monotonic() + timeout_s
        while not condition():
            now = time.monotonic()
            if now >= self._next_look_s:
                self._next_look_s = now + _LOOK_S
                try:
                    for children in self.children:
                        children.check()
                except (InputError, Refused):
                    if condition():  # the end of a process may be what is awaited
                        return
                    raise
            assert now < limit, f"not within {timeout_s} s: {what}{self._said()}"
            self.executor.spin_once(timeout_sec=0.02)

    def _said(self):
        """Return what the nodes said last, where their health is heard."""
        statuses = [status for message in self._health or () for status in message.status]
        return "".join(f"; {name}: {said}" for name, said in {each.name: each.message for each in statuses}.items())

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

    def call(self, service, meanwhile=lambda: None, timeout_s=_PATIENCE_S):
        """Call a Trigger service, do something while it works, and return its response."""
        from std_srvs.srv import Trigger

        return self._ask(Trigger, service, Trigger.Request(), meanwhile, timeout_s)

    def set_parameter(self, node, name, value):
        """Set a parameter of a node and return the reason of its refusal; empty when it is set."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        [result] = self._ask(SetParameters, f"{node}/set_parameters", request).results
        assert result.successful != bool(result.reason)
        return result.reason

    def _ask(self, service_type, service, request, meanwhile=lambda: None, timeout_s=_PATIENCE_S):
        client = self.node.create_client(service_type, service)
        self.spin_until(client.service_is_ready, f"{service} is there")
        future = client.call_async(request)
        meanwhile()
        self.spin_until(future.done, f"{service} answers", timeout_s)
        self.node.destroy_client(client)
        return future.result()

    def storm(self, service, count=200):
        """Call a Trigger service many times at once and return the answers."""
        from rclpy.qos import QoSProfile
        from std_srvs.srv import Trigger

        client = self.node.create_client(Trigger, service, qos_profile=QoSProfile(depth=1000))
        self.spin_until(client.service_is_ready, f"{service} is there")
        known = client.call_async(Trigger.Request())
        self.spin_until(known.done, f"{service} knows the client")
        futures = [client.call_async(Trigger.Request()) for _ in range(count)]
        self.spin_until(lambda: all(future.done() for future in futures), "every call is answered")
        self.node.destroy_client(client)
        return [future.result() for future in futures]

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

    def stored(self, count):
        """Wait until the calibrator has stored so many samples, which it takes later than they come back here."""
        self.health("calibrator", lambda _, figures: figures["samples"] == str(count), f"{count} samples are stored")

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

        from tam_calibration.nodes.topics import MessageWriter, to_stamp

        topics = [f"tam_{sensor}/magnetic_field" for sensor in sensors] + ["scalar/intensity"] * scalar
        publishers = [self.node.create_publisher(MagneticField, topic, 1000) for topic in topics]
        self.spin_until(lambda: all(each.get_subscription_count() for each in publishers), "the sensors are subscribed")
        self._sensor_topics += topics
        columns, write = [sensor - 1 for sensor in sensors], MessageWriter(MagneticField(), 12).message

        def publish(recording, index):
            lap, row = divmod(index, recording.sample_count)
            fields = np.zeros((len(topics), 12))
            fields[: len(columns), :3] = recording.readings_T[row, columns]
            if scalar:
                fields[-1, 0] = recording.scalar_T[row]
            stamp = to_stamp(round((recording.time_s[row] + 10 * lap) * 1e9))
            for publisher, field in zip(publishers, fields, strict=True):
                publisher.publish(write(stamp, field.tobytes()))

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
        """Publish samples one after another, no faster than they come back as messages on `samples`.

        Those that are on their way span less than the patience of the collector: topics may arrive one after another.
        """
        before = len(samples)
        ahead = max(1, min(20, int(_AHEAD_S / np.median(np.diff(recording.time_s)))))
        for done, index in enumerate(range(first, recording.sample_count if last is None else last)):
            publish(recording, index)
            self.spin_until(lambda done=done: len(samples) >= before + done - ahead, f"sample {index} comes back")
        self.spin_until(lambda: len(samples) == before + done + 1, "all samples come back")


def field_of_array(time_s):
    """Return the field (N, 3) in the frame of an array that is turned at some 100°/s through all directions."""
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_euler("zxy", np.outer(time_s, [90.0, 37.0, 23.0]), degrees=True)
    return turned.inv().apply([12e-6, 18e-6, -45e-6])


def write_driver(folder, name, stamps_s, readings_T, speed=1.0):
    """Write what a driver publishes, faster than its stamps by a speed, and return its command."""
    path = folder / f"{name.replace('/', '_')}.npz"
    np.savez(path, stamps_s=stamps_s, readings_T=readings_T, speed=speed)
    return [DRIVER, name, str(path)]


@pytest.fixture(scope="session")
def fork_server():
    """Start what nodes are forked from, before a test sets variables of ROS, by which what it leaves is found."""
    start_server()


@pytest.fixture
def bench(fork_server, ros_domain, monkeypatch):
    """Return a ROS client; at the end its processes must end with exit code 0, on a busy machine not within seconds."""
    with _watched(ros_domain, monkeypatch) as bench:
        yield bench


@contextmanager
def _watched(logs, monkeypatch):
    monkeypatch.setattr("tam_calibration.nodes.session._GRACE_S", _PATIENCE_S)
    bench = Bench(logs)
    yield bench
    bench.close()


class Board:
    """Collector and calibrator that the tests of a module share: each of them starts over."""

    def __init__(self, bench):
        from sensor_msgs.msg import PointCloud2

        self.bench = bench
        bench.start_nodes(collector={}, calibrator={})
        self.samples = bench.listen(PointCloud2, "samples")
        self.others, self.third = bench.publish_sensors((1, 2, 4)), bench.publish_sensors((3,), scalar=False)
        bench.connect(collector={"samples": 2})
        self._changed, self._stored = {}, 0

    def start_over(self, **parameters):
        """Forget the samples, and set these parameters of the calibrator and none beside them."""
        from tam_calibration.nodes.calibrator_node import RULES

        assert self.bench.call("collector/reset").success
        self._stored = 0
        defaults = {rule.name: rule.default for rule in RULES if rule.name in self._changed}
        self._changed = {name: str(each) if isinstance(each, Path) else each for name, each in parameters.items()}
        for name, value in (defaults | self._changed).items():
            assert self.set_parameter(name, value) == ""

    def play(self, recording, **parameters):
        """Start over, and publish a recording until every sample is stored."""
        self.start_over(**parameters)
        self.go_on(recording)

    def go_on(self, recording):
        """Publish a recording until every sample is stored."""
        self.bench.play(recording, self.publish, self.samples)
        self._stored += recording.sample_count
        self.bench.stored(self._stored)

    def publish(self, recording, index):
        """Publish a sample of a recording: all readings, those of the third sensor last."""
        self.others(recording, index)
        self.third(recording, index)

    def set_parameter(self, name, value):
        """Set a parameter of the calibrator and return the reason of its refusal; empty when it is set."""
        self._changed.setdefault(name, value)
        return self.bench.set_parameter("calibrator", name, value)

    def ask(self, service):
        """Call a service of the calibrator, however long it takes, and return its response."""
        return self.bench.call(f"calibrator/{service}", timeout_s=3 * _PATIENCE_S)


@pytest.fixture(scope="module")
def board(fork_server, tmp_path_factory):
    """Return collector and calibrator in a domain of their own, for all tests of a module."""
    with (
        pytest.MonkeyPatch.context() as monkeypatch,
        own_domain(monkeypatch, tmp_path_factory) as logs,
        _watched(logs, monkeypatch) as bench,
    ):
        yield Board(bench)
