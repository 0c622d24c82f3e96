"""Sensors whose drivers have clocks of their own: samples used, and the gradient's error over that of the noise.

Run ``python benchmarks/clocks.py [--runs 10]``. Four sensors with the errors of Wu's Table 1 and 1 nT of noise, and a
scalar, are turned for a minute through all directions in a uniform field. Each reads at its own times, which are its
stamps; a synchroniser joins them, and the array is calibrated. A second run is corrected: as its field has no gradient,
all that comes out is error. *Nearest* takes the nearest readings as if they were of one moment (``tolerance_s`` of half
a period). Errors of the sensors are told over their standard errors: where the array turns too fast for the rate of the
sensors (25 Hz, 180°/s), they are larger than told, and the answer warns of it.
"""

from dataclasses import dataclass

import click
import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.spatial.transform import Rotation
from spread import Row, show

from tam_calibration.fit import calibrate
from tam_calibration.messages.batch_synchroniser import BatchSynchroniser
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.samples import StreamMessages, Usage
from tam_calibration.model.array import OUTPUT_NAMES
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.results.scenario import read_scenario

SPAN_S = 60.0
"""Of a run: enough turns for a calibration, and six thousand samples at 100 Hz."""
LAYOUT = SampleLayout(4, ("scalar",))
SCENARIO = read_scenario("wu_table_1")
FIELD_T = SCENARIO.site_field_T
GRADIENT = slice(3, len(OUTPUT_NAMES))

EVERY_10_MS = (0.01,) * 4
"""Periods of four sensors at 100 Hz, the rate of most drivers of tri-axial magnetometers."""
CASES = {
    "one clock": (EVERY_10_MS, (0, 0, 0, 0), 0.0, 90.0),
    "offsets of 2.5, 5, 7.5 ms": (EVERY_10_MS, (0, 2.5e-3, 5e-3, 7.5e-3), 0.0, 90.0),
    "clocks 100 ppm apart": ((0.01, 0.01 * (1 + 1e-4), 0.01 * (1 - 1e-4), 0.01 * (1 + 2e-4)), (0, 0, 0, 0), 0.0, 90.0),
    "times that jitter by ± 2 ms": (EVERY_10_MS, (0, 2.5e-3, 5e-3, 7.5e-3), 2e-3, 90.0),
    "sensor 1 at 50 Hz, the others at 100 Hz": ((0.02, 0.01, 0.01, 0.01), (0, 2.5e-3, 5e-3, 7.5e-3), 0.0, 90.0),
    "sensor 1 at 100 Hz, the others at 50 Hz": ((0.01, 0.02, 0.02, 0.02), (0, 2.5e-3, 5e-3, 7.5e-3), 0.0, 90.0),
    "50 Hz, 180°/s": ((0.02,) * 4, (0, 5e-3, 10e-3, 15e-3), 0.0, 180.0),
    "25 Hz, 180°/s": ((0.04,) * 4, (0, 10e-3, 20e-3, 30e-3), 0.0, 180.0),
}
"""Periods, offsets and jitter of the sensors, seconds, and rate of the turns, degrees a second."""


@dataclass(frozen=True)
class Drivers:
    """Periods, offsets and jitter of the sensors, rate of the turns, length of a run, and how late stamps are."""

    periods_s: tuple[float, ...]
    offsets_s: tuple[float, ...]
    jitter_s: float
    rate_deg_per_s: float
    span_s: float = SPAN_S
    late_s: tuple[float, ...] = (0.0,) * 4


def field_of_array(time_s: FloatArray, rate_deg_per_s: float) -> FloatArray:
    """Return the field (N, 3) in the frame of an array that turns about one axis, which turns slowly itself."""
    angles = np.outer(time_s, rate_deg_per_s * np.array([1.0, 0.13, 0.047]))
    field: FloatArray = Rotation.from_euler("zxy", angles, degrees=True).inv().apply(FIELD_T)
    return field


def joined(case: str, seed: int, tolerance_s: float) -> tuple[Recording, Usage]:
    """Return the samples of a run and how many of sensor 1's readings they are."""
    return run_of(Drivers(*CASES[case]), seed, tolerance_s)


def run_of(drivers: Drivers, seed: int, tolerance_s: float = 0.0) -> tuple[Recording, Usage]:
    """Return the samples of a run of some drivers and how many of sensor 1's readings they are."""
    random = np.random.default_rng(seed)
    streams: dict[str, tuple[FloatArray, FloatArray]] = {}
    for sensor, (period, offset) in enumerate(zip(drivers.periods_s, drivers.offsets_s, strict=True)):
        count = int(drivers.span_s / period)
        time_s = offset + period * np.arange(count) + random.uniform(0, 2 * drivers.jitter_s, count)
        noise = 1e-9 * random.normal(size=(count, 3))
        readings = SCENARIO.errors.distort(field_of_array(time_s, drivers.rate_deg_per_s))[:, sensor] + noise
        streams[f"tam_{sensor + 1}"] = time_s + drivers.late_s[sensor], readings
    scalar_s = 3e-3 + 0.1 * np.arange(int(drivers.span_s / 0.1))
    streams["scalar"] = scalar_s, np.linalg.norm(FIELD_T) + 1e-10 * random.normal(size=(len(scalar_s), 1))
    every = np.concatenate([time_s for time_s, _ in streams.values()])
    order = np.split(np.argsort(np.argsort(every)), np.cumsum([len(time_s) for time_s, _ in streams.values()])[:-1])
    synchroniser = BatchSynchroniser(LAYOUT, round(tolerance_s * 1e9), expected=["scalar"])
    messages = {
        name: StreamMessages(place, np.round(time_s * 1e9).astype(np.int64), values)
        for place, (name, (time_s, values)) in zip(order, streams.items(), strict=True)
    }
    parts = synchroniser.push_batch(messages), synchroniser.flush_batch()
    stamps_ns, values = (np.concatenate(each) for each in zip(*parts, strict=True))
    return LAYOUT.recording(np.column_stack([stamps_ns * 1e-9, values])), synchroniser.usage


def measure(case: str, seed: int, tolerance_s: float) -> tuple[float, float, float]:
    """Return the part of sensor 1's readings that are used, and errors of gradient and sensors over those expected."""
    recording, usage = joined(case, 2 * seed, tolerance_s)
    calibration = calibrate(usage.with_each_reading_once(recording), SCENARIO.array)
    corrected = calibration.correct(joined(case, 2 * seed + 1, tolerance_s)[0])
    error = np.sqrt(np.mean(corrected.outputs[:, GRADIENT] ** 2))
    off, told = calibration.errors.to_vector() - SCENARIO.errors.to_vector(), calibration.standard_errors
    pulls = off[told > 0] / told[told > 0]
    noise = np.sqrt(np.mean(corrected.standard_errors[GRADIENT] ** 2))
    return usage.used / usage.received, float(error / noise), float(np.sqrt(np.mean(pulls**2)))


@click.command(help=__doc__)
@click.option("--runs", default=10, show_default=True)
def main(runs: int) -> None:
    """Measure, print and keep."""
    rows = []
    for case in track(CASES, console=Console(stderr=True)):
        used, error, pulls = zip(*(measure(case, seed, 0.0) for seed in range(runs)), strict=True)
        nearest = measure(case, 0, min(CASES[case][0]) / 2)[1]
        rows += [
            Row(case, "part of sensor 1's readings used", used, least=0.99),
            Row(case, "error of the gradient over that of the noise", error, most=1.05),
            Row(case, "the same with the nearest readings", [nearest]),
            Row(case, "errors of the sensors over their standard errors (RMS)", pulls),
        ]
    command = f"python benchmarks/clocks.py --runs {runs}"
    show("Drivers with clocks of their own, a minute of turns", command, "clocks.csv", rows)


if __name__ == "__main__":
    main()
