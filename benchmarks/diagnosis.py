"""What a diagnosis costs: processor time by samples and by kinds of cases, and an hour at 100 Hz with its memory.

Run ``python benchmarks/diagnosis.py``. Recordings of four sensors are those of ``tam blind make`` with the number of
samples set; ``tam_calibration.gap.diagnose`` is timed alone, without reading files. Beside the seconds stands the ratio
to a QR decomposition of 4000 × 46 numbers, which is timed before and after each diagnosis: other processes on the
machine slow down both. A kind that leaves the cause out of the library searches longest. Growth is the time of the
most samples over that of a quarter of them; linear is 4. The hour comes from a process of its own, its memory is the
peak of the resident set that ``getrusage`` tells, the recording included.
"""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import count
from multiprocessing import get_context
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from tempfile import TemporaryDirectory
from time import process_time

import click
import numpy as np
from asked import ANYTHING, Figure, show
from rich.progress import track
from scipy.spatial.transform import Rotation

from tam_calibration.files.text_files import write_whole
from tam_calibration.gap import diagnose
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import read_array, read_samples
from tam_validation.blind.case import make_case
from tam_validation.blind.case_plan import CasePlan
from tam_validation.blind.folder import write_case

SIZES = (500, 1_000, 2_000, 4_000, 8_000, 16_000)
ASKED_SIZE, ASKED_SECONDS = 4_000, 3.0
ASKED_GROWTH = 5.0
HOUR, RATE_HZ = 360_000, 100
ASKED_HOUR_SECONDS, ASKED_HOUR_MIB = 240.0, 2048.0
"""120 s on two cores."""

SEED, NOISE_T = 7, 1e-9
RESULTS = Path(__file__).parent / "results" / "diagnosis.csv"


@dataclass(frozen=True)
class Kind:
    """A kind of case: how it is made, and what is left out of the library."""

    plan: tuple[str, tuple[str, ...], tuple[float, ...]]
    without: tuple[str, ...] = ()


KINDS = {
    "clean": Kind(("clean", (), ())),
    "one cause": Kind(("single", ("temperature_drift",), (3.0,))),
    "pair": Kind(("pair", ("temperature_drift", "current_interference"), (2.0, 2.0))),
    "outside the library": Kind(("outside", ("gain_wander",), (3.0,))),
    "unexplained": Kind(("single", ("hysteresis",), (3.0,)), ("hysteresis", "nonlinearity")),
}


@click.command(help=__doc__)
@click.option("--cases", default=2, show_default=True, help="Recordings of each kind and size.")
def main(cases: int) -> None:
    """Run the benchmark."""
    figures: list[Figure] = []
    for name, kind in KINDS.items():
        seconds = {}
        for size in track(SIZES, description=name):
            times = np.array([measure(*made, kind) for made in recordings(kind, size, cases)])
            seconds[size] = float(times[:, 0].mean())
            spread = float(times[:, 0].std(ddof=1) / np.sqrt(cases)) if cases > 1 else float("nan")
            asked = (0.0, ASKED_SECONDS) if size == ASKED_SIZE else ANYTHING
            case = f"{size} samples"
            figures.append(Figure(case, name, "processor time [s]", seconds[size], spread, asked))
            figures.append(Figure(case, name, "over a QR of 4000 × 46", float((times[:, 0] / times[:, 1]).mean())))
        growth = seconds[SIZES[-1]] / seconds[SIZES[-3]]
        figures.append(Figure(f"{SIZES[-1]} samples", name, f"over {SIZES[-3]}", growth, asked=(0.0, ASKED_GROWTH)))
    case = f"one hour at {RATE_HZ} Hz"
    for name in ("drift", "outside the library"):
        elapsed, peak = _apart(name)
        figures.append(Figure(case, name, "processor time [s]", elapsed, asked=(0.0, ASKED_HOUR_SECONDS)))
        figures.append(Figure(case, name, "peak memory [MiB]", peak, asked=(0.0, ASKED_HOUR_MIB)))
    show(figures, "What a diagnosis costs", "kind")
    with write_whole(RESULTS) as path:
        header = "case,kind,figure,value,standard_error,asked,met"
        lines = [f"# python benchmarks/diagnosis.py --cases {cases}", header, *(figure.line for figure in figures)]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def recordings(kind: Kind, size: int, cases: int) -> Iterator[tuple[Recording, Array]]:
    """Yield recordings of four sensors."""
    with TemporaryDirectory() as name:
        for number in count(1):
            if not cases:
                return
            write_case(Path(name), make_case(CasePlan(*kind.plan, size), SEED, number))
            array = read_array(Path(name) / "spec.yaml")
            if array.sensor_count == 4:
                cases -= 1
                yield read_samples(Path(name) / "data.csv", array).recording, array


def measure(recording: Recording, array: Array, kind: Kind) -> tuple[float, float]:
    """Return the processor time of a diagnosis, and that of the QR decompositions around it."""
    before = _reference()
    begin = process_time()
    diagnose(recording, array, without=kind.without)
    return process_time() - begin, (before + _reference()) / 2


def _reference() -> float:
    matrix = np.random.default_rng(0).normal(size=(4000, 46))
    begin = process_time()
    for _ in range(10):
        np.linalg.qr(matrix)
    return (process_time() - begin) / 10


def _apart(cause: str) -> tuple[float, float]:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(measure_hour, cause).result()


def measure_hour(cause: str) -> tuple[float, float]:
    """Return processor time and peak memory, MiB, of the diagnosis of an hour with all channels."""
    generator = np.random.default_rng(SEED)
    time_s = np.arange(HOUR) / RATE_HZ
    attitude = Rotation.from_euler("XYZ", np.outer(time_s, (0.9, 0.55, 0.35)))
    world_T = np.array([12e-6, 18e-6, -45e-6])
    readings_T = attitude.inv().apply(world_T)[:, None] + NOISE_T * generator.normal(size=(HOUR, 4, 3))
    scalar_T = np.linalg.norm(world_T) + NOISE_T / 5 * generator.normal(size=HOUR)
    temperature_C = 20 + 3 * np.sin(2 * np.pi * time_s / 1500) + np.sin(2 * np.pi * time_s / 130)
    current_A = 2.0 * (np.sin(0.083 * time_s) > 0.2)
    if cause == "drift":
        readings_T[:, 1] += 1.5 * NOISE_T * (temperature_C - 20)[:, None]
    else:
        readings_T[:, 1] += 3 * NOISE_T * np.sign(np.sin(0.37 * time_s + np.sin(0.011 * time_s)))[:, None]
    recording = Recording(time_s, readings_T, scalar_T, temperature_C, current_A, attitude.as_quat())
    begin = process_time()
    diagnose(recording, Array.cross(0.5, vector_noise_T=NOISE_T, scalar_noise_T=NOISE_T / 5))
    return process_time() - begin, getrusage(RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    main()
