"""Long recordings: processor time and memory of a fit of a million samples, and of ten million that stay on disk.

Run ``python benchmarks/large.py``. Wu's Table 1 with four sensors; every figure comes from a process of its own, its
memory from the peak of the resident set that ``getrusage`` tells.

- In memory: a method with a million samples, its covariance, residuals, noise floor and coverage. The memory is what
  the peak exceeds the resident set before the data are loaded by, the data included, over the data: time, readings and
  scalar in float64.
- From disk: ``tam calibrate`` with a CSV file, all of it: reading, checks, the fit, five more for the held-out figures,
  tables. The memory is the peak of the whole process. Time is linear when a sample costs the same whatever the size.
- Beside pandas: the processor time of the command, the start of Python included, over that of a process that reads the
  same file with ``pandas.read_csv``; the least of three of each.
"""

import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from resource import RUSAGE_CHILDREN, RUSAGE_SELF, getpagesize, getrusage
from subprocess import DEVNULL, run
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import click
import numpy as np
from asked import ANYTHING, Figure, show
from click.testing import CliRunner

from tam_calibration.cli.main import main as tam
from tam_calibration.files.text_files import write_whole
from tam_calibration.fit import DEFAULT_METHOD, METHODS, calibrate
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import to_nanotesla
from tam_calibration.recordings import read_array, write_array
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate

IN_MEMORY = 1_000_000
ON_DISK = (1_000_000, 3_000_000, 10_000_000)
ASKED_SECONDS = {"lossless": 1.0, "maximum_likelihood": 3.0}
"""Processor time of a fit to a million samples in memory, at most: nobody on board waits for it."""

ASKED_TIMES_DATA = 3.0
"""Memory of such a fit over that of its samples, at most: with a copy of them, and one of their residuals."""

ASKED_MIB = 400.0
"""Peak memory of the command, however long the file is: what a small computer on board has left."""

ASKED_LINEAR = 1.2
"""Growth of the time over that of the samples, at most: linear but for the caches of the processor."""

ASKED_OVER_PANDAS = {100_000: 1.3, 1_000_000: 2.0}
"""Processor time of the command over that of reading the file with pandas, at most, by samples."""

PIECE = 100_000
RESULTS = Path(__file__).parent / "results" / "large.csv"


@click.command(help=__doc__)
@click.option("--folder", type=click.Path(path_type=Path, file_okay=False), help="Where 2.5 GB of files may lie.")
def main(folder: Path | None) -> None:
    """Run the benchmark."""
    figures: list[Figure] = []
    with TemporaryDirectory(dir=folder) as name:
        _apart(write_samples, Path(name), IN_MEMORY)
        for method in ASKED_SECONDS:
            figures += in_memory(method, Path(name))
        for size, asked in ASKED_OVER_PANDAS.items():
            _apart(write_csv, Path(name), size)
            ratio, case = over_pandas(Path(name)), f"{size:.0e} samples on disk"
            figures.append(Figure(case, DEFAULT_METHOD, "over reading with pandas", ratio, asked=(0.0, asked)))
        seconds: dict[tuple[str, int], float] = {}
        for size in ON_DISK:
            _apart(write_csv, Path(name), size)
            for method in ASKED_SECONDS:
                elapsed, peak = _apart(stream, Path(name), method)
                seconds[method, size] = elapsed / size
                case = f"{size:.0e} samples on disk"
                figures.append(Figure(case, method, "tam calibrate, processor time [s]", elapsed))
                figures.append(Figure(case, method, "peak memory [MiB]", peak / 2**20, asked=(0.0, ASKED_MIB)))
    for method in ASKED_SECONDS:
        ratio = seconds[method, ON_DISK[-1]] / seconds[method, ON_DISK[0]]
        name = f"time per sample over that of {ON_DISK[0]:.0e}"
        figures.append(Figure(f"{ON_DISK[-1]:.0e} samples on disk", method, name, ratio, asked=(0.0, ASKED_LINEAR)))
    show(figures, "Long recordings", "method")
    RESULTS.parent.mkdir(exist_ok=True)
    with write_whole(RESULTS) as path:
        header = "case,method,figure,value,standard_error,asked,met"
        lines = ["# python benchmarks/large.py", header, *(figure.line for figure in figures)]
        path.write_text("\n".join(lines) + "\n")


def in_memory(method: str, folder: Path) -> list[Figure]:
    """Return the figures of a method, and beside them, unasked, those of ``calibrate``."""
    figures = []
    case = f"{IN_MEMORY:.0e} samples in memory"
    for name, function, is_asked in ((method, fit, True), (f"{method}, checked and held out", check, False)):
        elapsed, times_data = _apart(function, folder, method)
        most = (0.0, ASKED_SECONDS[method]) if is_asked else ANYTHING
        figures.append(Figure(case, name, "processor time [s]", elapsed, asked=most))
        most = (0.0, ASKED_TIMES_DATA) if is_asked else ANYTHING
        figures.append(Figure(case, name, "memory over the data", times_data, asked=most))
    return figures


def _apart(function: Callable[..., Any], *arguments: object) -> Any:
    """Return what a function returns in a new process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


def write_samples(folder: Path, count: int) -> None:
    """Write arrays of a recording, and the array file."""
    scenario = read_scenario("wu_table_1")
    recording = simulate(replace(scenario, sample_count=count)).recording
    write_array(folder / "array.yaml", scenario.array)
    for name in ("time_s", "readings_T", "scalar_T"):
        np.save(folder / f"{name}.npy", getattr(recording, name))


def write_csv(folder: Path, count: int) -> None:
    """Write a recording as CSV, a part with its own noise and attitudes after the other."""
    scenario = read_scenario("wu_table_1")
    columns = [f"b{sensor}{axis}_nT" for sensor in range(1, 5) for axis in "xyz"]
    row = "%.2f" + ",%.4f" * 13 + "\n"
    with (folder / "recording.csv").open("w") as file:
        file.write(",".join(["time_s", *columns, "scalar_nT"]) + "\n")
        for part in range(count // PIECE):
            recording = simulate(replace(scenario, sample_count=PIECE, seed=part)).recording
            assert recording.scalar_T is not None
            time_s = 0.01 * (part * PIECE + np.arange(PIECE))
            fields = np.column_stack([recording.readings_T.reshape(PIECE, -1), recording.scalar_T])
            rows = np.column_stack([time_s, to_nanotesla(fields)])
            file.writelines(row % tuple(values) for values in rows.tolist())


def fit(folder: Path, method: str) -> tuple[float, float]:
    """Return the processor time of a method, and its memory over the data."""
    return _measure(folder, METHODS[method])


def check(folder: Path, method: str) -> tuple[float, float]:
    """Return the same of a fit that is checked before and after, and held out."""
    return _measure(folder, lambda recording, array: calibrate(recording, array, method))


def _measure(folder: Path, function: Callable[..., object]) -> tuple[float, float]:
    array = read_array(folder / "array.yaml")
    before = int(Path("/proc/self/statm").read_text().split()[1]) * getpagesize()
    parts = [np.load(folder / f"{name}.npy") for name in ("time_s", "readings_T", "scalar_T")]
    recording = Recording(*parts)
    begin = process_time()
    function(recording, array)
    elapsed = process_time() - begin
    return elapsed, (_peak() - before) / sum(part.nbytes for part in parts)


def stream(folder: Path, method: str) -> tuple[float, float]:
    """Return the processor time of ``tam calibrate``, and the peak of its memory in bytes."""
    begin = process_time()
    files = [str(folder / name) for name in ("recording.csv", "array.yaml", "calibration.yaml")]
    result = CliRunner().invoke(tam, ["calibrate", files[0], "--array", files[1], "-o", files[2], "--method", method])
    if result.exit_code:
        raise RuntimeError(result.output)
    return process_time() - begin, _peak()


def over_pandas(folder: Path) -> float:
    """Return the processor time of ``tam calibrate`` over that of reading its file with pandas."""
    file, array, output = (str(folder / name) for name in ("recording.csv", "array.yaml", "calibration.yaml"))
    reading = [sys.executable, "-c", f"import pandas; pandas.read_csv({file!r})"]
    fitting = [sys.executable, "-m", "tam_calibration", "calibrate", file, "--array", array, "-o", output]
    return min(_seconds_of(fitting) for _ in range(3)) / min(_seconds_of(reading) for _ in range(3))


def _seconds_of(command: list[str]) -> float:
    before = getrusage(RUSAGE_CHILDREN)
    run(command, check=True, stdout=DEVNULL)
    after = getrusage(RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _peak() -> float:
    return getrusage(RUSAGE_SELF).ru_maxrss * 1024


if __name__ == "__main__":
    main()
