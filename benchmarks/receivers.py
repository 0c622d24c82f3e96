"""What it costs to receive a message in rclpy: executors, message objects or bytes, woken by each or by a timer.

Run ``python benchmarks/receivers.py [--seconds 5]``. Five topics of MagneticField whose messages arrive together, as
those of four sensors and a scalar do, are received by a process that does nothing else; its processor time is told.
"""

import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np
from asked import Figure
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from sensor_msgs.msg import MagneticField
from spread import machine
from streaming_bench import SENSOR_TOPICS

from tam_calibration.files.text_files import write_whole
from tam_calibration.nodes.session import Children, ros_session
from tam_calibration.nodes.topics import STREAM, MessageWriter, to_stamp, waiting

RESULTS = Path(__file__).parent / "results" / "receivers.csv"
WARM_S = 2.0
"""Time before the measurement, in which publisher and subscriber find each other."""
WAYS = {
    "default executor, objects": (False, 0.0),
    "events executor, objects": (False, 0.0),
    "events executor, bytes": (True, 0.0),
    "bytes, taken every 2 ms": (True, 0.002),
    "bytes, taken every 5 ms": (True, 0.005),
}
"""Whether messages stay serialised, and the period in which they are taken; 0: by the executor."""


class Receiver(Node):
    """Receives the topics and counts."""

    def __init__(self, is_raw: bool, period_s: float) -> None:
        super().__init__("receiver")
        self.count, self._is_hidden = 0, period_s > 0
        self._own = [
            self.create_subscription(MagneticField, topic, self._take, STREAM, raw=is_raw) for topic in SENSOR_TOPICS
        ]
        if period_s:
            self.create_timer(period_s, self._take_all, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def subscriptions(self):  # type: ignore[no-untyped-def]
        """Those that the executor waits on."""
        return iter(()) if self._is_hidden else super().subscriptions

    def _take(self, message: object) -> None:
        self.count += 1

    def _take_all(self) -> None:
        self.count += sum(1 for each in self._own for _ in waiting(each))


def receive(way: str, seconds: float) -> None:
    """Receive for a while and print the processor time for a message, microseconds."""
    with ros_session(exit_code=0):
        executor: Executor = SingleThreadedExecutor() if way.startswith("default") else EventsExecutor()
        receiver = Receiver(*WAYS[way])
        executor.add_node(receiver)
        while not receiver.count:
            executor.spin_once(timeout_sec=0.1)
        _spin(executor, WARM_S / 2)
        spent, count = time.process_time(), receiver.count
        _spin(executor, seconds)
        print(1e6 * (time.process_time() - spent) / (receiver.count - count), flush=True)
        _spin(executor, 60.0)


def _spin(executor: Executor, seconds: float) -> None:
    limit = time.perf_counter() + seconds
    while (left := limit - time.perf_counter()) > 0:
        executor.spin_once(timeout_sec=min(left, 0.5))


def measure(way: str, rate_hz: float, seconds: float) -> float:
    """Return the processor time for a message, microseconds."""
    command = [__file__, "--way", way, "--seconds", str(seconds)]
    with TemporaryDirectory() as logs, Children({"receiver": command}, Path(logs)) as children:
        node = Node("sensors")
        publishers = [node.create_publisher(MagneticField, topic, STREAM) for topic in SENSOR_TOPICS]
        writer, doubles = MessageWriter(MagneticField(), 12), np.zeros(12).tobytes()
        while not all(each.get_subscription_count() for each in publishers):
            children.check()
            time.sleep(0.05)
        start = time.perf_counter()
        for index in range(round(rate_hz * (WARM_S + seconds))):
            time.sleep(max(0.0, start + index / rate_hz - time.perf_counter()))
            for publisher in publishers:
                publisher.publish(writer.message(to_stamp(time.time_ns()), doubles))
        node.destroy_node()
        return float(children.log("receiver").split()[-1])


@click.command(help=__doc__)
@click.option("--seconds", default=5.0, show_default=True, type=click.FloatRange(2), help="Length of each run.")
@click.option("--way", hidden=True)
def main(seconds: float, way: str | None) -> None:
    """Measure and print."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    if way:
        receive(way, seconds - 1)
        return
    figures = []
    with ros_session(exit_code=0):
        for rate_hz in (100.0, 1000.0):
            for name in WAYS:
                value = measure(name, rate_hz, seconds)
                figures.append(Figure(f"5 × {rate_hz:g} Hz", name, "processor time for a message, µs", value))
                print(f"{rate_hz:6g} Hz  {name:28}  {value:6.1f} µs", file=sys.stderr)
    with write_whole(RESULTS) as part:
        lines = [
            f"# python benchmarks/receivers.py on {machine()}",
            "case,method,figure,value,standard_error,asked,met",
        ]
        part.write_text("\n".join([*lines, *(figure.line for figure in figures)]) + "\n")


if __name__ == "__main__":
    main()
