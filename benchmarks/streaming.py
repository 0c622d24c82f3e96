"""The nodes at work: processor time, latency and losses of collector, corrector and localizer, beside bare rclpy.

Run ``python benchmarks/streaming.py [--seconds 60] [--repeats 4]``. Four sensors, scalar and IMU (100 Hz) of an array
that turns 3 m from a dipole are published as by drivers; the nodes are other processes, over DDS on this machine.
Times are those of the processor, so that other processes on the machine count only by the caches that they share;
latencies are those of the clock, so that they count in full: their load is told too.
`docs/explanation/streaming.md` says more.
"""

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from subprocess import Popen
from tempfile import TemporaryDirectory

import click
import numpy as np
from asked import ANYTHING, Figure
from localizer import PLACE
from rclpy.experimental.events_executor import EventsExecutor
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import MagneticField, PointCloud2
from spread import machine
from streaming_bench import IMU_TOPIC, SENSOR_TOPICS, Bench, in_pieces, run, samples

from tam_calibration.correction.calibration import Calibration
from tam_calibration.files.text_files import write_whole
from tam_calibration.fit import calibrate
from tam_calibration.nodes.session import START, Children, precede, ros_session
from tam_calibration.recordings import write_array
from tam_calibration.results import write_calibration
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate

RELAY = Path(__file__).parent / "streaming_relay.py"
RESULTS = Path(__file__).parent / "results" / "streaming.csv"
GATHER_S = 0.1
"""Gathering of samples by the localizer: ten at 100 Hz, for an answer ten times a second."""
WINDOW_S = 8.0
"""Length of a measurement: 800 samples at 100 Hz, so that a percentile of 99 rests on eight."""
NONE_LOST = (0.0, 0.5)
"""Bounds of a count that must be nought."""
BUSY = 4
"""Processes that compute all the time, on the two cores of the machine that the figures are of."""
HEARD = {"field_gradient": PointCloud2, "source_estimate": PointCloud2}
WANTED = {
    "collector": {"samples": "3"},
    "corrector": {"field_gradient": "2"},
    "localizer": {"source_estimate": "1"},
}


class Nodes:
    """The commands of the nodes, which share array and calibration."""

    def __init__(self, calibration: Calibration, folder: Path) -> None:
        self.calibration, self.folder = calibration, folder
        write_array(folder / "array.yaml", calibration.array)
        write_calibration(folder / "calibration.yaml", calibration)

    def command(self, name: str, **parameters: object) -> list[str]:
        """Return the command of a process with parameters for all of its nodes or, as node__name, for one."""
        given = {"array_file": self.folder / "array.yaml", **parameters}
        settings = [f"{key.replace('__', ':')}:={value}" for key, value in given.items()]
        return [
            *START,
            name,
            "--ros-args",
            *(part for each in settings for part in ("-p", each)),
        ]

    def all(self, gather_s: float) -> dict[str, list[str]]:
        """Return what `tam nodes` starts."""
        file = self.folder / "calibration.yaml"
        localizer = {"calibration_file": file, "regional": f"'{PLACE}'", "batch_s": gather_s}
        return {
            "stream": self.command("stream", corrector__calibration_file=file),
            "calibrator": self.command("calibrator", samples_file="none"),
            "localizer": self.command("localizer", **localizer),
        }


@contextmanager
def running(
    commands: Mapping[str, Sequence[str]], heard: Mapping[str, type], wanted: Mapping[str, Mapping[str, str]]
) -> Iterator[tuple[Bench, Children]]:
    """Run processes, and listen to topics, once nodes tell that they have so many subscribers."""
    with TemporaryDirectory() as logs, Children(commands, Path(logs)) as children:
        bench = Bench(EventsExecutor())
        for topic, message_type in heard.items():
            bench.hear(message_type, topic)
        for node, topics in wanted.items():
            figures = {f"subscribers./{topic}": count for topic, count in topics.items()}
            bench.wait_for(children, node, figures)
        bench.wait_for(children, "collector", {f"publishers./{topic}": "1" for topic in [*SENSOR_TOPICS, IMU_TOPIC]})
        yield bench, children
        bench.close()


@contextmanager
def beside_busy_processes(count: int) -> Iterator[None]:
    """Have processes that take all the time they get run beside, as on a robot's machine.

    The bench itself, drivers and listener, comes before them where its user may, so that what it waits is not counted.
    """
    processes = [Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        if count:
            precede()
        yield
    finally:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_OTHER, os.sched_param(0))
        for process in processes:
            process.kill()
            process.wait()


def lossless(nodes: Nodes, seconds: float, busy: int) -> Iterator[Figure]:
    """Yield what is lost at 1000 Hz, node by node."""
    rate, count = 1000.0, round(1000 * seconds)
    case = f"4 × 1000 Hz, scalar, localizer, {seconds:g} s{beside(busy)}"
    with running(nodes.all(GATHER_S), HEARD, WANTED) as (bench, children), beside_busy_processes(busy):
        spent = run(bench, samples(nodes.calibration, count, rate), rate, children.pids)
        arrived = {
            "sensor messages at the collector": sum(
                int(bench.figures["collector"][f"tam_{sensor}.received"]) / 4 for sensor in (1, 2, 3, 4)
            ),
            "samples of the collector": int(bench.figures["collector"]["samples"]),
            "samples at the calibrator": int(bench.figures["calibrator"]["samples"]),
            "samples at the corrector": int(bench.figures["corrector"]["corrected"]),
            "outputs at the localizer": int(bench.figures["localizer"]["received"]),
            "field_gradient at a listener": len(bench.arrivals_ns["field_gradient"]),
            "source_estimate at a listener": len(bench.arrivals_ns["source_estimate"]),
        }
        yield Figure(case, "all nodes", "published samples", float(count))
        for name, number in arrived.items():
            yield Figure(case, "all nodes", f"lost: {name}", count - number, asked=NONE_LOST)
        for name, each in spent.items():
            yield Figure(case, name, "processor time, % of a core", 100 * rate * each)
        yield from latencies(bench, case, ANYTHING)


def light(
    nodes: Nodes, repeats: int, gather_s: float, most_percent: tuple[float, float], busy: int
) -> Iterator[Figure]:
    """Yield processor time and latency at 100 Hz."""
    rate, count = 100.0, round(100 * WINDOW_S)
    case = f"4 × 100 Hz, scalar, localizer, batch_s {gather_s:g}{beside(busy)}"
    with running(nodes.all(gather_s), HEARD, WANTED) as (bench, children), beside_busy_processes(busy):
        pieces = in_pieces(samples(nodes.calibration, repeats * count, rate), repeats)
        spent = [run(bench, piece, rate, children.pids) for piece in pieces]
        percent = {name: [100 * rate * each[name] for each in spent] for name in spent[0]}
        together = np.add(percent["stream"], percent["localizer"]).tolist()
        name = "processor time of collector, corrector and localizer, % of a core"
        yield figure(case, "all nodes", name, together, most_percent)
        for process, values in percent.items():
            yield figure(case, process, "processor time, % of a core", values)
        yield from latencies(bench, case, (0.0, 5.0))


def against_relay(nodes: Nodes, repeats: int, rate: float, is_alone: bool) -> Iterator[Figure]:
    """Yield the processor time for a sample over that of a bare relay of the same topics, side by side."""
    count = round(rate * WINDOW_S)
    file = nodes.folder / "calibration.yaml"
    if is_alone:
        what, ours, relayed = "corrector", "corrector", ["PointCloud2:samples"]
        commands = {
            "collector": nodes.command("collector"),
            "corrector": nodes.command("corrector", calibration_file=file),
        }
    else:
        what, ours = "collector and corrector in one process", "stream"
        relayed = [f"MagneticField:{topic}" for topic in SENSOR_TOPICS]
        commands = {"stream": nodes.command("stream", corrector__calibration_file=file)}
    commands["relay"] = [str(RELAY), *relayed]
    types = {"PointCloud2": PointCloud2, "MagneticField": MagneticField}
    heard = {f"{topic}_relayed": types[name] for name, topic in (each.split(":") for each in relayed)}
    heard["field_gradient"] = PointCloud2
    wanted = {"collector": {"samples": "2" if is_alone else "1"}, "corrector": {"field_gradient": "1"}}
    with running(commands, heard, wanted) as (bench, children):
        pieces = in_pieces(samples(nodes.calibration, repeats * count, rate), repeats)
        spent = [run(bench, piece, rate, children.pids) for piece in pieces]
    case = f"4 × {rate:g} Hz and scalar"
    yield figure(
        case, "bare relay of the same topics", f"beside {what}, µs a sample", [1e6 * each["relay"] for each in spent]
    )
    yield figure(case, what, "µs a sample", [1e6 * each[ours] for each in spent])
    ratios = [each[ours] / each["relay"] for each in spent]
    yield figure(case, what, "processor time for a sample over the bare relay's", ratios, (0.0, 0.5))


def keeping(nodes: Nodes, repeats: int) -> Iterator[Figure]:
    """Yield what it costs a calibrator to keep its samples on disk, side by side with one that does not, at 100 Hz."""
    rate, count = 100.0, round(100 * WINDOW_S)
    other = ["-r", "__ns:=/other", "-r", "samples:=/samples"]
    commands = {
        "collector": nodes.command("collector"),
        "keeps": nodes.command("calibrator", samples_file=nodes.folder / "samples"),
        "keeps none": [*nodes.command("calibrator", samples_file="none"), *other],
    }
    with running(commands, {}, {"collector": {"samples": "2"}}) as (bench, children):
        pieces = in_pieces(samples(nodes.calibration, repeats * count, rate), repeats)
        spent = [run(bench, piece, rate, children.pids) for piece in pieces]
    case = f"4 × {rate:g} Hz and scalar"
    percents = [100 * rate * (each["keeps"] - each["keeps none"]) for each in spent]
    yield figure(case, "calibrator", "keeping samples on disk, % of a core", percents, (-1.0, 2.0))


def latencies(bench: Bench, case: str, asked: tuple[float, float]) -> Iterator[Figure]:
    """Yield the time from the last of a sample's messages to what comes of it."""
    for topic in ("field_gradient", "source_estimate"):
        latency_ms = bench.latencies_ms(topic)
        wanted = asked if topic == "field_gradient" else ANYTHING
        yield Figure(case, topic, "latency p50, ms", float(np.median(latency_ms)))
        yield Figure(case, topic, "latency p99, ms", float(np.percentile(latency_ms, 99)), asked=wanted)


def beside(busy: int) -> str:
    """Return what a case's name says of the load beside it."""
    return f", beside {busy} busy processes" if busy else ""


def figure(case: str, method: str, name: str, values: Sequence[float], asked: tuple[float, float] = ANYTHING) -> Figure:
    """Return the mean of repeats with its standard error."""
    error = float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")
    return Figure(case, method, name, float(np.mean(values)), error, asked)


def show(figures: Sequence[Figure], console: Console) -> None:
    """Print and keep the figures."""
    table = Table("case", "what", "figure", "value", "± standard error", "asked", "met")
    for each in figures:
        error = f"{each.standard_error:.2g}" if np.isfinite(each.standard_error) else ""
        table.add_row(each.case, each.method, each.name, f"{each.value:.4g}", error, each.asked_in_words, each.verdict)
    console.print(table)
    lines = [f"# {' '.join(['python benchmarks/streaming.py', *sys.argv[1:]])} on {machine()}"]
    with write_whole(RESULTS) as part:
        header = "case,method,figure,value,standard_error,asked,met"
        part.write_text("\n".join([*lines, header, *(each.line for each in figures)]) + "\n")


@click.command(help=__doc__)
@click.option("--seconds", default=60.0, show_default=True, help="Length of the run at 1000 Hz.")
@click.option("--repeats", default=4, show_default=True, help="Windows of 8 s for each of the others.")
def main(seconds: float, repeats: int) -> None:
    """Measure and print."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    scenario = read_scenario("tumble_100_hz")
    calibration = calibrate(simulate(scenario).recording, scenario.array)
    console, figures = Console(), list[Figure]()
    with TemporaryDirectory() as folder, ros_session(exit_code=0):
        nodes = Nodes(calibration, Path(folder))
        for rate in (100.0, 1000.0):
            for is_alone in (True, False):
                figures += against_relay(nodes, repeats, rate, is_alone)
        figures += keeping(nodes, repeats)
        figures += light(nodes, repeats, 0.0, ANYTHING, 0)
        for busy, most_percent in ((0, (0.0, 15.0)), (BUSY, ANYTHING)):
            figures += light(nodes, repeats, GATHER_S, most_percent, busy)
            figures += lossless(nodes, seconds, busy)
    load = os.getloadavg()[1] / (os.cpu_count() or 1)
    figures.append(Figure("the machine", "", "load over five minutes, processes per core", load))
    show(figures, console)


if __name__ == "__main__":
    main()
