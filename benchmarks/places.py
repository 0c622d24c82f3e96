"""Where a gap sits, on schedules and disturbances that the blind check does not draw.

Run ``python benchmarks/places.py``. Seeds from 1000 on judge; smaller ones are for tuning. The parts:

``fields``: a field at all sensors alike that the scalar does not feel. The answer lists both places, or the right one.
``scalars``: a scalar at fault, with attitude. The field at the array is never named.
``repeats``: the same poses in order, twice over or there and back, and shuffled. Both have the same answer. The causes
that no library has are others where the seed judges.
``spoiled``: poses read wrong on all axes of one sensor. The answer names that sensor.
``noises``: the noise of one channel that differs between two recordings. `compare` finds and closes it. That of the
scalar is up to half a per cent of the field.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import click
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from tam_calibration.comparison.compare import compare
from tam_calibration.gap import diagnose
from tam_calibration.gap.result import Gap
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

JUDGED = 1000
"""First seed that judges."""

NOISE_T, SCALAR_T, FIELD_T = 4e-9, 0.5e-9, 48e-6
"""Of fluxgates, an Overhauser magnetometer, and the Earth in middle latitudes."""

ATTITUDE = np.radians(0.05)
"""Of a good inertial system."""

ARM_M = 0.25
"""Half the baseline of Wu's cross."""

POSITIONS_M = ARM_M * np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
"""Sensors 1 to 4 at the ends of the arms, forward first."""

ARRAY = Array(positions_m=POSITIONS_M, vector_noise_T=np.full(4, NOISE_T), scalar_noise_T=SCALAR_T)
ALL, SCALAR = (1, 2, 3, 4), ("scalar",)


@dataclass(frozen=True, eq=False)
class Run:
    """Attitudes (N), the field (N, 3) in the array's frame, and the errors of the sensors."""

    turns: Rotation
    time_s: FloatArray
    world_T: FloatArray
    matrix: FloatArray
    bias_T: FloatArray

    @property
    def field_T(self) -> FloatArray:
        """(N, 3) in the array's frame."""
        return np.asarray(self.turns.inv().apply(self.world_T))

    def readings_T(self, field_T: FloatArray) -> FloatArray:
        """(N, K, 3) without noise."""
        return np.asarray(np.einsum("kij,nj->nki", self.matrix, field_T) + self.bias_T)


def run(source: Generator, turns: Rotation, rate_hz: float = 10.0) -> Run:
    """Draw a field that drifts a little, and sensors."""
    count = len(turns)
    heading, dip = source.uniform(0, 2 * np.pi), source.uniform(-1.2, 1.2)
    mean = FIELD_T * np.array([np.cos(dip) * np.cos(heading), np.cos(dip) * np.sin(heading), -np.sin(dip)])
    drift = source.choice([0.0, 1e-9, 5e-9]) * np.cumsum(source.normal(size=(count, 3)), axis=0) / np.sqrt(count)
    matrix = np.eye(3) + source.uniform(-0.04, 0.04, (4, 3, 3))
    return Run(turns, np.arange(count) / rate_hz, mean + drift, matrix, source.uniform(-2e-6, 2e-6, (4, 3)))


def tumbling(source: Generator, count: int) -> Rotation:
    """Turn smoothly through attitudes that are drawn at random."""
    knots = max(count // 25, 24)
    return Slerp(np.arange(knots), Rotation.random(knots, random_state=source))(np.linspace(0, knots - 1.001, count))


def poses(source: Generator, count: int) -> Rotation:
    """Turn a table in steps at tilts of its axis."""
    around = 12
    yaw = np.tile(np.arange(around) * 2 * np.pi / around, count // around)
    tilts = source.permutation(np.linspace(-1.4, 1.4, count // around))
    rolls = source.uniform(-1.4, 1.4, count // around)
    return Rotation.from_euler("ZYX", np.column_stack([yaw, np.repeat(tilts, around), np.repeat(rolls, around)]))


def recorded(
    source: Generator,
    made: Run,
    field_T: FloatArray,
    scalar_T: FloatArray,
    readings_T: FloatArray | float = 0.0,
    attitude: bool = True,
) -> Recording:
    """Add noise to what the sensors, the scalar and the attitude have."""
    readings = made.readings_T(field_T) + readings_T
    readings = readings + source.normal(size=readings.shape) * NOISE_T
    scalar = scalar_T + source.normal(size=len(scalar_T)) * SCALAR_T
    errors = Rotation.from_rotvec(source.normal(size=(len(scalar), 3)) * ATTITUDE)
    quaternion = (made.turns * errors).as_quat() if attitude else None
    return Recording(time_s=made.time_s, readings_T=readings, scalar_T=scalar, attitude=quaternion)


def course(source: Generator, kind: str, time_s: FloatArray) -> FloatArray:
    """Draw a course (N,) of unit mean square."""
    count = len(time_s)
    share = np.arange(count) / count
    made: FloatArray
    if kind == "random":
        made = source.normal(size=count)
    elif kind == "episodes":
        edges = np.sort(source.uniform(0.05, 0.95, 2 * source.integers(2, 5)))
        made = np.searchsorted(edges, share) % 2 * source.uniform(0.5, 1.5)
    elif kind == "slow":
        order = np.arange(1, 5)[:, None]
        waves = np.cos(np.pi * order * share + source.uniform(0, 6, (4, 1))) / order
        made = np.asarray(source.normal(size=4) @ waves)
    elif kind == "walk":
        made = np.cumsum(source.normal(size=count))
    elif kind == "steps":
        made = source.normal(size=4)[np.searchsorted(np.sort(source.uniform(0.1, 0.9, 3)), share)]
    else:
        made = np.cos(2 * np.pi * source.uniform(0.05, 0.4) * np.arange(count) + source.uniform(0, 6))
    made = made - np.mean(made)
    return np.asarray(made / np.sqrt(np.mean(made**2)))


COURSES = ("random", "episodes", "slow", "steps", "tone", "walk")


def size_T(floors: float) -> float:
    """Return the size in the intensity that makes a gap of so many floors: one channel in ten has it."""
    return float(floors * np.sqrt(10) * np.hypot(NOISE_T / 2, SCALAR_T))


def schedule(source: Generator, number: int) -> Rotation:
    """Draw poses, or a tumble of some thousand samples."""
    return poses(source, 144) if number % 4 == 3 else tumbling(source, int(source.choice([800, 1500, 3000])))


def draw_field(seed: int, number: int) -> tuple[str, Recording, bool]:
    """Draw a field that all sensors feel and the scalar does not."""
    source = np.random.default_rng([seed, number])
    kind, with_attitude = COURSES[number % len(COURSES)], number // len(COURSES) % 2 == 0
    made = run(source, schedule(source, number // 2))
    mean = made.world_T.mean(axis=0) / FIELD_T
    axis = source.normal(size=3)
    axis /= np.linalg.norm(axis)
    if kind == "random" and source.random() < 0.5:
        world = source.normal(size=made.world_T.shape)
    else:
        axis = axis if abs(axis @ mean) > 0.3 else mean
        world = course(source, kind, made.time_s)[:, None] * axis
    floors = float(np.exp(source.uniform(0, np.log(30))))
    extra = world * size_T(floors) / np.std(world @ mean)
    scalar = np.linalg.norm(made.world_T, axis=1)
    field = made.field_T + made.turns.inv().apply(extra)
    return f"{kind} {floors:.1f}", recorded(source, made, field, scalar, attitude=with_attitude), with_attitude


def draw_scalar(seed: int, number: int) -> tuple[str, Recording, bool]:
    """Draw a scalar at fault."""
    source = np.random.default_rng([seed, number, 1])
    kind = COURSES[number % len(COURSES)]
    made = run(source, schedule(source, number))
    floors = float(np.exp(source.uniform(0, np.log(30))))
    scalar = np.linalg.norm(made.world_T, axis=1) + size_T(floors) * course(source, kind, made.time_s)
    return f"{kind} {floors:.1f}", recorded(source, made, made.field_T, scalar), True


def places_of(gap: Gap) -> list[tuple[int | str, ...]]:
    """Return the places of the strongest law, or of the gap."""
    return [tuple(place) for place in gap.signature[0].places] if gap.signature else [gap.where.sensors]


def summary(gap: Gap) -> str:
    """Return the answer on a line."""
    laws = [(law.law, law.course, law.places, round(law.energy, 2)) for law in gap.signature]
    causes = [(one.fitted.effect, one.sensors, round(one.probability, 3)) for one in gap.causes]
    return f"{gap.verdict} {gap.where.sensors} {causes} {laws}"


def fields(seed: int, count: int) -> Iterator[tuple[bool, str]]:
    """Judge fields: both places, or the right one where there is an attitude; the scalar alone is never named."""
    for number in range(count):
        name, recording, with_attitude = draw_field(seed, number)
        gap = diagnose(recording, ARRAY)
        places = places_of(gap)
        right = {ALL, SCALAR} <= set(places) or (with_attitude and places == [ALL])
        alone = places == [SCALAR] or "alike" not in gap.statement
        yield right and not alone, f"{name} attitude {with_attitude}: {summary(gap)}"


def scalars(seed: int, count: int) -> Iterator[tuple[bool, str]]:
    """Judge scalars at fault: the field at the array is not among the places."""
    for number in range(count):
        name, recording, _ = draw_scalar(seed, number)
        gap = diagnose(recording, ARRAY)
        named = [place for place in (*places_of(gap), gap.where.sensors) if len(place) > 1]
        yield not named and "alike" not in gap.statement, f"{name}: {summary(gap)}"


TUNED = ("flexure", "temperature", "quartic", "cross product", "loose part")
OTHERS = ("flexure", "temperature", "eight resting places", "rectified", "fifth harmonic of the heading")
"""Causes that go with the pose: a rule was made by the first ones."""


def draw_repeats(seed: int, number: int) -> tuple[str, Recording, Recording]:
    """Draw a cause that goes with the pose, in order and shuffled."""
    source = np.random.default_rng([seed, number, 2])
    kind = (OTHERS if seed >= JUDGED else TUNED)[number % 5]
    once = poses(source, 72)
    forwards, held = np.arange(72), np.repeat(np.arange(36), 2)
    order = (np.tile(forwards, 2), np.append(forwards, forwards[::-1]), np.tile(held, 2))[number // 5 % 3]
    made = run(source, once[order], 0.1)
    sensor, floors = int(source.integers(4)), float(source.uniform(3, 9))
    field = made.field_T
    up = made.turns.inv().apply([0, 0, 1.0])
    unit = field / FIELD_T
    temperature = None
    if kind == "flexure":
        shift = np.cross(up @ source.normal(size=(3, 3)).T, unit)
    elif kind == "temperature":
        temperature = 20 + 8 * np.interp(np.arange(144), np.linspace(0, 143, 9), source.normal(size=9))
        shift = (temperature - 20)[:, None] * source.normal(size=3)
    elif kind == "quartic":
        shift = np.outer((unit @ _unit(source)) ** 4, _unit(source))
    elif kind == "cross product":
        shift = np.outer((unit @ _unit(source)) * (unit @ _unit(source)) * (up @ _unit(source)), _unit(source))
    elif kind == "loose part":
        shift = np.outer(np.sign(up @ _unit(source)), _unit(source))
    elif kind == "eight resting places":
        shift = source.normal(size=(8, 3))[(up > 0) @ [1, 2, 4]]
    elif kind == "rectified":
        shift = np.outer(np.abs(unit @ _unit(source)), _unit(source))
    else:
        heading = np.unwrap(made.turns.as_euler("ZYX")[:, 0])
        shift = np.outer(np.cos(5 * heading + source.uniform(0, 6)), _unit(source))
    shift = shift - shift.mean(axis=0)
    shift *= floors * np.sqrt(10) * NOISE_T / np.sqrt(np.mean(np.sum(shift**2, axis=1)))
    added = np.zeros((144, 4, 3))
    added[:, sensor] = shift
    recording = recorded(source, made, field, np.linalg.norm(made.world_T, axis=1), added)
    if temperature is not None:
        recording = replace(recording, temperature_C=temperature)
    mixed = source.permutation(144)
    return kind, recording, _ordered(recording, mixed)


def _unit(source: Generator) -> FloatArray:
    drawn = source.normal(size=3)
    return np.asarray(drawn / np.linalg.norm(drawn))


def _ordered(recording: Recording, order: NDArray[np.intp]) -> Recording:
    names = ("readings_T", "scalar_T", "attitude", "temperature_C")
    given = {name: getattr(recording, name) for name in names}
    mixed: dict[str, Any] = {name: one if one is None else one[order] for name, one in given.items()}
    return replace(recording, **mixed)


def repeats(seed: int, count: int) -> Iterator[tuple[bool, str]]:
    """Judge pairs: verdict, causes and place are the same in order and shuffled."""
    for number in range(count):
        name, *pair = draw_repeats(seed, number)
        gaps = [diagnose(one, ARRAY) for one in pair]
        answers = [(gap.verdict, sorted(one.fitted.effect for one in gap.causes), gap.where.sensors) for gap in gaps]
        yield answers[0] == answers[1], f"{name}: {summary(gaps[0])} | {summary(gaps[1])}"


def draw_spoiled(seed: int, number: int) -> tuple[int, int, Recording]:
    """Draw 72 poses of which some are read wrong on all axes of one sensor."""
    source = np.random.default_rng([seed, number, 3])
    made = run(source, poses(source, 72), 0.1)
    sensor, count = int(source.integers(4)), int(source.integers(3, 12))
    added = np.zeros((72, 4, 3))
    struck = source.choice(72, count, replace=False)
    added[struck, sensor] = source.choice([-1, 1], (count, 3)) * source.uniform(20e-9, 60e-9, (count, 3))
    scalar = np.linalg.norm(made.world_T, axis=1)
    return sensor + 1, count, recorded(source, made, made.field_T, scalar, added, attitude=number % 2 == 0)


def spoiled(seed: int, count: int) -> Iterator[tuple[bool, str]]:
    """Judge spoiled poses: the right sensor, and no other."""
    for number in range(count):
        sensor, struck, recording = draw_spoiled(seed, number)
        gap = diagnose(recording, ARRAY)
        named = {gap.where.sensors, *(one.sensors for one in gap.causes), places_of(gap)[0]}
        yield named == {(sensor,)}, f"{struck} of sensor {sensor}: {summary(gap)}"


def noises(seed: int, count: int) -> Iterator[tuple[bool, str]]:
    """Judge pairs: the noise is found, and the mend closes the gap to 1.2 floors."""
    for number in range(count):
        source = np.random.default_rng([seed, number, 4])
        turns = poses(source, 72) if number % 4 == 3 else tumbling(source, int(source.choice([400, 1500])))
        made = run(source, turns)
        scalar = np.linalg.norm(made.world_T, axis=1)
        clean = recorded(source, made, made.field_T, scalar)
        factor = float(np.exp(source.uniform(np.log(2), np.log(20))))
        channel = int(source.integers(4)) - 1 if number % 3 else -1
        more = np.sqrt(factor**2 - 1)
        if channel < 0:
            scale = SCALAR_T * (25 if number % 2 == 0 or len(turns) == 72 else 1)
            real = replace(clean, scalar_T=clean.scalar_T + source.normal(size=len(scalar)) * more * scale)
        else:
            readings = clean.readings_T.copy()
            axes = slice(None) if number % 2 else [int(source.integers(3))]
            readings[:, channel, axes] += source.normal(size=readings[:, channel, axes].shape) * more * NOISE_T
            real = replace(clean, readings_T=readings)
        other = recorded(source, made, made.field_T, scalar)
        comparison = compare(other, real, ARRAY)
        changed = [one for one in comparison.noise if one.differs and one.recording.sensor == channel + 1]
        closing = comparison.closing
        is_closed = closing is not None and closing.after <= 1.2
        levels = [(one.simulation.level_T, one.recording.level_T) for one in comparison.noise]
        words = f"channel {channel} × {factor:.1f}, {len(turns)} samples: {comparison.statement} {levels[-1:]}"
        yield comparison.verdict == "differs" and bool(changed) and is_closed, words


PARTS: dict[str, tuple[Callable[[int, int], Iterator[tuple[bool, str]]], int]] = {
    "fields": (fields, 60),
    "scalars": (scalars, 30),
    "repeats": (repeats, 60),
    "spoiled": (spoiled, 60),
    "noises": (noises, 40),
}


@click.command(help=__doc__)
@click.option("--only", type=click.Choice(list(PARTS)), multiple=True, help="Parts that are run.")
@click.option("--seed", default=JUDGED, show_default=True, help="Judged from 1000 on.")
@click.option("--cases", type=int, help="Of each part.")
@click.option("--verbose", is_flag=True, help="Print the right ones as well.")
def main(only: tuple[str, ...], seed: int, cases: int | None, verbose: bool) -> None:
    """Run the benchmark."""
    for name in only or PARTS:
        judge, count = PARTS[name]
        results = []
        for number, (is_right, words) in enumerate(judge(seed, cases or count)):
            results.append(is_right)
            if verbose or not is_right:
                print(f"  {number:3d} {'right' if is_right else 'WRONG'} {words}", flush=True)
        print(f"{name}: {sum(results)} of {len(results)} right", flush=True)


if __name__ == "__main__":
    main()
