"""Drivers whose stamps are late: how well ``tam calibrate --estimate-delays`` finds by how much.

Run ``python benchmarks/delays.py [--runs 10]``. As in ``clocks.py``, but every sensor is stamped later than it was
read, or earlier, by a delay of its own between -20 and 20 ms that nobody knows. From the motion alone the delays after
sensor 1 are estimated. Asked is that they are within three standard errors, as 99.7 % of normal errors are, and 50 µs
of the truth.
"""

from dataclasses import replace

import click
import numpy as np
from clocks import EVERY_10_MS, SCENARIO, Drivers, run_of
from rich.console import Console
from rich.progress import track
from spread import Row, show

from tam_calibration.gap.delays import estimate_delays
from tam_calibration.model.units import FloatArray

LONGEST_S = 20e-3
"""Greatest delay: two readings of a driver at 100 Hz, as a serial line and a busy machine make it."""
FIRST_SEED = 5000

ALIKE, OFFSETS = (0.0,) * 4, (0, 2.5e-3, 5e-3, 7.5e-3)
"""How much later each sensor is read than sensor 1, seconds: all at once, or one after another in a period."""
CASES = {
    "one clock, 30°/s": Drivers(EVERY_10_MS, ALIKE, 0.0, 30.0),
    "one clock, 90°/s": Drivers(EVERY_10_MS, ALIKE, 0.0, 90.0),
    "one clock, 180°/s": Drivers(EVERY_10_MS, ALIKE, 0.0, 180.0),
    "one clock, 90°/s, 10 s": Drivers(EVERY_10_MS, ALIKE, 0.0, 90.0, 10.0),
    "offsets of 2.5, 5, 7.5 ms, 90°/s": Drivers(EVERY_10_MS, OFFSETS, 0.0, 90.0),
    "times that jitter by ± 2 ms, 90°/s": Drivers(EVERY_10_MS, OFFSETS, 2e-3, 90.0),
    "sensor 1 at 100 Hz, the others at 50 Hz, 90°/s": Drivers((0.01, 0.02, 0.02, 0.02), OFFSETS, 0.0, 90.0),
    "50 Hz, 90°/s": Drivers((0.02,) * 4, OFFSETS, 0.0, 90.0),
    "25 Hz, 180°/s": Drivers((0.04,) * 4, OFFSETS, 0.0, 180.0),
}
"""Motion from slow to fast, runs that are short, and rates down to where interpolation costs more than noise."""


def measure(drivers: Drivers, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return errors and standard errors of the delays of sensors 2 to 4, seconds."""
    late_s = np.random.default_rng([FIRST_SEED, seed]).uniform(-LONGEST_S, LONGEST_S, 4)
    recording, usage = run_of(replace(drivers, late_s=tuple(late_s)), FIRST_SEED + seed)
    found = estimate_delays(usage.with_each_reading_once(recording).whole(), SCENARIO.array)
    return (found.delay_s - (late_s - late_s[0]))[1:], found.standard_error_s[1:]


@click.command(help=__doc__)
@click.option("--runs", default=10, show_default=True)
def main(runs: int) -> None:
    """Measure, print and keep."""
    rows, within = [], []
    for case in track(CASES, console=Console(stderr=True)):
        measured = [measure(CASES[case], seed) for seed in range(runs)]
        error, told = (np.concatenate(each) for each in zip(*measured, strict=True))
        pulls = np.abs(error / told)
        within += ((pulls <= 3) & (np.abs(error) <= 50e-6)).tolist()
        rows += [
            Row(case, "standard error, µs", 1e6 * told),
            Row(case, "largest error, µs", [1e6 * float(np.abs(error).max())], most=50),
            Row(case, "errors over their standard errors (RMS)", [float(np.sqrt(np.mean(pulls**2)))]),
            Row(case, "the largest of these", [float(pulls.max())]),
        ]
    rows.append(Row("all", "part within three standard errors and 50 µs", [float(np.mean(within))], least=0.99))
    show("Drivers whose stamps are late", f"python benchmarks/delays.py --runs {runs}", "delays.csv", rows)


if __name__ == "__main__":
    main()
