"""A thirteenth set of causes outside the library: what barges, breaths, cables, domains, generators and words do."""

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
    draw_sensor,
    draw_sensors,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_validation.blind.material import low_pass
from tam_validation.blind.outside import followed, in_a_sensor, outside, read_late
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of


def rising_barge(rng: Generator, scene: Scene) -> Disturbance:
    """Turn the array beside a lock that fills: a barge of steel rises in it, the slower the less water is missing."""
    near_m, heading, lift_m = rng.uniform(3, 6), rng.uniform(0, 2 * np.pi), rng.uniform(3, 6)
    opens, full = rng.uniform(0, 0.3), rng.uniform(0.7, 1.1)
    missing = 1 - np.clip((scene.time_s / scene.duration_s - opens) / (full - opens), 0, 1)
    barge_m = np.zeros((scene.sample_count, 3)) + near_m * np.array([np.cos(heading), np.sin(heading), 0])
    barge_m[:, 2] = -lift_m * (missing**2 - rng.uniform(0, 0.5))  # Torricelli: the flow goes with the root of the head
    at_m = np.einsum("nij,kj->nki", scene.to_world, np.vstack([scene.positions_m, np.zeros(3)]))
    extra = np.einsum("nji,nkj->nki", scene.to_world, dipole(draw_direction(rng), at_m - barge_m[:, None]))
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("rising_barge", (ALL,), (), change, "nT", {"distance_m": near_m, "lift_m": lift_m})


def breathing_diver(rng: Generator, scene: Scene) -> Disturbance:
    """Let a diver hold the frame: the steel bottle on the back comes nearer and goes away with each breath."""
    breath_s, chest_m = rng.uniform(3.5, 6), rng.uniform(0.01, 0.03)
    slip = rng.uniform(0, 1) * draw_wander(rng, scene.duration_s, 8)(scene.time_s)
    angle = 2 * np.pi * scene.time_s / breath_s + slip
    lift_m = chest_m * (np.sin(angle) + rng.uniform(0.1, 0.4) * np.sin(2 * angle + 1))  # in faster than out
    places_m = np.vstack([scene.positions_m, np.zeros(3)])
    toward, moment = draw_direction(rng), draw_direction(rng)
    rest_m = places_m - (float(np.abs(scene.positions_m).max()) + rng.uniform(0.4, 0.8)) * toward
    extra = dipole(moment, rest_m - lift_m[:, None, None] * toward) - dipole(moment, rest_m)
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("breathing_diver", (ALL,), (), change, "nT", {"breath_s": breath_s})


def detuned_pickup(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Tune the winding of a fluxgate by a capacitor: as it warms, the resonance moves away, and the gain falls."""
    detuning = (followed(rng, scene, scene.temperature)[:, None] - rng.uniform(-1, 1, 3)) / rng.uniform(0.7, 2, 3)
    return np.asarray(scene.core(sensor) / np.sqrt(1 + detuning**2))


def squeezed_potting(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Dive with cores in a soft potting: the pressure, which nobody recorded, strains them, and late: gains change."""
    dives, fine_s = int(rng.integers(2, 6)), np.linspace(0, scene.duration_s, 2000)
    corners_s = np.sort(rng.uniform(0, 1, 4 * dives)) * scene.duration_s  # leave, arrive, leave, arrive
    deep = np.outer(rng.uniform(0.5, 1, dives), [0, 1, 1, 0]).ravel()
    pressed = low_pass(np.interp(fine_s, corners_s, deep), scene.duration_s * 10 ** rng.uniform(-2.2, -1.4), fine_s)
    return np.interp(scene.time_s, fine_s, pressed)[:, None] * rng.normal(size=3) * scene.core(sensor)


def waterlogged_cable(rng: Generator, scene: Scene) -> Disturbance:
    """Let water diffuse into a sensor's cable: its capacity grows with the root of time, and with that its delay."""
    wetted = np.maximum(scene.time_s / scene.duration_s - rng.uniform(-0.1, 0.4), 0) ** 0.5
    return read_late(scene, "waterlogged_cable", draw_sensor(rng, scene), wetted)


def pickup_loop(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Lead wires of a bridge apart: the field that turns through their loop induces a voltage in what they carry."""
    area, short_s = draw_direction(rng), scene.step_s / 50
    before, after = (scene.field_at(scene.time_s + by) @ area for by in (-short_s, short_s))
    return np.outer((before - after) / (after - before).std(), rng.uniform(0.5, 1.5, 3) * rng.choice([-1, 1], 3))


def half_precision(rng: Generator, scene: Scene) -> Disturbance:
    """Send readings as short floating numbers: they are rounded, twice as coarsely from each power of two on."""
    sent, most_T = draw_sensors(rng, scene), np.abs(scene.readings_T).max() * rng.uniform(1, 2)

    def change(amplitude: float, seen: Signal) -> Signal:
        readings = seen[0][:, sent]
        octaves = np.maximum(np.floor(np.log2(np.maximum(np.abs(readings), 1e-15) / most_T)), -14)
        steps = amplitude * 2.0**octaves
        error = steps * np.round(readings / steps) - readings
        return of_sensors(scene, {one: error[:, place] for place, one in enumerate(sent)})

    sensors = tuple(one + 1 for one in sent)
    return Disturbance("half_precision", sensors, (), change, "T of the largest step", {}, after_noise=True)


def generator_hum(rng: Generator, scene: Scene) -> Disturbance:
    """Run a generator near: its hum is nearly a multiple of a scalar's rate, which has no filter as the vectors do."""
    swing_s = scene.step_s * rng.uniform(4, 40)
    governed = rng.uniform(0, 0.6) * draw_wander(rng, scene.duration_s, 8)(scene.time_s)
    load = 1 + 0.3 * np.tanh(draw_wander(rng, scene.duration_s, 6)(scene.time_s))
    hum = 1e-9 * load * np.sin(2 * np.pi * scene.time_s / swing_s + governed + rng.uniform(0, 2 * np.pi))
    return Disturbance("generator_hum", (SCALAR,), (), proportional(of_scalar(scene, hum)), "nT", {"swing_s": swing_s})


def reversed_polarisation(rng: Generator, scene: Scene) -> Disturbance:
    """Let a pumped scalar start again with light of the other hand: the shift along its beam changes its sign."""
    starts = int(rng.integers(1, 3))
    hand = (-1.0) ** np.searchsorted(np.sort(rng.uniform(0.2, 0.8, starts)) * scene.duration_s, scene.time_s)
    along = scene.field_T @ draw_direction(rng) / scene.intensity_T
    change = proportional(of_scalar(scene, 1e-9 * hand * along))
    return Disturbance("reversed_polarisation", (SCALAR,), (), change, "nT along its beam", {"starts": starts})


def barkhausen_jumps(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Excite cores too little: their domains jump by chance as the field changes, the more often the faster it does."""
    short_s = scene.step_s / 50
    after, before = (scene.readings_at(scene.time_s + by)[:, sensor] for by in (short_s, -short_s))
    jumps = np.abs(after - before) / np.abs(after - before).max(axis=0)
    return np.asarray(rng.normal(size=jumps.shape) * np.sqrt(jumps))


def tilt_switch(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Latch a relay beside a sensor by a tilt switch: one reading holds the pulse that sets it or sets it back."""
    tilt = scene.to_world[:, 2] @ draw_direction(rng)
    over = tilt > np.quantile(tilt, rng.uniform(0.2, 0.8))
    pulse = np.diff(over.astype(float), prepend=float(over[0])) * rng.uniform(0.5, 1.5, scene.sample_count)
    return np.outer(pulse, draw_direction(rng))


def saturated_screen(rng: Generator, scene: Scene) -> Disturbance:
    """Lead a load's cable through a screen of soft iron near some sensors: beyond a current it lets the field out."""
    near, load_A = draw_sensors(rng, scene), scene.current(scene.time_s)
    leaked = 1e-9 * np.maximum(load_A - np.quantile(load_A, rng.uniform(0.2, 0.7)), 0) / np.ptp(load_A)
    rows: dict[int, FloatArray] = {one: np.outer(leaked, draw_direction(rng)) for one in near}
    change = proportional(of_sensors(scene, rows))
    return Disturbance("saturated_screen", tuple(one + 1 for one in near), (), change, "nT", {})


THIRTEENTH = {
    "rising_barge": outside(rising_barge, channel="attitude", named="ambient_gradient"),
    "breathing_diver": outside(breathing_diver, named="periodic_interference"),
    "detuned_pickup": in_a_sensor(detuned_pickup, 0.6, channel="temperature", named="temperature_drift"),
    "squeezed_potting": in_a_sensor(squeezed_potting),
    "waterlogged_cable": outside(waterlogged_cable, motions=MOVING),
    "pickup_loop": in_a_sensor(pickup_loop, 0.5, motions=MOVING, named="eddy_current"),
    "half_precision": outside(half_precision, most_nT=200.0, named="quantization"),
    "generator_hum": outside(generator_hum, scalar_needed=True, named="periodic_interference"),
    "reversed_polarisation": outside(
        reversed_polarisation, scalar_needed=True, most_nT=100.0, named="scalar_heading_error"
    ),
    "barkhausen_jumps": in_a_sensor(barkhausen_jumps, 0.5, motions=MOVING, named="noise_excess"),
    "tilt_switch": in_a_sensor(tilt_switch, motions=MOVING, named="outliers"),
    "saturated_screen": outside(saturated_screen, channel="current", named="current_interference"),
}
"""The causes by their names; of those in a sensor the chance of one axis only.

Light shifts a line by tens of nT, and a word of 16 bits with eight for the digits is wrong by up to 128 nT.
"""
