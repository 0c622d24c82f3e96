"""Figures that were measured several times in one run, each with its spread and what is asked of it."""

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from math import inf
from pathlib import Path
from time import process_time

import numpy as np
from rich.console import Console
from rich.table import Table

from tam_calibration.files.text_files import write_whole
from tam_calibration.model.units import FloatArray

HEADER = ("case", "figure", "median", "10 %", "90 %", "asked", "met")
RESULTS = Path(__file__).parent / "results"
LIBRARIES = ("numpy", "scipy", "rosbags", "ros-rclpy")


@dataclass(frozen=True, eq=False)
class Row:
    """A figure, its values in the turns of a run, and the least and most that is asked of their median."""

    case: str
    figure: str
    values: Sequence[float] | FloatArray
    least: float = 0.0
    most: float = inf

    @property
    def asked(self) -> str:
        """What is asked, in words."""
        if self.least and self.most < inf:
            return f"{self.least:g} to {self.most:g}"
        return f"≥ {self.least:g}" if self.least else f"≤ {self.most:g}" if self.most < inf else ""

    @property
    def met(self) -> str:
        """Whether the median is as asked."""
        return ("yes" if self.least <= self.quantiles[0] <= self.most else "NO") if self.asked else ""

    @property
    def quantiles(self) -> list[float]:
        """Median, 10 % and 90 %."""
        return [float(value) for value in np.quantile(np.asarray(self.values), [0.5, 0.1, 0.9])]

    @property
    def cells(self) -> list[str]:
        """The row of a table, in the order of ``HEADER``."""
        return [self.case, self.figure, *(f"{value:.4g}" for value in self.quantiles), self.asked, self.met]


def measure(calls: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, FloatArray]:
    """Return the CPU times of some calls in seconds, (repeats,) each; they take turns."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            begin = process_time()
            call()
            times[name].append(process_time() - begin)
    return {name: np.array(each) for name, each in times.items()}


def show(title: str, command: str, name: str, rows: Sequence[Row]) -> None:
    """Print rows as a table, and keep them in the results."""
    table = Table(*HEADER, title=title)
    for row in rows:
        table.add_row(*row.cells)
    Console(width=140).print(table)
    save(command, name, rows)


def save(command: str, name: str, rows: Sequence[Row]) -> None:
    """Keep rows in the results, with the command that made them and what they were measured on."""
    lines = [f"# {command} on {machine()}", ",".join(HEADER)]
    lines += [",".join([*(f'"{cell}"' for cell in row.cells[:2]), *row.cells[2:]]) for row in rows]
    RESULTS.mkdir(exist_ok=True)
    with write_whole(RESULTS / name) as path:
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def machine() -> str:
    """Return what was measured on, how busy it is, and the versions."""
    load = ", ".join(f"{mean:.1f}" for mean in os.getloadavg())
    versions = [f"Python {platform.python_version()}"]
    for library in LIBRARIES:
        try:
            versions.append(f"{library} {version(library)}")
        except PackageNotFoundError:
            continue
    return (
        f"{platform.system()} {platform.machine()}, {_processor()}, {os.cpu_count()} cores, "
        f"load over 1, 5 and 15 minutes {load}; {', '.join(versions)}"
    )


def _processor() -> str:
    """Return the name of the processor, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown processor"
    )
