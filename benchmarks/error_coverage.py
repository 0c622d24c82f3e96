"""How often 95 % intervals of every method hold the truth: ``python benchmarks/error_coverage.py [--runs 20]``.

Each run is four sensors with random errors that tumble in a uniform field, with noise that is white, lasts from sample
to sample (AR(1) 0.5 and 0.9, 1/f), has heavy tails (Student's t of 3 degrees of freedom), drifts, or of whose samples
3 % are dropped. The noise has its stated size in each sample. A row tells the part of the parameters of all runs that
are within 1.96 standard errors, whatever grade the answer has, without runs that are refused. It is to be 93 to 97 %
unless most answers say that their standard errors may not hold; three standard errors of the part itself, which a
few runs tell to one or two per cent, count as chance.
"""

from itertools import product

import click
import numpy as np
from noises import Noise, flicker, lasting, white
from numpy.random import Generator
from rich.progress import track
from scipy.spatial.transform import Rotation
from spread import Row, show

from tam_calibration.fit import METHODS, calibrate
from tam_calibration.fit.prior import in_first_frame
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.simulation.conditions import Tumble

SAMPLES = (20, 60, 600, 3000, 20_000)
RATE_HZ, NOISE_T, FIELD_T = 10.0, 2e-9, 50e-6
"""Of a survey's fluxgates in middle latitudes."""

SIZES = np.repeat([0.02, np.radians(0.5), 300e-9, np.radians(0.5)], 3)
"""Standard deviations of the twelve errors of a sensor."""

WITHIN, LEAST, MOST, MOSTLY = 1.96, 0.93, 0.97, 0.5
"""Standard errors of a 95 % interval, which part of them is to hold, and how many answers may say that it does not."""

BY_CHANCE = 3.0
"""Standard errors, of so few runs, by which a part may be outside of that: one of 280 rows is, by chance."""


def _drifting(rng: Generator, shape: tuple[int, ...]) -> FloatArray:
    return rng.normal(size=shape) + 1.5 * rng.normal(size=shape[1:]) * np.linspace(-1, 1, shape[0]).reshape(
        -1, *[1] * (len(shape) - 1)
    )


NOISES: dict[str, Noise] = {
    "white": white,
    "AR(1) 0.5": lasting(0.5),
    "AR(1) 0.9": lasting(0.9),
    "1/f": flicker,
    "heavy tails": lambda rng, shape: rng.standard_t(3, shape) / np.sqrt(3),
    "drift": _drifting,
    "3 % dropped": white,
}


def run_of(rng: Generator, name: str, count: int) -> tuple[Recording, Array, SensorErrors]:
    """Return a recording, its array and the errors in the frame of sensor 1."""
    errors = rng.normal(size=(4, 12)) * SIZES
    errors[:, :3] += 1
    errors[0, 9:] = 0
    truth = SensorErrors.from_vector(errors)
    time_s = np.arange(count) / RATE_HZ
    rate = 2 * np.pi * RATE_HZ / min(count / 2, 200)
    turns = Tumble(rate).attitudes(time_s + 100 * rng.random(), rng)
    field_T = Rotation.from_quat(turns).inv().apply(FIELD_T * np.array([0.3, 0.1, -0.95]))
    readings_T = truth.distort(field_T) + NOISE_T * NOISES[name](rng, (count, 4, 3))
    scalar_T = np.linalg.norm(field_T, axis=1) + 0.05 * NOISE_T * rng.normal(size=count)
    recording = Recording(time_s, readings_T, scalar_T)
    if name == "3 % dropped":
        recording = recording.take(rng.random(count) > 0.03)
    return recording, Array(Array.cross(0.5).positions_m, np.full(4, NOISE_T), 0.05 * NOISE_T), truth


SAYS_SO = ("may last from sample to sample", "may be too small still", "hold in more than 95 % of recordings")
"""What an answer says whose standard errors may not hold."""


def pulls_of(recording: Recording, array: Array, truth: SensorErrors, method: str) -> tuple[FloatArray, bool] | None:
    """Return by how many standard errors each parameter is off, and whether the answer says so; None if refused."""
    try:
        found = calibrate(recording, array, method)
    except (InputError, Refused):
        return None
    free = found.standard_errors > 0
    off = found.errors.to_vector() - in_first_frame(truth)[0].to_vector()
    says_so = any(words in sentence for sentence in (*found.warnings, *found.notes) for words in SAYS_SO)
    return np.asarray(off[free] / found.standard_errors[free]), says_so


@click.command(help=__doc__)
@click.option("--runs", default=20, show_default=True, help="Of each method, noise and number of samples.")
@click.option("--first-seed", default=1, show_default=True)
def main(runs: int, first_seed: int) -> None:
    """Print the table, and keep it."""
    rows = []
    cases = list(product(METHODS, NOISES, SAMPLES))
    for method, name, count in track(cases, description="coverage"):
        seeds = [
            [first_seed, list(NOISES).index(name), count, run] for run in range(max(runs, min(100, 12_000 // count)))
        ]
        pulls = [pulls_of(*run_of(np.random.default_rng(seed), name, count), method) for seed in seeds]
        answered = [each for each in pulls if each is not None]
        parts = np.array([np.mean(np.abs(off) < WITHIN) for off, _ in answered])
        held, error = (float(parts.mean()), float(parts.std() / np.sqrt(len(parts)))) if answered else (np.nan, np.nan)
        saying = float(np.mean([says_so for _, says_so in answered])) if answered else 0.0
        figure = (
            f"part of 95 % intervals that hold, ± {error:.3f}, {len(answered)} of {len(pulls)} answers, "
            f"{saying:.0%} say they may not"
        )
        least, most = LEAST - BY_CHANCE * error, MOST + BY_CHANCE * error
        if saying > MOSTLY:
            least, most = 0.0, np.inf
        rows.append(Row(f"{method}, {name}, {count}", figure, [held], least=least, most=most))
    command = f"python benchmarks/error_coverage.py --runs {runs} --first-seed {first_seed}"
    show("Coverage", command, "error_coverage.csv", rows)


if __name__ == "__main__":
    main()
