"""The calibration that is kept up to date, over DDS: what the update costs, when a change is told, and a restart.

Run ``python benchmarks/live_over_dds.py [--runs 5] [--seconds 60]``. Collector, corrector and two calibrators are
processes of their own, and hear from this one the four sensors and the scalar of ``live.py``'s dive at 100 Hz. The
calibrators take the same samples and keep them on disk; one updates its calibration of a day ago, the other does not.
After the clean seconds the bias of one sensor moves by 1 nT in any direction; ``/diagnostics`` tell the change, once a
second. Then the calibrator is killed and started again. Measured are

- the processor's time of each process in the clean seconds, and what the update adds: the difference of the two;
- the time from the first sample after the change until it is told, and whether sensor and bias are among what is named;
- how many of the samples that it told to have learned before it was killed the next process does not know of.
"""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np
from asked import ANYTHING, Figure
from live import ARRAY, RATE_HZ, dive, errors_of, of_bias, recording_of, rows_of, walked
from rclpy.experimental.events_executor import EventsExecutor
from rich.console import Console
from scipy.spatial.transform import Rotation
from spread import machine
from streaming import Nodes
from streaming_bench import Bench, cpu_s

from tam_calibration.files.text_files import write_whole
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.data_sheet import DAY_S
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.nodes.session import Children, ros_session

RESULTS = Path(__file__).parent / "results" / "live_over_dds.csv"
UPDATES, PLAIN = "calibrator that updates", "calibrator that does not"
CASE = "4 × 100 Hz and scalar, over DDS"
MOST_S = 60.0
"""Longest wait for a change to be told, twice what is asked."""
KEPT_S = 3.0
"""From the report of a change until it is on disk: the calibrator saves once a second; twice that, and a margin."""


class Mission:
    """A vehicle under way from its calibration ashore on, whose readings are published as they come.

    Parameters
    ----------
    folder : Path
        Of the files of the nodes.
    generator : Generator
    """

    def __init__(self, folder: Path, generator: np.random.Generator) -> None:
        ashore = errors_of(generator)
        turns = Rotation.random(3000, random_state=generator)
        stamps_s = time.time() - DAY_S + np.arange(len(turns)) / RATE_HZ
        calibration = maximum_likelihood(recording_of(rows_of(ashore, turns, stamps_s, generator)), ARRAY)
        self.errors, self._generator = walked(ashore, DAY_S, generator), generator
        self._nodes, self._begun = Nodes(calibration, folder), 0.0

    def command(self, name: str, **parameters: object) -> list[str]:
        """Return the command of a node; of the calibrator with the calibration of the shore."""
        if name == "calibrator":
            parameters["calibration_file"] = self._nodes.folder / "calibration.yaml"
        return self._nodes.command(name, **parameters)

    def play(self, bench: Bench, errors: SensorErrors, seconds: float) -> Iterator[float]:
        """Publish samples at their times, and yield after each how long it has been since the first, seconds."""
        rows: FloatArray = dive(errors, self._begun + np.arange(round(seconds * RATE_HZ)) / RATE_HZ, self._generator)
        begin_s = time.perf_counter()
        for index, row in enumerate(rows):
            bench.spin_until(begin_s + index / RATE_HZ)
            bench.publish(row[1:-2].reshape(-1, 3), float(row[-2]), None)
            self._begun += 1 / RATE_HZ
            yield time.perf_counter() - begin_s


def run(folder: Path, seed: int, seconds: float) -> dict[str, float]:
    """Return the figures of one mission."""
    generator = np.random.default_rng(seed)
    mission = Mission(folder, generator)
    updates = mission.command("calibrator", samples_file=folder / "updates", update=True, on_change="learn")
    other = ["-r", "__ns:=/other", "-r", "samples:=/samples"]
    commands = {
        "collector": mission.command("collector"),
        "corrector": mission.command("corrector", calibration_file=folder / "calibration.yaml"),
        UPDATES: updates,
        PLAIN: [*mission.command("calibrator", samples_file=folder / "plain"), *other],
    }
    with Children(commands, folder) as children:
        bench = Bench(EventsExecutor())
        bench.wait_for(children, "collector", {"subscribers./samples": "3"})
        for _ in mission.play(bench, mission.errors, 5):
            pass
        figures = _clean(bench, children, mission, seconds) | _change(bench, mission, generator)
        told = bench.figures["calibrator"]
        children.end_one(UPDATES, signal.SIGKILL)
        with Children({UPDATES: updates}, folder / "again") as again:
            bench.figures.pop("calibrator")
            bench.wait_for(again, "collector", {"subscribers./samples": "3"})
            bench.wait_for(again, "calibrator", {"changes": told["changes"]})
            learned = int(bench.figures["calibrator"]["learned"])
            figures["learned samples that a restart has lost"] = int(told["learned"]) - learned
        bench.close()
    return figures


def _clean(bench: Bench, children: Children, mission: Mission, seconds: float) -> dict[str, float]:
    before = {name: cpu_s(pid) for name, pid in children.pids.items()}
    begin_s = time.perf_counter()
    for _ in mission.play(bench, mission.errors, seconds):
        pass
    elapsed_s = time.perf_counter() - begin_s
    percent = {name: 100 * (cpu_s(pid) - before[name]) / elapsed_s for name, pid in children.pids.items()}
    figures = {f"{name}, % of a core": each for name, each in percent.items()}
    return figures | {"update, % of a core": percent[UPDATES] - percent[PLAIN]}


def _change(bench: Bench, mission: Mission, generator: np.random.Generator) -> dict[str, float]:
    alarms = int(bench.figures["calibrator"]["changes"])
    sensor, told_s, figures = int(generator.integers(4)), MOST_S, dict[str, float]()
    for since_s in mission.play(bench, of_bias(mission.errors, sensor, generator), MOST_S + KEPT_S):
        told = bench.figures["calibrator"]
        if not figures and int(told["changes"]) > alarms:
            told_s = since_s
            figures = {
                "alarms before the change": alarms,
                "bias of 1 nT told after, s": told_s,
                "right sensor": float(told["changed_sensor"] == str(sensor + 1)),
                "bias among the errors named": float("bias" in told["changed_parameters"].split(" or ")),
            }
        if figures and since_s > told_s + KEPT_S:
            return figures
    raise TimeoutError(f"no change is told within {MOST_S:g} s, but {bench.figures['calibrator']}")


ASKED = {
    "update, % of a core": (0.0, 5.0),
    "bias of 1 nT told after, s": (0.0, 30.0),
    "alarms before the change": (0.0, 0.0),
}
"""What a mission needs; no run may have an alarm."""


@click.command(help=__doc__)
@click.option("--runs", default=5, show_default=True)
@click.option("--seconds", default=60.0, show_default=True, help="Clean seconds of each.")
@click.option("--first-seed", default=41_000, show_default=True)
def main(runs: int, seconds: float, first_seed: int) -> None:
    """Measure, print and keep the figures."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    scores = []
    with ros_session(exit_code=0):
        for seed in range(first_seed, first_seed + runs):
            with TemporaryDirectory() as folder:
                scores.append(run(Path(folder), seed, seconds))
            Console().print(scores[-1])
    load = os.getloadavg()[1] / (os.cpu_count() or 1)
    figures = [Figure("the machine", "", "load over five minutes, processes per core", load)]
    for name in scores[0]:
        values = np.array([score[name] for score in scores])
        error = float(values.std(ddof=1) / np.sqrt(runs)) if runs > 1 else float("nan")
        figures.append(Figure(CASE, f"mean of {runs}", name, float(values.mean()), error, ASKED.get(name, ANYTHING)))
        figures.append(Figure(CASE, f"largest of {runs}", name, float(values.max())))
    command = f"python benchmarks/live_over_dds.py --runs {runs} --seconds {seconds:g} --first-seed {first_seed}"
    lines = [f"# {command} on {machine()}", "case,method,figure,value,standard_error,asked,met"]
    with write_whole(RESULTS) as part:
        part.write_text("\n".join([*lines, *(each.line for each in figures)]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
