"""A fourteenth set of causes outside the library: belts, bottles, daylight, firmware and set pulses."""

import numpy as np
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_validation.blind.disturbance import (
    ALL,
    MOVING,
    SCALAR,
    Disturbance,
    Signal,
    draw_direction,
    draw_sensors,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_validation.blind.outside import in_a_sensor, outside, turning_rate
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of


def relearned_offset(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Calibrate a sensor by its own firmware: now and then it takes the middle of its latest extremes for its offset.

    The middle depends on the attitudes since the last time, so that the offset steps although nothing magnetic moved.
    """
    learnings = int(rng.integers(5, 10))
    ends = np.cumsum(rng.uniform(0.5, 1.5, learnings + 1))
    cuts = (ends[:-1] / ends[-1] * scene.sample_count).astype(int)
    parts = np.split(scene.core(sensor), cuts)
    middles = [(part.max(axis=0) + part.min(axis=0)) / 2 for part in parts[:-1]]
    held = np.searchsorted(cuts, np.arange(scene.sample_count), side="right")
    return -np.vstack([np.zeros(3), *middles])[held]


def set_pulse_tail(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Magnetise a bridge's film anew by current pulses: a reading that starts too soon after one holds its tail.

    A timer of its own sends the pulses, with a resistor and a capacitor that keep the interval to some per cent.
    """
    interval_s, tail_s = scene.step_s * rng.uniform(15, 60), scene.step_s * rng.uniform(0.1, 0.3)
    count = int(1.2 * scene.duration_s / interval_s) + 5
    pulses_s = np.cumsum(interval_s * rng.uniform(0.95, 1.05, count)) - interval_s * rng.uniform(1, 2)
    last = np.searchsorted(pulses_s, scene.time_s, side="right")
    tail = np.exp(-(scene.time_s - np.append(-np.inf, pulses_s)[last]) / tail_s)
    held = np.where(tail > 0.02, tail, 0)  # later the amplifier has settled
    return np.outer(held, rng.choice([-1, 1], 3) * rng.uniform(0.5, 1.5, 3))


def adaptive_smoothing(rng: Generator, scene: Scene) -> Disturbance:
    """Smooth some sensors by a filter that is slow at rest and quick in a turn: the delay falls with the speed.

    The cutoff frequency is a line in the speed, and the delay goes with its inverse (1€ filter, Casiez et al. 2012).
    """
    smoothed, speed = draw_sensors(rng, scene), np.linalg.norm(turning_rate(scene), axis=1)
    late = 1 / (1 + rng.uniform(2, 6) * speed / np.median(speed))
    late /= late.mean()

    def change(amplitude: float, _seen: object) -> Signal:
        waited = scene.readings_at(scene.time_s - amplitude * late) - scene.readings_T
        return of_sensors(scene, {one: waited[:, one] for one in smoothed})

    return Disturbance("adaptive_smoothing", tuple(one + 1 for one in smoothed), (), change, "s on the mean", {})


def surfacing_daylight(rng: Generator, scene: Scene) -> Disturbance:
    """Surface with a pumped scalar that is not quite tight to light: daylight adds shot noise to its photodiode.

    Coastal water takes a factor e from the light in two to five metres; the noise goes with the root of the light.
    """
    dives, clear_m = int(rng.integers(3, 7)), rng.uniform(2, 5)
    corners_s = np.sort(rng.uniform(0, 1, 4 * dives)) * scene.duration_s  # leave the surface, arrive, leave, arrive
    deep_m = np.outer(rng.uniform(15, 40, dives), [0, 1, 1, 0]).ravel()
    light = np.exp(-np.interp(scene.time_s, corners_s, deep_m) / clear_m)
    noise = 1e-9 * rng.normal(size=scene.sample_count) * np.sqrt(light)
    change = proportional(of_scalar(scene, noise))
    return Disturbance("surfacing_daylight", (SCALAR,), (), change, "nT at the surface", {"dives": dives})


def emptying_bottle(rng: Generator, scene: Scene) -> Disturbance:
    """Breathe a steel bottle empty: as the stress in its wall falls, so does what the Earth's field induces in it.

    A bottle of 200 bar, 17 cm and 5 mm of wall loses some 300 MPa, which changes the permeability of steel by tens of
    per cent (Villari's effect, Jiles 1995). The wall keeps a little magnetisation, which the stress changes too.
    """
    work = 1 + 0.5 * np.tanh(draw_wander(rng, scene.duration_s, 6)(scene.time_s))
    used = np.cumsum(work * np.gradient(scene.time_s))
    along, toward = draw_direction(rng), draw_direction(rng)
    field = scene.field_T / scene.intensity_T.mean()
    induced = 0.3 * field + 0.7 * np.outer(field @ along, along)  # a long body is magnetised lengthwise
    moment = (used / used[-1])[:, None] * (induced + rng.uniform(-0.2, 0.2) * along)
    distance_m = float(np.abs(scene.positions_m).max()) + rng.uniform(0.4, 0.8)
    away_m = np.vstack([scene.positions_m, np.zeros(3)]) - distance_m * toward
    extra = np.einsum("nm,mpi->npi", moment, np.stack([dipole(one, away_m) for one in np.eye(3)]))
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("emptying_bottle", (ALL,), (), change, "nT", {"distance_m": distance_m})


def belt_drive(rng: Generator, scene: Scene) -> Disturbance:
    """Turn the array by a belt from a magnetised shaft: that stands beside it, and turns some times for each turn.

    The teeth of two pulleys are seldom multiples of each other, so that one heading meets the shaft at many angles.
    """
    driven, driving = int(rng.integers(60, 97)), int(rng.integers(16, 25))
    near_m, bearing, height_m = rng.uniform(0.6, 1.2), rng.uniform(0, 2 * np.pi), rng.uniform(-0.5, 0)
    shaft_m = np.array([near_m * np.cos(bearing), near_m * np.sin(bearing), height_m])
    angle = scene.motion.angles(scene.time_s)[:, 0] * driven / driving + rng.uniform(0, 2 * np.pi)
    at_m = np.einsum("nij,kj->nki", scene.to_world, np.vstack([scene.positions_m, np.zeros(3)]))
    north, west = (dipole(one, at_m - shaft_m) for one in np.eye(3)[:2])
    world = np.cos(angle)[:, None, None] * north + np.sin(angle)[:, None, None] * west
    extra = np.einsum("nji,nkj->nki", scene.to_world, world)
    change = carried(scene, 1e-9 * extra / size_of(extra))
    parameters = {"teeth_driven": driven, "teeth_driving": driving, "distance_m": near_m}
    return Disturbance("belt_drive", (ALL,), (), change, "nT", parameters)


FOURTEENTH = {
    "relearned_offset": in_a_sensor(relearned_offset, named="bias_jump"),
    "set_pulse_tail": in_a_sensor(set_pulse_tail, 0.4, named="outliers"),
    "adaptive_smoothing": outside(adaptive_smoothing, motions=MOVING, named="time_skew"),
    "surfacing_daylight": outside(surfacing_daylight, scalar_needed=True, most_nT=100.0, named="noise_excess"),
    "emptying_bottle": outside(emptying_bottle),
    "belt_drive": outside(belt_drive, channel="attitude", motions=("turntable", "tumbling")),
}
"""The causes by their names; of those in a sensor the chance of one axis only. A table with a belt holds no diver.

A scalar that is noisier than 100 nT has lost its line.
"""
