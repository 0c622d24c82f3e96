"""What the live update makes of sources that are passed and of noise that lasts.

Run ``python benchmarks/live_passes.py --half made|judged|day [--runs 4] [--first-seed 1]``.

A cross is calibrated ashore as in ``live.py``, then travels for twelve minutes at 100 or 10 Hz, with ``on_change:
learn``. It passes a source every two minutes, its noise or its scalar is slow, or one bias jumps half-way. Counted are
passes in which a sensor is blamed, other changes that are told, and published calibrations whose tensor error is above
1.2 times that of the stored one and 0.5 nT/m; of jumps whether the sensor is named. The rules were made on the kinds
``made`` and are judged on the others. ``day`` counts the changes that are told in 24 hours of noise that lasts.
"""

from collections.abc import Callable
from dataclasses import dataclass

import click
import numpy as np
from live import ARRAY, TILT, WORLD_T, ashore, errors_of
from noises import Noise, flicker, lasting, white
from numpy.linalg import norm
from numpy.random import Generator
from rich.progress import track
from scipy.spatial.transform import Rotation
from spread import Row, show

from tam_calibration.correction.calibration import Calibration
from tam_calibration.live.live import Live
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

MINUTES, EVERY_S, NEAR_S = 12, 120.0, 50.0
"""Length of a mission, time from one pass to the next, and to both sides of one within which the source is felt."""

NOISE_T, SCALAR_NOISE_T = ARRAY.vector_noise_T[0], ARRAY.scalar_noise_T

TIMES_STORED, BESIDE_T_PER_M = 1.2, 0.5e-9
"""Largest tensor error that a published calibration may have: a multiple of the stored one's, plus a constant."""

Source = Callable[[Generator], Callable[[FloatArray], FloatArray]]
"""Draws a source, and gives its field (..., 3) at places (..., 3) beside its nearest point, tesla and metres."""


@dataclass(frozen=True)
class Kind:
    """A mission: what is passed at which speed, and what is slow."""

    source: Source | None = None
    rate_hz: float = 100.0
    speed_m_s: float = 1.5
    noise: Noise = white
    scalar_T: Callable[[Generator, FloatArray, FloatArray], FloatArray] = lambda rng, time_s, yaw: 0 * time_s
    drift_T_per_h: float = 0.0
    jump_T: float = 0.0
    missions: int = 1


def dipole(moment_A_m2: float, distance_m: float) -> Source:
    """Return a dipole of any direction, passed below or beside."""

    def drawn(rng: Generator) -> Callable[[FloatArray], FloatArray]:
        moment, place = rng.normal(size=3), _beside(rng, distance_m)
        moment *= moment_A_m2 / norm(moment)

        def field(at_m: FloatArray) -> FloatArray:
            offset = at_m - place
            distance = norm(offset, axis=-1, keepdims=True)
            unit = offset / distance
            along = np.sum(unit * moment, axis=-1, keepdims=True)
            return np.asarray(1e-7 * (3 * unit * along - moment) / distance**3)

        return field

    return drawn


def cable(current_A: float, distance_m: float) -> Source:
    """Return a straight cable that is crossed at any angle."""

    def drawn(rng: Generator) -> Callable[[FloatArray], FloatArray]:
        angle = rng.uniform(0.5, 2.6)
        along = np.array([np.cos(angle), np.sin(angle), 0.0])

        def field(at_m: FloatArray) -> FloatArray:
            offset = at_m + np.array([0, 0, distance_m])
            offset = offset - np.sum(offset * along, axis=-1, keepdims=True) * along
            square = np.sum(offset**2, axis=-1, keepdims=True)
            return np.asarray(2e-7 * current_A * np.cross(along, offset) / square)

        return field

    return drawn


def pair(moment_A_m2: float, distance_m: float) -> Source:
    """Return two dipoles some metres apart."""

    def drawn(rng: Generator) -> Callable[[FloatArray], FloatArray]:
        one, other = (dipole(moment_A_m2, distance_m)(rng) for _ in range(2))
        shift = np.array([rng.uniform(3, 10), 0, 0])
        return lambda at_m: one(at_m) + other(at_m - shift)

    return drawn


def wreck(moment_A_m2: float, distance_m: float) -> Source:
    """Return eight dipoles within three metres along the path."""

    def drawn(rng: Generator) -> Callable[[FloatArray], FloatArray]:
        parts = [(dipole(moment_A_m2, distance_m)(rng), rng.uniform(-3, 3)) for _ in range(8)]
        return lambda at_m: sum((part(at_m - np.array([x_m, 0, 0])) for part, x_m in parts), np.zeros(3))

    return drawn


def beside_white(other: Noise) -> Noise:
    """Return noise beside white noise of unit variance."""
    return lambda rng, shape: white(rng, shape) + other(rng, shape)


def telegraph(rng: Generator, shape: tuple[int, ...]) -> FloatArray:
    """Return 0 or 1 in each channel, which changes every 20 s in the mean at 100 Hz."""
    return np.cumsum(rng.random(shape) < 1 / 2000, axis=0) % 2 - 0.5


def tone(rng: Generator, shape: tuple[int, ...]) -> FloatArray:
    """Return a sine of 0.5 and of 900 samples, of any phase in each channel."""
    time = np.arange(shape[0]).reshape(-1, *[1] * (len(shape) - 1))
    return 0.5 * np.sin(2 * np.pi * (time / 900 + rng.random(shape[1:])))


def _beside(rng: Generator, distance_m: float) -> FloatArray:
    angle = rng.uniform(0, 2 * np.pi)
    return distance_m * np.array([0.0, np.cos(angle), np.sin(angle)])


MADE = {
    "161 A m² at 4 m": Kind(dipole(161, 4)),
    "500 A m² at 4 m": Kind(dipole(500, 4)),
    "161 A m² at 6 m": Kind(dipole(161, 6)),
    "1000 A m² at 6 m": Kind(dipole(1000, 6)),
    "161 A m² at 10 m": Kind(dipole(161, 10)),
    "1000 A m² at 10 m": Kind(dipole(1000, 10)),
    "161 A m² at 6 m, 10 Hz": Kind(dipole(161, 6), 10.0),
    "noise AR(1) 0.5": Kind(noise=lasting(0.5)),
    "noise AR(1) 0.9": Kind(noise=lasting(0.9)),
    "scalar follows heading, 0.5 nT": Kind(scalar_T=lambda rng, time_s, yaw: 0.5e-9 * np.cos(yaw)),
    "scalar 5 nT in an hour": Kind(scalar_T=lambda rng, time_s, yaw: 5e-9 * np.sin(2 * np.pi * time_s / 3600)),
    "jump of 1 nT": Kind(jump_T=1e-9),
    "jump of 2 nT, 10 Hz": Kind(jump_T=2e-9, rate_hz=10.0),
    "300 A m² at 5 m, 0.7 m/s": Kind(dipole(300, 5), speed_m_s=0.7),
    "700 A m² at 8 m, 2.5 m/s": Kind(dipole(700, 8), speed_m_s=2.5),
    "100 A m² at 4 m, 10 Hz": Kind(dipole(100, 4), 10.0),
    "two of 400 A m² at 6 m": Kind(pair(400, 6)),
    "cable of 20 A at 5 m": Kind(cable(20, 5)),
    "cable of 2 A at 4 m, 10 Hz": Kind(cable(2, 4), 10.0),
    "noise AR(1) 0.97": Kind(noise=lasting(0.97)),
    "noise 1/f": Kind(noise=flicker),
    "scalar walks by 1 nT in ten minutes": Kind(
        scalar_T=lambda rng, time_s, yaw: 1e-9 * np.cumsum(rng.normal(size=len(time_s))) / np.sqrt(len(time_s))
    ),
    "biases drift by 5 nT in an hour": Kind(drift_T_per_h=5e-9),
    "jump of 1.5 nT beside AR(1) 0.5": Kind(noise=lasting(0.5), jump_T=1.5e-9),
    "jump of 3 nT, 10 Hz": Kind(jump_T=3e-9, rate_hz=10.0),
}
"""Kinds on which the rules were made."""

JUDGED = {
    "250 A m² at 4.5 m, 1 m/s": Kind(dipole(250, 4.5), speed_m_s=1.0),
    "900 A m² at 9 m, 10 Hz": Kind(dipole(900, 9), 10.0),
    "wreck of eight of 100 A m² at 7 m": Kind(wreck(100, 7)),
    "cable of 50 A at 8 m, 2 m/s": Kind(cable(50, 8), speed_m_s=2.0),
    "noise 1/f of 3 nT": Kind(noise=lambda rng, shape: 3 * flicker(rng, shape)),
    "noise AR(1) of a minute": Kind(noise=lasting(float(np.exp(-1 / 6000)))),
    "biases that jump to and fro by 1 nT": Kind(noise=beside_white(telegraph)),
    "tones of 0.5 nT and 9 s": Kind(noise=beside_white(tone)),
    "scalar follows roll, 0.5 nT": Kind(scalar_T=lambda rng, time_s, yaw: 0.5e-9 * np.sin(2 * np.pi * time_s / 5.1)),
    "scalar steps by 0.3 nT every two minutes": Kind(
        scalar_T=lambda rng, time_s, yaw: 0.3e-9 * rng.choice([-1, 1], size=9)[(time_s // 120).astype(int)]
    ),
    "scalar 1/f of 0.5 nT": Kind(scalar_T=lambda rng, time_s, yaw: 0.5e-9 * flicker(rng, time_s.shape)),
    "biases drift by 2 nT in an hour": Kind(drift_T_per_h=2e-9),
    "jump of 1.2 nT": Kind(jump_T=1.2e-9),
    "jump of 2.5 nT, 10 Hz": Kind(jump_T=2.5e-9, rate_hz=10.0),
}
"""Kinds that were tried once, with the present rules."""

DAY = {
    "noise AR(1) 0.5 for 24 h": Kind(noise=lasting(0.5), missions=120),
    "noise AR(1) 0.9 for 24 h": Kind(noise=lasting(0.9), missions=120),
}
"""Noise that lasts, for a day."""

KINDS = {"made": MADE, "judged": JUDGED, "day": DAY}


def mission(rng: Generator, kind: Kind, errors: SensorErrors, begin_s: float) -> FloatArray:
    """Return the rows (N, 15) of a mission that begins at a time, as ``Live.add`` takes them."""
    count = int(MINUTES * 60 * kind.rate_hz)
    time_s = np.arange(count) / kind.rate_hz
    yaw = 0.5 * np.sin(2 * np.pi * time_s / 61)
    pitch, roll = TILT * 0.4 * np.sin(2 * np.pi * time_s / 7.3), TILT * 0.4 * np.sin(2 * np.pi * time_s / 5.1)
    turns = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).as_matrix()
    field_T = np.tile(WORLD_T, (count, 5, 1))  # at the sensors, and at the scalar in their middle
    places_m = np.einsum("nij,kj->nki", turns, np.vstack([ARRAY.positions_m, np.zeros(3)]))
    if kind.source is not None:
        for passed_s in np.arange(EVERY_S, MINUTES * 60, EVERY_S):
            near = np.abs(time_s - passed_s) < NEAR_S
            path_m = kind.speed_m_s * (time_s[near] - passed_s)[:, None, None] * np.array([1.0, 0, 0])
            field_T[near] += kind.source(rng)(path_m + places_m[near])
    readings_T = errors.distort(np.einsum("nji,nkj->nki", turns, field_T[:, :-1]))
    readings_T += NOISE_T * kind.noise(rng, readings_T.shape)
    readings_T += kind.drift_T_per_h * rng.normal(size=(4, 3)) * (time_s / 3600)[:, None, None]
    direction = rng.normal(size=3)
    readings_T[count // 2 :, 2] += kind.jump_T * direction / norm(direction)
    scalar_T = norm(field_T[:, -1], axis=1) + SCALAR_NOISE_T * rng.normal(size=count)
    scalar_T += kind.scalar_T(rng, time_s, yaw)
    return np.column_stack([1000 + begin_s + time_s, readings_T.reshape(count, -1), scalar_T, np.full(count, np.nan)])


def tensor_error(calibration: Calibration, errors: SensorErrors) -> float:
    """Return by how much corrected sensors differ in a uniform field, over their distance, T/m: all directions."""
    field_T = 50e-6 * np.random.default_rng(1).normal(size=(200, 3)) / np.sqrt(3)
    seen_T = calibration.errors.restore(errors.distort(field_T))
    apart_T = seen_T - seen_T.mean(axis=1, keepdims=True)
    return float(np.sqrt(np.mean(np.sum(apart_T**2, axis=2)))) / 0.25


def travel(rng: Generator, kind: Kind) -> tuple[int, int, bool, bool]:
    """Return how often sensors, and all together, were blamed; whether sensor 3 was, and a calibration was worse."""
    errors = errors_of(rng)
    live = Live(ashore(errors, rng), "learn")
    allowed = TIMES_STORED * tensor_error(live.calibration, errors) + BESIDE_T_PER_M
    worse = False
    for begin_s in MINUTES * 60.0 * np.arange(kind.missions):
        for some in np.array_split(mission(rng, kind, errors, begin_s), MINUTES * 60 * 5):
            live.add(some)
            told = live.news()
            if told is not None and not (kind.jump_T or kind.drift_T_per_h):
                worse |= tensor_error(told, errors) > allowed
    of_sensors = [each for each in live.state.changes if "of sensor" in each.sentence or "biases of" in each.sentence]
    blames_third = any("sensor 3" in each.sentence for each in live.state.changes)
    return len(of_sensors), len(live.state.changes), blames_third, worse


@click.command(help=__doc__)
@click.option("--half", type=click.Choice(list(KINDS)), required=True)
@click.option("--runs", default=4, show_default=True, help="Missions of each kind, of five passes each.")
@click.option("--first-seed", default=1, show_default=True)
def main(half: str, runs: int, first_seed: int) -> None:
    """Print the table, and keep it."""
    rows, passes = [], max(int(MINUTES * 60 / EVERY_S) - 1, 1)
    for place, (name, kind) in enumerate(track(KINDS[half].items(), description=half)):
        told = [travel(np.random.default_rng([first_seed, len(half), place, run]), kind) for run in range(runs)]
        of_sensors, changes, of_third, worse = np.array(told, dtype=float).mean(axis=0)
        if kind.jump_T:
            rows.append(Row(name, "sensor named", [of_third], least=1.0))
        elif kind.source is not None:
            rows.append(Row(name, "passes in which a sensor is blamed", [of_sensors / passes], most=0.02))
            rows.append(Row(name, "passes in which the scalar is blamed", [(changes - of_sensors) / passes]))
        else:
            rows.append(Row(name, "changes told in a mission", [changes]))
        if not (kind.jump_T or kind.drift_T_per_h):
            rows.append(Row(name, "missions with a worse calibration published", [worse], most=0.0))
    command = f"python benchmarks/live_passes.py --half {half} --runs {runs} --first-seed {first_seed}"
    show("Sources and slow noise during the live update", command, f"live_passes_{half}.csv", rows)


if __name__ == "__main__":
    main()
