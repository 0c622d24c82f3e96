"""A seventh set of causes outside the library: what boats, cells, drums, oscillators, rings, scans and screens do."""

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
    draw_direction,
    draw_sensor,
    draw_sensors,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_validation.blind.material import low_pass
from tam_validation.blind.outside import in_a_sensor, outside, read_late
from tam_validation.blind.processes import TimeFunction, draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of

_FINE = 2000
"""Steps of the heat and of the charge."""


def winch_drum(rng: Generator, scene: Scene) -> Disturbance:
    """Mount a winch beside the array: its magnetised drum turns while it pays out or hauls in, and stops anywhere."""
    runs = int(rng.integers(3, 8))
    turns = rng.choice([-1.0, 1.0], runs) * rng.uniform(2, 10, runs)
    reached = np.repeat(np.cumsum(np.append(0.0, turns)), 2)[1:-1]
    angle = 2 * np.pi * np.interp(scene.time_s / scene.duration_s, np.sort(rng.uniform(0, 1, 2 * runs)), reached)
    axle = draw_direction(rng)
    across = np.cross(axle, draw_direction(rng))
    across /= norm(across)
    moment = np.outer(np.cos(angle), across) + np.outer(np.sin(angle), np.cross(axle, across))
    place_m = float(np.abs(scene.positions_m).max()) * rng.uniform(4, 10) * draw_direction(rng)
    away_m = np.vstack([scene.positions_m, np.zeros(3)]) - place_m
    extra = np.einsum("nm,mpi->npi", moment, np.stack([dipole(one, away_m) for one in np.eye(3)]))
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("winch_drum", (ALL,), (), change, "nT", {"runs": runs, "distance_m": float(norm(place_m))})


def beating_excitations(rng: Generator, scene: Scene) -> Disturbance:
    """Excite two neighbouring fluxgates from oscillators of their own: each picks up the other, at the difference."""
    first = draw_sensor(rng, scene)
    apart_m = norm(scene.positions_m - scene.positions_m[first], axis=1)
    both = sorted((first, int(np.argsort(apart_m)[1])))
    slip = rng.uniform(0.3, 1.5) * draw_wander(rng, scene.duration_s, 6)(scene.time_s)
    beat = 2 * np.pi * rng.uniform(0.04, 0.4) * scene.time_s / scene.step_s + slip
    rows: dict[int, FloatArray] = {}
    for one in both:
        heard = rng.uniform(0.6, 1.4) * np.sin(beat + rng.uniform(0, 2 * np.pi))
        rows[one] = 1e-9 * np.outer(heard, draw_direction(rng))
    change = proportional(of_sensors(scene, rows))
    return Disturbance("beating_excitations", tuple(one + 1 for one in both), (), change, "nT", {})


def cold_cell(rng: Generator, scene: Scene) -> Disturbance:
    """Heat the cell of a pumped scalar too little: in the cold its vapour is thin, and the scalar is noisy.

    Source: Taylor and Langmuir, The evaporation of atoms, ions and electrons from caesium films on tungsten, Phys. Rev.
    51, 1937, p. 753, for the vapour, of which 4 to 8 °C halve the density.
    """
    lag_s = scene.duration_s * 10 ** rng.uniform(-2.5, -1.5)
    fine_s = np.linspace(-5 * lag_s, scene.duration_s, _FINE)
    cell_C = np.interp(scene.time_s, fine_s, low_pass(scene.temperature(fine_s), lag_s, fine_s))
    loud = 2 ** ((cell_C.min() - cell_C) / rng.uniform(4, 8))
    noise = 1e-9 * loud * rng.normal(size=scene.sample_count)
    return Disturbance("cold_cell", (SCALAR,), (), proportional(of_scalar(scene, noise)), "nT in the cold", {})


def charged_cells(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Put lithium cells beside a sensor: how far the Earth's field magnetises their cathodes goes with their charge."""
    fine_s = np.linspace(0, scene.duration_s, _FINE)
    charge = np.interp(scene.time_s, fine_s, -np.cumsum(scene.current(fine_s)))
    course = (charge - charge.mean()) / charge.std()
    field, toward = scene.field_T / scene.intensity_T.mean(), draw_direction(rng)
    magnetised = (3 * np.outer(field @ toward, toward) - field) @ scene.response[sensor].T
    return np.asarray(rng.choice([-1.0, 1.0]) * course[:, None] * magnetised)


def worn_slip_ring(rng: Generator, scene: Scene) -> Disturbance:
    """Feed bridges through a slip ring that is worn at some angles: there their supply, and all they read, is less."""
    fed, patches = draw_sensors(rng, scene), int(rng.integers(2, 5))
    off = scene.motion.angles(scene.time_s)[:, :1] - rng.uniform(0, 2 * np.pi, patches)
    worn = np.exp(rng.uniform(5, 30, patches) * (np.cos(off) - 1)) @ rng.uniform(0.5, 1.5, patches)
    readings = -1e-9 * worn[:, None, None] * scene.readings_T / scene.intensity_T.mean()
    change = proportional(of_sensors(scene, {one: readings[:, one] for one in fed}))
    return Disturbance("worn_slip_ring", tuple(one + 1 for one in fed), (), change, "nT", {"patches": patches})


def scanning_multiplexer(rng: Generator, scene: Scene) -> Disturbance:
    """Let one converter scan all axes of all sensors, one after another, and stamp the scan with one time."""
    turns = np.arange(3 * scene.sensor_count).reshape(-1, 3)
    late = (turns if rng.random() < 0.5 else turns[:, ::-1]) - rng.choice([0.0, turns.mean(), turns.max()])

    def change(amplitude: float, _seen: object) -> Signal:
        vectors = np.zeros_like(scene.readings_T)
        for (sensor, axis), turn in np.ndenumerate(late):
            read = scene.readings_at(scene.time_s + amplitude * turn)[:, sensor, axis]
            vectors[:, sensor, axis] = read - scene.readings_T[:, sensor, axis]
        return vectors, np.zeros(scene.sample_count)

    return Disturbance("scanning_multiplexer", (ALL,), (), change, "s for each axis", {})


def warm_oscillator(rng: Generator, scene: Scene) -> Disturbance:
    """Time a sensor's digital filter by a resistor and a capacitor: its delay goes with heat, about a known mean."""
    late = rng.choice([-1.0, 1.0]) * followed(rng, scene, scene.temperature)
    return read_late(scene, "warm_oscillator", draw_sensor(rng, scene), late)


def followed(rng: Generator, scene: Scene, heating: TimeFunction) -> FloatArray:
    """Return how warm (N,) matter is that follows a heating late, of mean zero and standard deviation one."""
    lag_s = scene.duration_s * 10 ** rng.uniform(-2.0, -1.2)
    fine_s = np.linspace(-5 * lag_s, scene.duration_s, _FINE)
    warm = np.interp(scene.time_s, fine_s, low_pass(heating(fine_s), lag_s, fine_s))
    return np.asarray((warm - warm.mean()) / warm.std())


def wrong_bit_weight(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let a converter's capacitor for one of its higher bits have the wrong size: readings with that bit are off."""
    reading_T = scene.readings_T[:, sensor]
    full_T = np.abs(reading_T).max() * rng.uniform(1.05, 1.6)
    levels = 2 ** int(rng.integers(3, 7))
    return np.asarray(rng.choice([-1.0, 1.0]) * (np.floor((reading_T / full_T + 1) / 2 * levels) % 2))


def short_headroom(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let an output come near its supply: a load draws that down, and the more, the flatter the top is."""
    end, load_A = rng.choice([-1.0, 1.0], 3), scene.current(scene.time_s)
    driven_T = end * scene.readings_T[:, sensor]
    beyond_T = np.maximum(driven_T - np.quantile(driven_T, rng.uniform(0.55, 0.85), axis=0), 0)
    flat = beyond_T / scene.intensity_T.mean() * rng.uniform(0.6, 1.4, 3)
    return np.asarray(-end * (load_A / load_A.max())[:, None] * flat)


def passing_boat(rng: Generator, scene: Scene) -> Disturbance:
    """Let a boat with an engine of iron pass the place where the array is turned, to and fro."""
    near_m, heading = rng.uniform(1.5, 5), rng.uniform(0, 2 * np.pi)
    run = 2 * np.pi * rng.uniform(1, 2.5) * scene.time_s / scene.duration_s + rng.uniform(0, 2 * np.pi)
    along_m = near_m * rng.uniform(4, 10) * np.sin(run)
    track, side = [np.cos(heading), np.sin(heading), 0], [-np.sin(heading), np.cos(heading)]
    engine_m = np.outer(along_m, track) + near_m * np.append(side, rng.uniform(-0.5, 0.5))
    at_m = np.einsum("nij,kj->nki", scene.to_world, np.vstack([scene.positions_m, np.zeros(3)]))
    field = dipole(draw_direction(rng), at_m - engine_m[:, None])
    extra = np.einsum("nji,nkj->nki", scene.to_world, field)
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("passing_boat", (ALL,), (), change, "nT", {"nearest_m": near_m})


def broken_screen(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Let the screen of a sensor's cable break: from then on its wires pick up what converters and radios emit."""
    after = scene.time_s > rng.uniform(0.25, 0.75) * scene.duration_s
    return np.asarray(after[:, None] * rng.uniform(0.6, 1.4, 3) * rng.normal(size=(scene.sample_count, 3)))


def flipped_bit(rng: Generator, scene: Scene) -> Disturbance:
    """Send a sensor's words over a radio link without a checksum: now and then one bit arrives as the other."""
    sensor, bits = draw_sensor(rng, scene), rng.integers(0, 8, (scene.sample_count, 3))
    struck = rng.random((scene.sample_count, 1)) < 10 ** rng.uniform(-2.2, -1.3)
    struck = struck & (rng.integers(0, 3, (scene.sample_count, 1)) == np.arange(3))

    def change(amplitude: float, seen: Signal) -> Signal:
        worth = amplitude * 2.0**bits
        was_set = np.floor(seen[0][:, sensor] / worth) % 2
        return of_sensors(scene, {sensor: struck * worth * (1 - 2 * was_set)})

    return Disturbance("flipped_bit", (sensor + 1,), (), change, "T of the lowest bit", {}, after_noise=True)


SEVENTH = {
    "winch_drum": outside(winch_drum),
    "beating_excitations": outside(beating_excitations, named="periodic_interference"),
    "cold_cell": outside(cold_cell, channel="temperature", scalar_needed=True, named="noise_excess"),
    "charged_cells": in_a_sensor(charged_cells, channel="current"),
    "worn_slip_ring": outside(worn_slip_ring),
    "scanning_multiplexer": outside(scanning_multiplexer, motions=MOVING, named="time_skew"),
    "warm_oscillator": outside(warm_oscillator, motions=MOVING, channel="temperature"),
    "wrong_bit_weight": in_a_sensor(wrong_bit_weight, 1.0, named="nonlinearity"),
    "short_headroom": in_a_sensor(short_headroom, 0.6, channel="current"),
    "passing_boat": outside(passing_boat, channel="attitude"),
    "broken_screen": in_a_sensor(broken_screen, named="noise_excess"),
    "flipped_bit": outside(flipped_bit, named="outliers"),
}
"""The causes by their names; of those in a sensor the chance that it is one axis only."""
