"""A sixth set of causes outside the library: what grippers, hinges, hulls, hum, ramps, tables, tools and wind do."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_validation.blind.disturbance import (
    ALL,
    MOVING,
    SCALAR,
    Disturbance,
    Signal,
    draw_axes,
    draw_direction,
    draw_sensor,
    draw_sensors,
    named,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_validation.blind.material import low_pass
from tam_validation.blind.outside import in_a_sensor, outside
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of

_FINE = 2000
"""Steps of the heat."""

_LINES = (0.7, 0.2, 0.1)
"""Chances to lock to the strongest line, the next one and the one after it."""


def ramp_converter(rng: Generator, scene: Scene) -> Disturbance:
    """Let a converter wait until a ramp meets its input: it reads a large value later, or earlier, than a small one."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    late = rng.choice([-1.0, 1.0]) * scene.core(sensor)

    def change(amplitude: float, _seen: object) -> Signal:
        then_s = scene.time_s[:, None] + amplitude * late
        read = np.stack([scene.readings_at(then_s[:, axis])[:, sensor, axis] for axis in range(3)], axis=1)
        return of_sensors(scene, {sensor: mask * (read - scene.readings_T[:, sensor])})

    return Disturbance("ramp_converter", (sensor + 1,), named(mask), change, "s at the full field", {})


def wrong_table_entry(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Linearise an axis by a table of 8 to 32 entries, of which one is wrong: the error is a tent about that entry."""
    reading_T = scene.readings_T[:, sensor]
    apart_T = np.ptp(reading_T, axis=0) / rng.integers(8, 33)
    entry_T = np.quantile(reading_T, rng.uniform(0.2, 0.8), axis=0)
    return np.asarray(rng.choice([-1.0, 1.0]) * np.maximum(1 - np.abs(reading_T - entry_T) / apart_T, 0))


def buffeted_arm(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let gusts shake an arm faster than samples are taken: its sensor is tilted by another angle at each of them."""
    gusts = np.exp(rng.uniform(0.3, 0.8) * draw_wander(rng, scene.duration_s, int(rng.integers(10, 30)))(scene.time_s))
    return np.cross(gusts[:, None] * rng.normal(size=(scene.sample_count, 3)), scene.core(sensor))


def soft_gripper(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let a gripper reach beside a sensor now and then and draw back: the Earth's field magnetises its soft iron.

    It comes in a quarter of each visit's time and goes in another; its place is four to seven times as far away.
    """
    middles_s = rng.uniform(0, 1, int(rng.integers(4, 10))) * scene.duration_s
    lasting_s = scene.duration_s * rng.uniform(0.03, 0.1, len(middles_s))
    near = np.clip(2 - 4 * np.abs(scene.time_s[:, None] - middles_s) / lasting_s, 0, 1).max(axis=1)
    distance = 1 + rng.uniform(3, 6) * (1 - near[:, None])
    field, toward = scene.field_T / scene.intensity_T.mean(), draw_direction(rng)
    return np.asarray((3 * np.outer(field @ toward, toward) - field) / distance**3 @ scene.response[sensor].T)


def lost_in_mean(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let a recorder average many quick readings and count lost ones as zero: now and then a mean is too small."""
    struck = rng.random(scene.sample_count) < 10 ** rng.uniform(-2.0, -1.2)
    lost = struck * rng.geometric(0.7, scene.sample_count)
    return np.asarray(-lost[:, None] * scene.readings_T[:, sensor] / scene.intensity_T.mean())


def seebeck_loop(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Join two metals in a bracket at both ends: while one joint is warmer than the other, a current flows around.

    Source: Seebeck, Magnetische Polarisation der Metalle und Erze durch Temperatur-Differenz, Berlin, 1825, p. 265.
    """
    fine_s = np.linspace(-0.5 * scene.duration_s, scene.duration_s, _FINE)
    air_C = scene.temperature(fine_s)
    thin_s, thick_s = scene.duration_s * 10 ** rng.uniform([-2.8, -1.8], [-2.2, -1.2])
    warmer_C = low_pass(air_C, thin_s, fine_s) - low_pass(air_C, thick_s, fine_s)
    current = np.interp(scene.time_s, fine_s, warmer_C)
    return np.outer(current / current.std(), draw_direction(rng))


def next_line(rng: Generator, scene: Scene) -> Disturbance:
    """Let a pumped scalar lose its line in a dead zone; leaving it, it locks to that line again or to one of the next.

    Source: Breit and Rabi, Measurement of nuclear spin, Phys. Rev. 38, 1931, p. 2082, for the lines.
    """
    cosine = scene.field_T @ draw_direction(rng) / scene.intensity_T
    bright = np.abs(cosine) * np.sqrt(np.maximum(1 - cosine**2, 0))
    dark = bright < np.quantile(bright, rng.uniform(0.05, 0.2))
    found = np.cumsum(np.diff(dark.astype(int), prepend=0) < 0)
    lines = rng.choice([-1.0, 1.0]) * rng.choice(3, found[-1] + 1, p=_LINES)
    change = proportional(of_scalar(scene, 1e-9 * lines[found]))
    return Disturbance("next_line", (SCALAR,), (), change, "nT between lines", {})


def rectified_hum(rng: Generator, scene: Scene) -> Disturbance:
    """Let the recorded current alternate: the vectors average its field to zero, the scalar does not.

    A field of amplitude b at an angle θ to the Earth's makes the mean intensity larger by b² sin²θ / 4B.
    """
    load_A = scene.current(scene.time_s)
    across = 1 - (scene.field_T @ draw_direction(rng) / scene.intensity_T) ** 2
    change = proportional(of_scalar(scene, 1e-9 * (load_A / load_A.max()) ** 2 * across))
    return Disturbance("rectified_hum", (SCALAR,), (), change, "nT", {})


def left_toolbox(rng: Generator, scene: Scene) -> Disturbance:
    """Put a toolbox of steel down beside the place where the array is turned, or take it away from there."""
    after = scene.time_s > rng.uniform(0.25, 0.75) * scene.duration_s
    there = after if rng.random() < 0.5 else ~after
    return from_beside(rng, scene, "left_toolbox", there.astype(float))


def humming_reference(rng: Generator, scene: Scene) -> Disturbance:
    """Let some sensors share a reference voltage with a generator's ripple on it, which multiplies their readings."""
    sharing = draw_sensors(rng, scene)
    angle = 2 * np.pi * rng.uniform(0.08, 0.46) * scene.time_s / scene.step_s + rng.uniform(0, 2 * np.pi)
    ripple = np.sin(angle) + rng.uniform(0, 0.3) * np.sin(2 * angle + rng.uniform(0, 2 * np.pi))
    readings = 1e-9 * ripple[:, None, None] * scene.readings_T / scene.intensity_T.mean()
    change = proportional(of_sensors(scene, {one: readings[:, one] for one in sharing}))
    return Disturbance("humming_reference", tuple(one + 1 for one in sharing), (), change, "nT", {})


def folding_arms(rng: Generator, scene: Scene) -> Disturbance:
    """Let the arms of a folding frame have play in their hinges: each lies at one stop or the other by its weight."""
    rows: dict[int, FloatArray] = {}
    down = -scene.to_world[:, 2]
    for sensor, arm in enumerate(scene.positions_m):
        hinge = np.cross(arm, draw_direction(rng))
        hinge /= norm(hinge)
        torque = down @ np.cross(hinge, arm / norm(arm))
        moved = np.where(np.abs(torque) > rng.uniform(0.05, 0.3), np.arange(len(torque)), 0)  # else friction holds it
        stop = rng.uniform(0.5, 1.5) * np.sign(torque[np.maximum.accumulate(moved)])
        rows[sensor] = 1e-9 * np.cross(np.outer(stop, hinge), scene.core(sensor))
    return Disturbance("folding_arms", (ALL,), (), proportional(of_sensors(scene, rows)), "nT", {})


def viscous_hull(rng: Generator, scene: Scene) -> Disturbance:
    """Let the iron of a hull, which lay in one heading for long, follow the field with many slow time constants.

    Source: Dunlop and Özdemir, Rock Magnetism, 1997, ch. 10.
    """
    fine_s = np.arange(0, scene.duration_s + scene.step_s, scene.step_s)
    lags_s = scene.duration_s * 10 ** rng.uniform(-1, 0.3, 5)
    followed = [sum(low_pass(one, lag_s, fine_s) for lag_s in lags_s) for one in scene.field_at(fine_s).T]
    moment = np.stack([np.interp(scene.time_s, fine_s, one) for one in followed], axis=1)
    place_m = float(np.abs(scene.positions_m).max()) * rng.uniform(2.5, 7) * draw_direction(rng)
    away_m = np.vstack([scene.positions_m, np.zeros(3)]) - place_m
    extra = np.einsum("nm,mpi->npi", moment, np.stack([dipole(one, away_m) for one in np.eye(3)]))
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("viscous_hull", (ALL,), (), change, "nT", {"distance_m": float(norm(place_m))})


def from_beside(rng: Generator, scene: Scene, effect: str, size: FloatArray) -> Disturbance:
    """Return what a dipole of some size (N,) does that rests beside the place where the array is turned."""
    distance_m = rng.uniform(0.8, 3)
    at_m = np.einsum("nij,kj->nki", scene.to_world, np.vstack([scene.positions_m, np.zeros(3)]))
    field = dipole(draw_direction(rng), at_m - distance_m * draw_direction(rng))
    extra = np.einsum("n,nji,nkj->nki", size, scene.to_world, field)
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance(effect, (ALL,), (), change, "nT", {"distance_m": distance_m})


SIXTH = {
    "ramp_converter": outside(ramp_converter, motions=MOVING),
    "wrong_table_entry": in_a_sensor(wrong_table_entry, 1.0, named="nonlinearity"),
    "buffeted_arm": in_a_sensor(buffeted_arm),
    "soft_gripper": in_a_sensor(soft_gripper),
    "lost_in_mean": in_a_sensor(lost_in_mean, named="outliers"),
    "seebeck_loop": in_a_sensor(seebeck_loop, channel="temperature"),
    "next_line": outside(next_line, scalar_needed=True, most_nT=250.0),
    "rectified_hum": outside(rectified_hum, channel="current", scalar_needed=True, most_nT=100.0),
    "left_toolbox": outside(left_toolbox),
    "humming_reference": outside(humming_reference),
    "folding_arms": outside(folding_arms, channel="attitude", named="flexure"),
    "viscous_hull": outside(viscous_hull),
}
"""The causes by their names; of those in a sensor the chance that it is one axis only. The lines of potassium are some
100 nT apart in the strongest field, and a hum of 3.3 µT adds 100 nT to the weakest."""
