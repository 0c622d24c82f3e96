"""Speed of reading, writing and correcting bags, each as a ratio of CPU times that are measured in turn in one run.

Run ``python benchmarks/bags.py``; ``--large`` measures the peak memory with a bag of 1 GB too, for which it needs 5 GB
of disk. What is compared with is rosbags: opening a bag and iterating its raw messages; deserialising each of them too;
making, serialising and writing a message after another.
"""

import itertools
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from io import StringIO
from math import inf
from pathlib import Path
from time import process_time

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from tam_calibration.array import Array
from tam_calibration.calibration import Corrected
from tam_calibration.cli.main import main as tam
from tam_calibration.files import (
    read_array,
    read_samples,
    write_calibration,
    write_corrected,
    write_recording,
    write_whole,
)
from tam_calibration.files.bag_writing import TYPESTORE
from tam_calibration.fit import calibrate
from tam_calibration.pointcloud_layout import (
    FIELD_GRADIENT_COLUMNS,
    FRAME_ID,
    GRADIENT_DIMENSIONS,
    GRADIENT_ROW_MAJOR,
    center_covariance,
    field_offsets,
)
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

RATE_HZ = 100
START_S = 1.7e9
HOUR = 3600 * RATE_HZ
STORAGES = {
    "sqlite3": (StoragePlugin.SQLITE3, CompressionMode.NONE),
    "sqlite3, zstd by file": (StoragePlugin.SQLITE3, CompressionMode.FILE),
    "sqlite3, zstd by message": (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    "mcap": (StoragePlugin.MCAP, CompressionMode.NONE),
    "mcap, zstd by chunk": (StoragePlugin.MCAP, CompressionMode.STORAGE),
    "mcap, zstd by file": (StoragePlugin.MCAP, CompressionMode.FILE),
}
RESULTS = Path(__file__).parent / "results" / "bags.csv"
LARGE = 1_250_000
"""Samples of four sensors and a scalar that make 1 GB."""

PEAK = """
import re, sys
from pathlib import Path
from tam_calibration.cli.main import main
main(sys.argv[1:], standalone_mode=False)
print(re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1], file=sys.stderr)
"""
"""Runs a command and prints the peak of its memory, KiB; what getrusage tells would include the parent's."""


@dataclass(frozen=True)
class Row:
    """A figure, its spread over the repeats, and the least and most that is asked."""

    case: str
    figure: str
    values: list[float]
    least: float = 0.0
    most: float = inf

    @property
    def asked(self) -> str:
        """What is asked, in words."""
        return f"≥ {self.least:g}" if self.least else f"≤ {self.most:g}" if self.most < inf else ""

    @property
    def met(self) -> str:
        """Whether the median is as asked."""
        return ("yes" if self.least <= self.quantiles[0] <= self.most else "NO") if self.asked else ""

    @property
    def quantiles(self) -> list[float]:
        """Median, 10 % and 90 %."""
        return [float(value) for value in np.quantile(self.values, [0.5, 0.1, 0.9])]


@click.command(help=__doc__)
@click.option("--samples", default=15_000, show_default=True, help="Samples of four sensors and a scalar.")
@click.option("--repeats", default=5, show_default=True, help="How often each is measured.")
@click.option("--large", is_flag=True, help="Measure the peak memory with a bag of 1 GB.")
def main(samples: int, repeats: int, large: bool) -> None:
    """Run the benchmark."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = [*reading(folder, samples, repeats), *writing(folder, samples, repeats), *hour(folder, min(repeats, 5))]
        if large:
            rows += memory(folder)
    table = Table(title="Bags")
    for column in ("case", "figure", "median", "10 % to 90 %", "asked", "met"):
        table.add_column(column)
    for row in rows:
        median, low, high = row.quantiles
        table.add_row(row.case, row.figure, f"{median:.3g}", f"{low:.3g} to {high:.3g}", row.asked, row.met)
    Console().print(table)
    save(rows, " --large" if large else "")


def save(rows: list[Row], options: str) -> None:
    """Write the table with what it was measured on."""
    machine = f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"
    libraries = ", ".join(f"{name} {version(name)}" for name in ("numpy", "rosbags"))
    lines = [f"# python benchmarks/bags.py{options} on {machine}, {libraries}", "case,figure,median,low,high,asked,met"]
    for row in rows:
        lines.append(
            f'"{row.case}","{row.figure}",{",".join(f"{each:.4g}" for each in row.quantiles)},{row.asked},{row.met}'
        )
    RESULTS.parent.mkdir(exist_ok=True)
    with write_whole(RESULTS) as path:
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def make_recording(samples: int, scalar: bool = True) -> Recording:
    """Return readings in all directions, four sensors, 1 nT of noise."""
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(samples, 1, 3))
    field = 5e-5 * direction / np.linalg.norm(direction, axis=2, keepdims=True)
    readings = field + 1e-9 * rng.normal(size=(samples, 4, 3))
    intensity = 5e-5 + 1e-10 * rng.normal(size=samples) if scalar else None
    return Recording(START_S + np.arange(samples) / RATE_HZ, readings, intensity)


def measure(calls: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, FloatArray]:
    """Return the CPU times of some calls, which take turns."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            begin = process_time()
            call()
            times[name].append(process_time() - begin)
    return {name: np.array(each) for name, each in times.items()}


def iterate(path: Path, deserialise: bool) -> None:
    """Read a bag with rosbags alone."""
    with Reader(path) as reader:
        for connection, _, message in reader.messages(reader.connections):
            if deserialise:
                TYPESTORE.deserialize_cdr(message, connection.msgtype)


def reading(folder: Path, samples: int, repeats: int) -> Iterator[Row]:
    """Yield how many times faster a recording is there than rosbags has read its messages."""
    write_recording(folder / "made", make_recording(samples))
    for case, (storage, compression) in track(STORAGES.items(), description="reading"):
        path = folder / case.replace(", ", "_").replace(" ", "_")
        copy(folder / "made", path, storage, compression)
        calls: dict[str, Callable[[], object]] = {
            "raw": partial(iterate, path, False),
            "deserialised": partial(iterate, path, True),
            "ours": partial(read_samples, path),
        }
        times = measure(calls, repeats)
        yield Row(case, "deserialising one by one over reading", list(times["deserialised"] / times["ours"]), 10)
        yield Row(case, "iterating raw over reading", list(times["raw"] / times["ours"]), 0.7)


def copy(source: Path, path: Path, storage: StoragePlugin, compression: CompressionMode) -> None:
    """Write the messages of a bag one by one in another storage."""
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with Reader(source) as reader, writer:
        copies = {
            each.id: writer.add_connection(each.topic, each.msgtype, typestore=TYPESTORE) for each in reader.connections
        }
        for connection, recorded_ns, message in reader.messages():
            writer.write(copies[connection.id], recorded_ns, message)


def writing(folder: Path, samples: int, repeats: int) -> Iterator[Row]:
    """Yield how many times faster corrected data are written than message by message."""
    outputs = 5e-5 * np.random.default_rng(2).normal(size=(samples, 9))
    corrected = Corrected(START_S + np.arange(samples) / RATE_HZ, outputs, np.full(9, 1e-9))
    stamps_ns = int(START_S) * 10**9 + np.arange(samples) * (10**9 // RATE_HZ)
    for case, (storage, suffix) in {
        "sqlite3": (StoragePlugin.SQLITE3, ""),
        "mcap": (StoragePlugin.MCAP, ".mcap"),
    }.items():
        paths = (folder / f"written_{case}_{number}{suffix}" for number in itertools.count())
        times = measure(
            {
                "one by one": partial(write_one_by_one, paths, corrected, stamps_ns, storage),
                "ours": partial(write_ours, paths, corrected, stamps_ns),
            },
            repeats,
        )
        yield Row(case, "writing one by one over writing", list(times["one by one"] / times["ours"]), 5)


def write_ours(paths: Iterator[Path], corrected: Corrected, stamps_ns: NDArray[np.int64]) -> None:
    """Write corrected data as ``tam correct`` does."""
    write_corrected(next(paths), corrected, stamps_ns)


def write_one_by_one(
    paths: Iterator[Path], corrected: Corrected, stamps_ns: NDArray[np.int64], storage: StoragePlugin
) -> None:
    """Make an object of each message, serialise and write it, with rosbags alone."""
    types = TYPESTORE.types
    dimension, point_field = types["std_msgs/msg/MultiArrayDimension"], types["sensor_msgs/msg/PointField"]
    layout = types["std_msgs/msg/MultiArrayLayout"]([dimension(*each) for each in GRADIENT_DIMENSIONS], 0)
    fields = [point_field(name, offset, 8, 1) for name, offset in field_offsets(FIELD_GRADIENT_COLUMNS)]
    covariance = center_covariance(corrected.standard_errors)
    names = {
        "/center": "sensor_msgs/msg/MagneticField",
        "/gradient": "std_msgs/msg/Float64MultiArray",
        "/field_gradient": "sensor_msgs/msg/PointCloud2",
    }
    with Writer(next(paths).with_suffix(""), version=9, storage_plugin=storage) as writer:
        connections = [(writer.add_connection(*each, typestore=TYPESTORE), each[1]) for each in names.items()]
        for stamp_ns, outputs in zip(stamps_ns.tolist(), corrected.outputs, strict=True):
            time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
            header = types["std_msgs/msg/Header"](time, FRAME_ID)
            data = np.concatenate([outputs, corrected.standard_errors]).view(np.uint8)
            vector = types["geometry_msgs/msg/Vector3"](*outputs[:3].tolist())
            messages = (
                types[names["/center"]](header, vector, covariance),
                types[names["/gradient"]](layout, outputs[list(GRADIENT_ROW_MAJOR)]),
                types[names["/field_gradient"]](header, 1, 1, fields, False, len(data), len(data), data, True),
            )
            for (connection, name), message in zip(connections, messages, strict=True):
                writer.write(connection, stamp_ns, TYPESTORE.serialize_cdr(message, name))


def hour(folder: Path, repeats: int) -> Iterator[Row]:
    """Yield the time to correct an hour at 100 Hz of four sensors over what may be asked of it."""
    calibration, source, output = folder / "calibration.yaml", folder / "hour.mcap", folder / "corrected.mcap"
    write_calibration(calibration, calibrate(make_recording(600), read_array_of(folder)))
    write_recording(source, make_recording(HOUR, scalar=False))
    content = source.read_bytes()
    arguments = ["correct", str(source), "--calibration", str(calibration), "-o", str(output), "--json"]
    times = measure(
        {
            "raw": partial(iterate, source, False),
            "write": partial((folder / "bytes").write_bytes, content),
            "ours": partial(run, arguments),
        },
        repeats,
    )
    yield Row(
        "one hour at 100 Hz × 4, mcap",
        "correcting over 1.5 × iterating raw + writing its bytes",
        list(times["ours"] / (1.5 * times["raw"] + times["write"])),
        most=1,
    )


def run(arguments: list[str]) -> None:
    """Run the command line, its output unseen."""
    with redirect_stdout(StringIO()):
        tam(arguments, standalone_mode=False)


def read_array_of(folder: Path) -> Array:
    """Return the cross, and leave its file in a folder."""
    path = folder / "array.yaml"
    path.write_text("baseline_m: 0.5\nvector_noise_nT: 1.0\nscalar_noise_nT: 0.1\n")
    return read_array(path)


def memory(folder: Path) -> Iterator[Row]:
    """Yield the peak memory of the commands with a bag of 1 GB, each in a process of its own."""
    source, calibration = folder / "large.mcap", folder / "calibration.yaml"
    write_recording(source, make_recording(LARGE))
    size = f"mcap of {source.stat().st_size / 1e9:.2f} GB"
    for arguments in (
        [
            "correct",
            str(source),
            "--calibration",
            str(calibration),
            "-o",
            str(folder / "large_corrected.mcap"),
            "--json",
        ],
        ["calibrate", str(source), "--array", str(folder / "array.yaml"), "--json", "-"],
    ):
        done = subprocess.run([sys.executable, "-c", PEAK, *arguments], capture_output=True, text=True, check=True)
        yield Row(size, f"peak memory of tam {arguments[0]} [MiB]", [int(done.stderr.split()[-1]) / 1024], most=500)


if __name__ == "__main__":
    main()
