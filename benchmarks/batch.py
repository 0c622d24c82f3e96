"""Speed of `tam batch` on two processes over one, and what it takes to find that all is done.

Run ``python benchmarks/batch.py``. Bags (mcap) of four sensors and a scalar that turn through all directions go through
calibration, diagnosis and correction by ``fleet.local.run_here``, which is what the command does. One process and two
take turns, and the ratio is taken turn by turn. On two cores two processes can be twice as fast only where nothing else
runs: what the machine allows is told by plain arithmetic that is shared out in the same way in each turn, and by the
load, the mean number of processes that wanted a core over the last minute.
"""

import os
import platform
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from shutil import rmtree
from time import perf_counter

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from tam_calibration.array import Array
from tam_calibration.files import write_array, write_recording, write_whole
from tam_calibration.fleet.local import run_here
from tam_calibration.fleet.task import Task, read_options
from tam_calibration.recording import Recording

RATE_HZ = 100
START_S = 1.7e9
ASKED = 1.7
PLAIN_NUMBERS, PLAIN_TASKS = 20_000_000, 32
RESULTS = Path(__file__).parent / "results" / "batch.csv"


@dataclass(frozen=True, eq=False)
class Row:
    """A figure and its spread over the turns."""

    figure: str
    values: NDArray[np.float64]
    asked: str = ""

    @property
    def cells(self) -> list[str]:
        """Name, median, 10 % and 90 % of the turns, and what is asked."""
        return [self.figure, *(f"{value:.4g}" for value in np.quantile(self.values, (0.5, 0.1, 0.9))), self.asked]


@click.command(help=__doc__)
@click.option("--bags", default=32, show_default=True, help="Bags in the batch.")
@click.option("--seconds", default=60.0, show_default=True, help="Length of each.")
@click.option("--turns", default=3, show_default=True, help="Times that each number of processes has its turn.")
def main(bags: int, seconds: float, turns: int) -> None:
    """Run the benchmark."""
    with tempfile.TemporaryDirectory() as name:
        rows = list(measure(Path(name), bags, round(RATE_HZ * seconds), turns))
    header = ("figure", "median", "10 %", "90 %", "asked")
    table = Table(*header, title=f"{bags} bags of {seconds:g} s at {RATE_HZ} Hz")
    for row in rows:
        table.add_row(*row.cells)
    Console(width=120).print(table)
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    lines = [
        f"# python benchmarks/batch.py --bags {bags} --seconds {seconds:g} --turns {turns} on {machine}",
        ",".join(header),
        *(",".join(f'"{cell}"' for cell in row.cells) for row in rows),
    ]
    with write_whole(RESULTS) as path:
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def measure(folder: Path, bags: int, samples: int, turns: int) -> Iterator[Row]:
    """Yield the figures."""
    paths = [folder / "missions" / f"dive_{number:02}.mcap" for number in range(bags)]
    paths[0].parent.mkdir()
    for number, path in enumerate(paths):
        write_recording(path, make_recording(number, samples))
    write_array(folder / "array.yaml", Array.cross(0.5, vector_noise_T=1e-9, scalar_noise_T=1e-10))
    options = read_options(folder / "array.yaml", None, 1e-3)
    tasks = [Task.of(path, folder / "out", options) for path in paths]
    do(tasks[:1], 1)  # what both are forked from is then there
    batch, plain, load = np.empty((turns, 2)), np.empty((turns, 2)), np.empty(turns)
    for turn in track(range(turns), description="turns"):
        load[turn] = os.getloadavg()[0]
        for place, jobs in enumerate((1, 2)):
            rmtree(folder / "out", ignore_errors=True)
            batch[turn, place] = time_of(partial(do, tasks, jobs))
            plain[turn, place] = time_of(partial(count, jobs))
    speedup, allowed = batch[:, 0] / batch[:, 1], plain[:, 0] / plain[:, 1]
    yield Row("1 process over 2", speedup, f"≥ {ASKED}")
    yield Row("the same of plain arithmetic", allowed)
    yield Row("the one over the other", speedup / allowed)
    yield Row("load of the machine at the start of a turn", load)
    yield Row("seconds a bag on 1 process", batch[:, 0] / bags)
    yield Row("seconds a bag to see that it is done", np.array([time_of(partial(check, tasks)) / bags]))


def time_of(call: Callable[[], None]) -> float:
    """Return the wall-clock time of a call."""
    begin = perf_counter()
    call()
    return perf_counter() - begin


def do(tasks: list[Task], jobs: int) -> None:
    """Do the tasks in so many processes."""
    for _, problem in run_here(tasks, jobs):
        assert not problem, problem


def check(tasks: list[Task]) -> None:
    """See that the tasks are done."""
    assert all(task.is_done() for task in tasks)


def count(jobs: int) -> None:
    """Add up numbers in so many processes."""
    with ProcessPoolExecutor(jobs, get_context("forkserver")) as pool:
        list(pool.map(sum, [range(PLAIN_NUMBERS)] * PLAIN_TASKS))


def make_recording(seed: int, samples: int) -> Recording:
    """Return readings in all directions, four sensors, 1 nT of noise."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(samples, 1, 3))
    field = 5e-5 * direction / np.linalg.norm(direction, axis=2, keepdims=True)
    readings = field + 1e-9 * rng.normal(size=(samples, 4, 3))
    time_s = START_S + 86_400.0 * seed + np.arange(samples) / RATE_HZ
    return Recording(time_s, readings, 5e-5 + 1e-10 * rng.normal(size=samples))


if __name__ == "__main__":
    main()
