"""An eighth set of causes outside the library: what chokes, coils, detectors, radios, restarts and thrusters do."""

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
from tam_validation.blind.outside import in_a_sensor, outside, turning_rate
from tam_validation.blind.outside_seventh import followed
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of


def throttled_processor(rng: Generator, scene: Scene) -> Disturbance:
    """Let a processor that stamps some sensors' readings slow down by steps when it is hot: they wait for it."""
    served, warm = draw_sensors(rng, scene), followed(rng, scene, scene.temperature)
    late_s = np.searchsorted(np.sort(np.quantile(warm, rng.uniform(0.3, 0.9, int(rng.integers(1, 4))))), warm)

    def change(amplitude: float, _seen: object) -> Signal:
        waited = scene.readings_at(scene.time_s - amplitude * late_s) - scene.readings_T
        return of_sensors(scene, {one: waited[:, one] for one in served})

    return Disturbance("throttled_processor", tuple(one + 1 for one in served), (), change, "s for each step", {})


def biased_choke(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Put a ring choke beside a sensor: the Earth's field magnetises it less, the more the load saturates its core."""
    load_A, knee = scene.current(scene.time_s), rng.uniform(0.3, 1.0)
    soft = 1 / (1 + (load_A / load_A.max() / knee) ** 2)
    field, axle, toward = scene.field_T / scene.intensity_T.mean(), draw_direction(rng), draw_direction(rng)
    moment = soft[:, None] * (field - np.outer(field @ axle, axle))
    return np.asarray((3 * np.outer(moment @ toward, toward) - moment) @ scene.response[sensor].T)


def coiled_cable(rng: Generator, scene: Scene) -> Disturbance:
    """Leave the rest of a load's cable in a coil on the ground, beside the place where the array is turned."""
    load_A = scene.current(scene.time_s)
    return from_beside(rng, scene, "coiled_cable", load_A - load_A.min())


def from_beside(rng: Generator, scene: Scene, effect: str, size: FloatArray) -> Disturbance:
    """Return what a dipole of some size (N,) does that rests beside the place where the array is turned."""
    distance_m = rng.uniform(0.8, 3)
    at_m = np.einsum("nij,kj->nki", scene.to_world, np.vstack([scene.positions_m, np.zeros(3)]))
    field = dipole(draw_direction(rng), at_m - distance_m * draw_direction(rng))
    extra = np.einsum("n,nji,nkj->nki", size, scene.to_world, field)
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance(effect, (ALL,), (), change, "nT", {"distance_m": distance_m})


def thrusters(rng: Generator, scene: Scene) -> Disturbance:
    """Turn the array by three pairs of thrusters: the current of each goes with the water's drag about its axis."""
    rate = turning_rate(scene)
    drag = rate * np.abs(rate) / np.square(rate).mean()
    places_m = np.vstack([scene.positions_m, np.zeros(3)])
    extra = np.zeros((scene.sample_count, len(places_m), 3))
    for current in drag.T:
        away_m = places_m - np.abs(scene.positions_m).max() * rng.uniform(3, 8) * draw_direction(rng)
        extra += current[:, None, None] * dipole(draw_direction(rng), away_m)
    return Disturbance("thrusters", (ALL,), (), carried(scene, 1e-9 * extra / size_of(extra)), "nT", {})


def paired_cells(rng: Generator, scene: Scene) -> Disturbance:
    """Give a pumped scalar two cells at right angles and the signal of the stronger: each reads its own light shift."""
    first = draw_direction(rng)
    second = np.cross(first, draw_direction(rng))
    cosines = scene.field_T @ np.column_stack([first, second / norm(second)]) / scene.intensity_T[:, None]
    strong = np.abs(cosines) * np.sqrt(np.maximum(1 - cosines**2, 0))
    more = strong[:, 0] - strong[:, 1]
    more -= np.quantile(more, rng.uniform(0.25, 0.75))
    decided = np.where(np.abs(more) > rng.uniform(0.02, 0.1), np.arange(len(more)), 0)  # else it stays as it is
    shift = 0.5e-9 * np.sign(more[np.maximum.accumulate(decided)])
    return Disturbance("paired_cells", (SCALAR,), (), proportional(of_scalar(scene, shift)), "nT between cells", {})


def unequal_quadrature(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Read an axis by the phase of fringes whose two signals are unequal and not at right angles: it errs twice a turn.

    Source: Heydemann, Determination and correction of quadrature fringe measurement errors, Appl. Opt. 20, 1981,
    p. 3382.
    """
    reading_T = scene.readings_T[:, sensor]
    phase = 2 * np.pi * rng.uniform(2, 8, 3) * reading_T / np.ptp(reading_T, axis=0) + rng.uniform(0, 2 * np.pi, 3)
    return np.asarray(np.sin(2 * phase) + rng.uniform(0, 0.5, 3) * np.sin(phase + rng.uniform(0, 2 * np.pi, 3)))


def peak_detector(rng: Generator, scene: Scene) -> Disturbance:
    """Let a detector charge through a diode and discharge through a resistor: it follows one way at once, else late."""
    sensor, mask, way = draw_sensor(rng, scene), draw_axes(rng, 0.7), rng.choice([-1.0, 1.0], 3)

    def change(amplitude: float, _seen: object) -> Signal:
        before_T = scene.readings_at(scene.time_s - amplitude)[:, sensor]
        held_T = np.maximum(way * (before_T - scene.readings_T[:, sensor]), 0)
        return of_sensors(scene, {sensor: mask * way * held_T})

    return Disturbance("peak_detector", (sensor + 1,), named(mask), change, "s", {})


def lost_settings(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let a sensor restart without its stored matrix and offsets, until someone loads them again, if at all."""
    start_s = rng.uniform(0.2, 0.6) * scene.duration_s
    end_s = start_s + (rng.uniform(0.15, 0.35) if rng.random() < 0.4 else 1) * scene.duration_s
    without = (scene.time_s > start_s) & (scene.time_s < end_s)
    return without[:, None] * (scene.core(sensor) @ rng.normal(size=(3, 3)) + rng.normal(size=3) / 2)


def tired_regulator(rng: Generator, scene: Scene) -> Disturbance:
    """Let the battery of some sensors run down: nearing its end, their common regulator hunts ever louder."""
    fed, share = draw_sensors(rng, scene), scene.time_s / scene.duration_s
    loud = 1 / (1 + np.exp((rng.uniform(0.4, 0.8) - share) / rng.uniform(0.08, 0.2)))
    hunted = 1e-9 * loud * rng.normal(size=scene.sample_count)
    rows = {one: np.outer(hunted, rng.uniform(0.6, 1.4) * draw_direction(rng)) for one in fed}
    change = proportional(of_sensors(scene, rows))
    return Disturbance("tired_regulator", tuple(one + 1 for one in fed), (), change, "nT at the end", {})


def iron_propeller(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let a propeller with two blades of iron turn near a sensor: the Earth's field magnetises it along the blades."""
    slip = rng.uniform(0.1, 0.6) * draw_wander(rng, scene.duration_s, 6)(scene.time_s)
    angle = 2 * np.pi * rng.uniform(0.03, 0.2) * scene.time_s / scene.step_s + slip
    shaft, toward = draw_direction(rng), draw_direction(rng)
    across = np.cross(shaft, draw_direction(rng))
    across /= norm(across)
    blades = np.outer(np.cos(angle), across) + np.outer(np.sin(angle), np.cross(shaft, across))
    moment = (blades * scene.field_T).sum(axis=1, keepdims=True) * blades / scene.intensity_T.mean()
    return np.asarray((3 * np.outer(moment @ toward, toward) - moment) @ scene.response[sensor].T)


def keyed_radio(rng: Generator, scene: Scene) -> Disturbance:
    """Call by a radio in the hand, held otherwise each time: the inputs of some sensors rectify its waves."""
    reached, calls = draw_sensors(rng, scene), int(rng.integers(4, 9))
    keyed = np.searchsorted(np.sort(rng.uniform(0, 1, 2 * calls)) * scene.duration_s, scene.time_s)
    rows: dict[int, FloatArray] = {}
    for one in reached:
        pushes = rng.uniform(0.6, 1.4, (2 * calls + 1, 1)) * (draw_direction(rng) + 0.3 * rng.normal(size=3))
        pushes[::2] = 0
        rows[one] = 1e-9 * pushes[keyed]
    change = proportional(of_sensors(scene, rows))
    return Disturbance("keyed_radio", tuple(one + 1 for one in reached), (), change, "nT", {"calls": calls})


def early_interrupt(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let an interrupt start a conversion now and then before it has settled from the axis that was read before."""
    struck = rng.random((scene.sample_count, 3)) < 10 ** rng.uniform(-2.2, -1.5)
    left = struck * rng.uniform(0.3, 1, (scene.sample_count, 3))
    reading_T = scene.readings_T[:, sensor]
    return np.asarray(left * (np.roll(reading_T, 1, axis=1) - reading_T) / scene.intensity_T.mean())


EIGHTH = {
    "throttled_processor": outside(throttled_processor, motions=MOVING, channel="temperature"),
    "biased_choke": in_a_sensor(biased_choke, channel="current"),
    "coiled_cable": outside(coiled_cable, channel="attitude", named="current_interference"),
    "thrusters": outside(thrusters, motions=MOVING),
    "paired_cells": outside(paired_cells, scalar_needed=True, most_nT=100.0, named="scalar_heading_error"),
    "unequal_quadrature": in_a_sensor(unequal_quadrature, 1.0, named="nonlinearity"),
    "peak_detector": outside(peak_detector, motions=MOVING),
    "lost_settings": in_a_sensor(lost_settings, named="scale_step"),
    "tired_regulator": outside(tired_regulator, named="noise_excess"),
    "iron_propeller": in_a_sensor(iron_propeller),
    "keyed_radio": outside(keyed_radio),
    "early_interrupt": in_a_sensor(early_interrupt, 0.6, named="outliers"),
}
"""The causes by their names; of those in a sensor the chance that it is one axis only. The cells of a scalar differ by
some tens of nT at the most."""
