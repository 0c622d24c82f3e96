"""A tenth set of causes outside the library: what batteries, feeders, pipes, radars, radios, seals and storms do."""

import numpy as np
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
from tam_validation.blind.outside import followed, in_a_sensor, outside
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of

_RAILWAY_HZ = 16.7
"""Frequency of the railways' current in the middle of Europe."""


def railway_feeder(rng: Generator, scene: Scene) -> Disturbance:
    """Turn the array over a railway's feeder: its 16.7 Hz, sampled too seldom, look like a slow swing of the field."""
    heading, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(-0.7, 0.7)
    along, side = np.array([np.cos(heading), np.sin(heading), 0]), np.array([-np.sin(heading), np.cos(heading), 0])
    feeder_m = rng.uniform(1, 3) * (np.sin(tilt) * side - [0, 0, np.cos(tilt)])
    return_m = feeder_m + rng.uniform(0.2, 0.6) * side
    at_m = np.einsum("nij,kj->nki", scene.to_world, np.vstack([scene.positions_m, np.zeros(3)]))
    field = _straight_wire(along, at_m - feeder_m) - _straight_wire(along, at_m - return_m)
    trains = 1 + 0.3 * np.tanh(draw_wander(rng, scene.duration_s, 8)(scene.time_s))
    slip = rng.uniform(0, 0.5) * draw_wander(rng, scene.duration_s, 6)(scene.time_s)
    swing = trains * np.sin(2 * np.pi * _RAILWAY_HZ * scene.time_s + slip + rng.uniform(0, 2 * np.pi))
    extra = np.einsum("n,nji,nkj->nki", swing, scene.to_world, field)
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("railway_feeder", (ALL,), (), change, "nT", {"tilt_rad": tilt})


def _straight_wire(along: FloatArray, away_m: FloatArray) -> FloatArray:
    """Return the field (…, 3) of one ampere in a long wire, at distances (…, 3) from it."""
    across = np.cross(along, away_m)
    return np.asarray(2e-7 * across / (across**2).sum(axis=-1, keepdims=True))


def thermal_shunt(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Mount an alloy of nickel near a sensor: the warmer it is, the less the Earth's field magnetises it, then none."""
    magnetic = np.maximum(rng.uniform(0.8, 3) - followed(rng, scene, scene.temperature), 0)
    moment, toward = magnetic[:, None] * scene.field_T / scene.intensity_T.mean(), draw_direction(rng)
    return np.asarray((3 * np.outer(moment @ toward, toward) - moment) @ scene.response[sensor].T)


def pulled_oscillator(rng: Generator, scene: Scene) -> Disturbance:
    """Read an axis by the frequency of an oscillator: near a harmonic of some clock it is pulled there, and sticks.

    Source: Adler, A study of locking phenomena in oscillators, Proc. IRE 34, 1946, p. 351.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 1.0)
    reading_T = scene.readings_T[:, sensor]
    apart_T = np.ptp(reading_T, axis=0) / rng.uniform(2, 6, 3)
    turns = reading_T / apart_T + rng.uniform(0, 1, 3)
    free_T = apart_T * (turns - np.round(turns))

    def change(amplitude: float, _seen: object) -> Signal:
        pulled_T = np.sign(free_T) * np.sqrt(np.maximum(free_T**2 - amplitude**2, 0))
        return of_sensors(scene, {sensor: mask * (pulled_T - free_T)})

    return Disturbance("pulled_oscillator", (sensor + 1,), named(mask), change, "T of half a lock", {})


def lost_reference(rng: Generator, scene: Scene) -> Disturbance:
    """Let the counter of a scalar take its seconds from satellites, and in a dive from a crystal that runs wrong."""
    dives = int(rng.integers(3, 8))
    surfaces = np.sort(rng.uniform(0, 1, 2 * dives)) * scene.duration_s
    below = np.searchsorted(surfaces, scene.time_s) % 2
    error = rng.choice([-1e-9, 1e-9]) * below * scene.intensity_T / scene.intensity_T.mean()
    return Disturbance("lost_reference", (SCALAR,), (), proportional(of_scalar(scene, error)), "nT", {"dives": dives})


def touching_screens(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let the screens of two cables touch now and then: they are a loop then, in which the turning drives a current."""
    area, short_s, touches = draw_direction(rng), scene.step_s / 50, int(rng.integers(4, 10))
    before, after = (scene.field_at(scene.time_s + by) @ area for by in (-short_s, short_s))
    closed = np.searchsorted(np.sort(rng.uniform(0, 1, 2 * touches)) * scene.duration_s, scene.time_s) % 2
    driven = closed * (before - after) / (after - before).std()
    return np.outer(driven, scene.response[sensor] @ (area + 0.5 * rng.normal(size=3)))


def adaptive_radio(rng: Generator, scene: Scene) -> Disturbance:
    """Send some readings by a radio that halves its rate where it is turned away: they are stamped late, on arrival."""
    sent, toward = draw_sensors(rng, scene), draw_direction(rng)
    faint = -np.einsum("nij,j,i->n", scene.to_world, draw_direction(rng), toward)
    halvings = np.searchsorted(np.sort(np.quantile(faint, rng.uniform(0.3, 0.9, int(rng.integers(1, 4))))), faint)
    late = 2.0**halvings - 1

    def change(amplitude: float, _seen: object) -> Signal:
        waited = scene.readings_at(scene.time_s - amplitude * late) - scene.readings_T
        return of_sensors(scene, {one: waited[:, one] for one in sent})

    return Disturbance("adaptive_radio", tuple(one + 1 for one in sent), (), change, "s at the full rate", {})


def ferrofluid_seal(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Seal a shaft near a sensor with too much magnetic fluid: it sinks to the lower side, late, with its iron."""
    lag_s, play = scene.step_s * rng.uniform(2, 15), rng.uniform(0.1, 0.3)
    fine_s = np.arange(-5 * lag_s, scene.duration_s + scene.step_s, scene.step_s)
    sunk = [low_pass(one, lag_s, fine_s) for one in -scene.motion.to_world(fine_s)[:, 2].T]
    lowest = np.stack([np.interp(scene.time_s, fine_s, one) for one in sunk], axis=1)
    away, moment = draw_direction(rng) - play * lowest, scene.field_T / scene.intensity_T.mean()
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    toward = away / distance
    field = (3 * (moment * toward).sum(axis=1, keepdims=True) * toward - moment) / distance**3
    return np.asarray(field @ scene.response[sensor].T)


def sweeping_radar(rng: Generator, scene: Scene) -> Disturbance:
    """Work near a ship's radar: each time that its beam sweeps by, the inputs of some sensors are noisy for a while."""
    reached, turn_s = draw_sensors(rng, scene), scene.step_s * rng.uniform(8, 40)
    off = 2 * np.pi * scene.time_s / turn_s + rng.uniform(0, 2 * np.pi)
    beam = 1e-9 * np.exp(rng.uniform(2, 8) * (np.cos(off) - 1))[:, None]
    rows: dict[int, FloatArray] = {one: beam * rng.normal(size=(scene.sample_count, 3)) for one in reached}
    change = proportional(of_sensors(scene, rows))
    return Disturbance(
        "sweeping_radar", tuple(one + 1 for one in reached), (), change, "nT in the beam", {"turn_s": turn_s}
    )


def lightning_strokes(rng: Generator, scene: Scene) -> Disturbance:
    """Let a thunderstorm go by: its strokes shake the spins that a scalar counts, the more the nearer it is."""
    flashes = max(4, int(scene.sample_count * 10 ** rng.uniform(-2.5, -1.7)))
    strokes_s = np.repeat(rng.uniform(0, scene.duration_s, flashes), rng.geometric(0.4, flashes))
    strokes_s += rng.exponential(0.1, len(strokes_s))  # the strokes of a flash go down one channel, soon one by one
    distance = 1 + ((strokes_s / scene.duration_s - rng.uniform(0.2, 0.8)) / rng.uniform(0.2, 0.6)) ** 2
    error, counted = np.zeros(scene.sample_count), np.searchsorted(scene.time_s, strokes_s)
    np.add.at(error, np.minimum(counted, scene.sample_count - 1), 1e-9 * rng.normal(size=len(strokes_s)) / distance)
    change = proportional(of_scalar(scene, error))
    return Disturbance("lightning_strokes", (SCALAR,), (), change, "nT", {"flashes": flashes})


def steel_pipe(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Lead a load's cable through a steel pipe near a sensor, which keeps a part of what each surge magnetised."""
    load = scene.current(scene.time_s)
    kept = sum(_dragged(load / np.ptp(load), play) for play in rng.uniform(0.05, 0.35, 3))
    return np.outer(kept, draw_direction(rng))


def _dragged(course: FloatArray, play: float) -> FloatArray:
    """Return what a course (n,) drags along with some play: walls of domains that friction keeps where they are."""
    now, path = 0.0, []
    for value in course.tolist():
        now = min(max(now, value - play), value + play)
        path.append(now)
    return np.array(path)


def wetted_metals(rng: Generator, scene: Scene) -> Disturbance:
    """Dip a frame of two metals into the sea: the current between them falls as it uses up the oxygen that is near.

    Source: Cottrell, Der Reststrom bei galvanischer Polarisation, betrachtet als ein Diffusionsproblem, Z. Phys. Chem.
    42, 1903, p. 385.
    """
    current = (scene.time_s / scene.duration_s + 10 ** rng.uniform(-1.5, -0.5)) ** -0.5
    distance_m = float(np.abs(scene.positions_m).max()) * rng.uniform(3, 9)
    away_m = np.vstack([scene.positions_m, np.zeros(3)]) - distance_m * draw_direction(rng)
    extra = current[:, None, None] * dipole(draw_direction(rng), away_m)
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("wetted_metals", (ALL,), (), change, "nT", {"distance_m": distance_m})


def changed_battery(rng: Generator, scene: Scene) -> Disturbance:
    """Feed some bridges from a battery without a regulator, and change it: all they read goes with its voltage."""
    fed, share, changes = draw_sensors(rng, scene), scene.time_s / scene.duration_s, int(rng.integers(1, 3))
    starts = np.append(0.0, np.sort(rng.uniform(0.2, 0.8, changes)))
    battery = np.searchsorted(starts[1:], share)
    fresh = np.cumsum(rng.choice([-1.0, 1.0], changes + 1) * rng.uniform(0.6, 1.4, changes + 1))
    voltage = fresh[battery] - rng.uniform(0, 0.4) * (share - starts[battery])
    readings = 1e-9 * voltage[:, None, None] * scene.readings_T / scene.intensity_T.mean()
    change = proportional(of_sensors(scene, {one: readings[:, one] for one in fed}))
    return Disturbance("changed_battery", tuple(one + 1 for one in fed), (), change, "nT", {"changes": changes})


TENTH = {
    "railway_feeder": outside(railway_feeder, channel="attitude", named="periodic_interference"),
    "thermal_shunt": in_a_sensor(thermal_shunt, channel="temperature", named="temperature_drift"),
    "pulled_oscillator": outside(pulled_oscillator, named="nonlinearity"),
    "lost_reference": outside(lost_reference, scalar_needed=True, most_nT=6.0),
    "touching_screens": in_a_sensor(touching_screens, motions=MOVING, named="eddy_current"),
    "adaptive_radio": outside(adaptive_radio, motions=MOVING, channel="attitude"),
    "ferrofluid_seal": in_a_sensor(ferrofluid_seal),
    "sweeping_radar": outside(sweeping_radar, named="noise_excess"),
    "lightning_strokes": outside(lightning_strokes, scalar_needed=True, most_nT=1000.0, named="outliers"),
    "steel_pipe": in_a_sensor(steel_pipe, channel="current", named="current_interference"),
    "wetted_metals": outside(wetted_metals),
    "changed_battery": outside(changed_battery, named="scale_step"),
}
"""The causes by their names. A cheap crystal is wrong by a ten-thousandth, which is 6 nT in the strongest field."""
