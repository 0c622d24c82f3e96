"""Speed of `tam batch` on two processes over one, and what it takes to find that all is done.

Run ``python benchmarks/batch.py``. Bags (mcap) of four sensors and a scalar that turn through all directions go through
calibration, diagnosis and correction by ``fleet.execution.run_here``, which is what the command does. One process and
two take turns, and the ratio is taken turn by turn.

On two cores two processes can be twice as fast only where nothing else runs. What a busy machine allows is told by
plain arithmetic that is shared out in the same way in each turn, and by the load. What a machine with both cores free
would give is told by processor time: that of the one process over that of the busier of the two, start included; other
work lets one of the two do more of the bags, which the mean of the two does not tell. Beside it stands what no second
process shortens: the time of the command where all is done already, its summary included.
"""

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from shutil import rmtree
from subprocess import DEVNULL, run
from time import perf_counter

import click
import numpy as np
from bag_making import make_recording
from process_times import ProcessTimes
from rich.progress import track
from spread import Row, show

from tam_calibration.fleet.batch import run_here
from tam_calibration.fleet.task import Task, read_options
from tam_calibration.model.array import Array
from tam_calibration.recordings import write_array
from tam_calibration.recordings.channel_map import Reading
from tam_calibration.results import write_recording

RATE_HZ = 100
ASKED = 1.7
"""Speed of two processes over one, at least; 2 would be all of it."""
PLAIN_NUMBERS, PLAIN_TASKS = 20_000_000, 16


@click.command(help=__doc__)
@click.option("--bags", default=32, show_default=True, help="Bags in the batch.")
@click.option("--seconds", default=60.0, show_default=True, help="Length of each.")
@click.option("--turns", default=3, show_default=True, help="Times that each number of processes has its turn.")
def main(bags: int, seconds: float, turns: int) -> None:
    """Run the benchmark."""
    with tempfile.TemporaryDirectory() as name:
        rows = list(measure(Path(name), bags, round(RATE_HZ * seconds), turns))
    command = f"python benchmarks/batch.py --bags {bags} --seconds {seconds:g} --turns {turns}"
    show("tam batch", command, "batch.csv", rows)


def measure(folder: Path, bags: int, samples: int, turns: int) -> Iterator[Row]:
    """Yield the figures."""
    paths = [folder / "missions" / f"dive_{number:02}.mcap" for number in range(bags)]
    paths[0].parent.mkdir()
    for number, path in enumerate(paths):
        write_recording(path, make_recording(samples, seed=number))
    write_array(folder / "array.yaml", Array.cross(0.5, vector_noise_T=1e-9, scalar_noise_T=1e-10))
    options = read_options(folder / "array.yaml", None, Reading(tolerance_s=1e-3))
    tasks = [Task.of(path, folder / "out", options) for path in paths]
    do(tasks[:1], 1)  # what both are forked from is then there
    clock, busier, mean, plain, load = (np.empty((turns, 2)) for _ in range(5))
    for turn in track(range(turns), description="turns"):
        for place, jobs in enumerate((1, 2)):
            rmtree(folder / "out", ignore_errors=True)
            load[turn, place] = os.getloadavg()[0]
            with ProcessTimes() as times:
                clock[turn, place] = time_of(partial(do, tasks, jobs))
            used_s = times.busiest_s(jobs)
            busier[turn, place], mean[turn, place] = used_s[0], np.mean(used_s)
            plain[turn, place] = time_of(partial(count, jobs))
    case = f"{bags} bags of {samples / RATE_HZ:g} s"
    speedup, allowed = clock[:, 0] / clock[:, 1], plain[:, 0] / plain[:, 1]
    yield Row(case, "1 process over 2, on the clock", speedup, ASKED)
    yield Row(case, "1 process over 2, plain arithmetic, on the clock", allowed)
    yield Row(case, "the one over the other", speedup / allowed)
    yield Row(case, "1 process over 2, processor time of the busier", busier[:, 0] / busier[:, 1], ASKED)
    yield Row(case, "1 process over 2, mean processor time of the two", mean[:, 0] / mean[:, 1])
    yield Row(case, "load of the machine at the start of a turn", load.ravel())
    yield Row(case, "processor time a bag on 1 process, s", busier[:, 0] / bags)
    yield Row(case, "time to see that a bag is done, s", [time_of(partial(check, tasks)) / bags])
    yield Row(case, "processor time of the command where all is done, s", [nothing_to_do(folder)])


def nothing_to_do(folder: Path) -> float:
    """Return the processor time of the command where all is done already: it starts, and sums up."""
    before = getrusage(RUSAGE_CHILDREN)
    arguments = [
        str(folder / "missions" / "*.mcap"),
        "--array",
        str(folder / "array.yaml"),
        "--output",
        str(folder / "out"),
    ]
    run([sys.executable, "-m", "tam_calibration", "batch", *arguments], stdout=DEVNULL, check=True)
    after = getrusage(RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


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


if __name__ == "__main__":
    main()
