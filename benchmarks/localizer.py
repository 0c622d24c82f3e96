"""Latency of the localizer: from the publication of `field_gradient` at 100 Hz to the arrival of its answer.

Run ``python benchmarks/localizer.py [--seconds 30]``. The node is a process of its own, over DDS on this machine; the
latency holds both transports, the join with the attitude of `samples`, and the fit. The answers are compared with those
of one call for all samples. A dipole 3 m away in the Earth's field, 1 nT of noise, regional field of IGRF. The node
takes a third of a core: on a machine whose cores are shared the latency is that of the queue, so the load is told too.
"""

import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np
from asked import ANYTHING, Figure
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.time import Time
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from spread import machine
from std_msgs.msg import Header

from tam_calibration.files.text_files import configuration_folder, write_whole
from tam_calibration.localization.turned_samples import Regional, Samples, locate_samples
from tam_calibration.messages.point_cloud import FIELD_GRADIENT_COLUMNS, SampleLayout
from tam_calibration.model.array import Array
from tam_calibration.model.geomagnetic_field import LOCAL_VARIANCE_T2, field_at
from tam_calibration.model.units import FloatArray
from tam_calibration.nodes.localizer_node import source_rows
from tam_calibration.nodes.session import Children, ros_session
from tam_calibration.nodes.topics import RELIABLE_STREAM, make_cloud, read_cloud
from tam_calibration.recordings import read_array
from tam_calibration.sources.dipole import Dipole

RATE_HZ = 100.0
"""Of the samples, as in every figure of the stream."""
PLACE = "47.37,8.54,2026-06-01"
NOISE_T = 1e-9
"""Standard deviation of an axis: that of the array that is shipped."""
START_S, END_S = 20.0, 5.0
"""Longest wait for the start of the nodes, and for the last answers."""
LAYOUT = SampleLayout(4, ("attitude",))
CROSS = configuration_folder() / "cross.yaml"
RESULTS = Path(__file__).parent / "results" / "localizer.csv"


class Bench(Node):
    """Publishes samples and outputs, and keeps when each was answered, and how."""

    def __init__(self) -> None:
        super().__init__("bench")
        self._executor = EventsExecutor()
        self._executor.add_node(self)
        self._samples = self.create_publisher(PointCloud2, "samples", RELIABLE_STREAM)
        self._outputs = self.create_publisher(PointCloud2, "field_gradient", RELIABLE_STREAM)
        self.create_subscription(PointCloud2, "source_estimate", self._take, RELIABLE_STREAM)
        self.published_s: dict[int, float] = {}
        self.answered_s: dict[int, float] = {}
        self.rows: dict[int, FloatArray] = {}

    @property
    def is_connected(self) -> bool:
        """Whether the localizer has found all topics."""
        ours = (self._samples, self._outputs)
        return all(each.get_subscription_count() for each in ours) and self.count_publishers("source_estimate") > 0

    def spin_until(self, limit_s: float) -> None:
        """Take answers until a time of the clock."""
        while (left := limit_s - time.perf_counter()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def publish(self, index: int, sample: list[float], row: list[float]) -> None:
        """Publish a sample, and its outputs at once."""
        header = Header(stamp=Time(nanoseconds=round((index + 1) * 1e9 / RATE_HZ)).to_msg(), frame_id="tam_array")
        clouds = make_cloud(header, LAYOUT.columns, sample), make_cloud(header, FIELD_GRADIENT_COLUMNS, row)
        self._samples.publish(clouds[0])
        self.published_s[index] = time.perf_counter()
        self._outputs.publish(clouds[1])

    def _take(self, cloud: PointCloud2) -> None:
        stamp_ns = cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec
        index = round(stamp_ns * RATE_HZ / 1e9) - 1
        self.answered_s[index] = time.perf_counter()
        self.rows[index] = read_cloud(cloud)[1][0]


@click.command(help=__doc__)
@click.option("--seconds", default=30.0, show_default=True)
def main(seconds: float) -> None:
    """Measure and print."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    array = read_array(CROSS)
    attitude, outputs, errors = samples(array, round(seconds * RATE_HZ))
    command = ["-m", "tam_calibration.nodes.start", "localizer", "--ros-args", "-p", f"regional:='{PLACE}'"]
    with (
        TemporaryDirectory() as logs,
        ros_session(exit_code=0),
        Children({"localizer": command}, Path(logs)) as children,
    ):
        bench = Bench()
        limit = time.perf_counter() + START_S
        while not bench.is_connected and time.perf_counter() < limit:
            children.check()
            bench.spin_until(time.perf_counter() + 0.05)
        run(bench, attitude, outputs, errors)
        bench.destroy_node()
    show(bench, array, attitude, outputs, errors)


def samples(array: Array, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return attitudes (N, 4), outputs (N, 9) and their standard errors (9,) of an array that turns before a dipole."""
    rng = np.random.default_rng(100)
    time_s = np.arange(count) / RATE_HZ
    turns = Rotation.from_euler("zyx", np.stack([0.3 * time_s, 0.2 * np.sin(time_s), 0.2 * np.cos(time_s)], axis=1))
    dipole = Dipole(np.array([2.0, 1.5, -1.7]), np.array([50.0, -80.0, 120.0]))
    matrix = turns.as_matrix()
    world = field_at(PLACE) + dipole.field_T(np.einsum("nij,kj->nki", matrix, array.positions_m))
    fields = np.einsum("nji,nkj->nki", matrix, world) + NOISE_T * rng.normal(size=world.shape)
    outputs = fields.reshape(count, -1) @ array.operator.T
    return turns.as_quat(), outputs, NOISE_T * np.sqrt(np.sum(array.operator**2, axis=1))


def run(bench: Bench, attitude: FloatArray, outputs: FloatArray, errors: FloatArray) -> None:
    """Publish at the rate, each at its time, and wait for what is still to be answered."""
    readings, start = [0.0] * 12, time.perf_counter() + 0.1
    for index, (turn, row) in enumerate(zip(attitude, outputs, strict=True)):
        bench.spin_until(start + index / RATE_HZ)
        bench.publish(index, [(index + 1) / RATE_HZ, *readings, *turn.tolist()], [*row.tolist(), *errors.tolist()])
    limit = time.perf_counter() + END_S
    while len(bench.answered_s) < len(outputs) and time.perf_counter() < limit:
        bench.spin_until(time.perf_counter() + 0.01)


def show(bench: Bench, array: Array, attitude: FloatArray, outputs: FloatArray, errors: FloatArray) -> None:
    """Print and keep the figures."""
    answered = sorted(bench.rows)
    latency_ms = 1e3 * np.array([bench.answered_s[index] - bench.published_s[index] for index in answered])
    regional = Regional(field_at(PLACE), 0.0, LOCAL_VARIANCE_T2)
    offline = source_rows(locate_samples(Samples(outputs, array, np.diag(errors**2), attitude), regional))
    expected, live = offline[answered], np.array([bench.rows[index] for index in answered])
    off = np.nanmax(np.abs(live - expected) / np.abs(np.where(expected == 0, 1, expected)))
    case = f"{len(outputs)} samples at {RATE_HZ:g} Hz"
    names = {
        "unanswered samples": (float(len(outputs) - len(answered)), (0.0, 0.5)),
        "latency p50, ms": (float(np.median(latency_ms)), ANYTHING),
        "latency p99, ms": (float(np.percentile(latency_ms, 99)), (0.0, 10.0)),
        "largest latency, ms": (float(latency_ms.max()), ANYTHING),
        "largest relative difference from offline": (float(off), (0.0, 1e-12)),
        "located, fraction": (float(np.mean(live[:, -1] == 0)), ANYTHING),
        "load of the machine, processes per core": (os.getloadavg()[0] / (os.cpu_count() or 1), ANYTHING),
    }
    figures = [Figure(case, "localizer", name, value, asked=asked) for name, (value, asked) in names.items()]
    table = Table("figure", "value", "asked", "met", title=case)
    for figure in figures:
        table.add_row(figure.name, f"{figure.value:.4g}", figure.asked_in_words, figure.verdict)
    Console().print(table)
    lines = [f"# python benchmarks/localizer.py on {machine()}", "case,method,figure,value,standard_error,asked,met"]
    with write_whole(RESULTS) as part:
        part.write_text("\n".join([*lines, *(figure.line for figure in figures)]) + "\n")


if __name__ == "__main__":
    main()
