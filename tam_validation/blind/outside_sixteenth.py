"""A sixteenth set of causes outside the library: what anodes, ballast, beats, bytes, loops, ribbons and valves do."""

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
"""Steps of a battery's voltage."""

_PULL_IN_S = 0.05
"""Time for which a driver pulls a plunger in, before it holds it by less current [s]."""

_PARTS = 8
"""Steps of a feedback within one of the recording."""

_LEAST_SIGNAL = 0.05
"""Least share of the best signal of precession: a coil is wide, so that its field is not along one line all over."""


def beating_exciters(rng: Generator, scene: Scene) -> Disturbance:
    """Excite two fluxgates by oscillators of nearly one frequency: each picks up the beat between them.

    They pull at each other, so that the beat is slow near agreement and quick elsewhere (Adler 1946).
    """
    pair = np.sort(rng.choice(scene.sensor_count, 2, replace=False)).tolist()
    cycles, pull = rng.uniform(0.02, 0.3), rng.uniform(0, 0.7)
    warming = rng.uniform(0, 0.8) * draw_wander(rng, scene.duration_s, 6)(scene.time_s)
    half = np.pi * cycles * scene.time_s / scene.step_s + warming / 2
    between = 2 * np.arctan2(pull * np.cos(half) + np.sqrt(1 - pull**2) * np.sin(half), np.cos(half))
    rows: dict[int, FloatArray] = {}
    for one, ahead in zip(pair, (1, -1), strict=True):
        phase = ahead * between[:, None] + rng.uniform(0, 2 * np.pi, 3)
        rows[one] = 1e-9 * rng.uniform(0.3, 1.5, 3) * np.sin(phase)
    change = proportional(of_sensors(scene, rows))
    parameters = {"beat_s": scene.step_s / cycles, "pull": pull}
    return Disturbance("beating_exciters", tuple(one + 1 for one in pair), (), change, "nT", parameters)


def valve_solenoid(rng: Generator, scene: Scene) -> Disturbance:
    """Trim a buoyancy engine by a valve near some sensors: while it is open, its solenoid carries a current.

    A driver pulls the plunger in by a larger current than it holds it by; the plunger keeps a little magnetisation.
    """
    near, openings = draw_sensors(rng, scene), int(rng.integers(4, 10))
    edges = np.cumsum(rng.uniform(0.3, 1.7, 2 * openings + 1))
    edges_s = edges[:-1] / edges[-1] * scene.duration_s
    last = np.searchsorted(edges_s, scene.time_s, side="right")
    since_s = scene.time_s - np.append(-np.inf, edges_s)[last]
    held = np.where(since_s < _PULL_IN_S, rng.uniform(1.5, 3), 1)
    course = np.where(last % 2 == 1, held, rng.uniform(0, 0.1) * (last > 0))
    rows: dict[int, FloatArray] = {
        one: 1e-9 * rng.uniform(0.5, 1.5) * np.outer(course, scene.response[one] @ draw_direction(rng)) for one in near
    }
    change = proportional(of_sensors(scene, rows))
    return Disturbance("valve_solenoid", tuple(one + 1 for one in near), (), change, "nT", {"openings": openings})


def dropped_ballast(rng: Generator, scene: Scene) -> Disturbance:
    """Drop one or two weights of steel from below the vehicle: their field is there until then, and sinks with them.

    The Earth's field magnetises a weight, which is long, and some magnetisation stays in it from the crane's magnet.
    """
    arm_m = float(np.abs(scene.positions_m).max())
    places_m = np.vstack([scene.positions_m, np.zeros(3)])
    drops_s: list[float] = []
    extra = np.zeros((scene.sample_count, len(places_m), 3))
    for _ in range(int(rng.integers(1, 3))):
        along, below = draw_direction(rng), np.array([*rng.uniform(-0.4, 0.4, 2), -1.0])
        rack_m = (arm_m + rng.uniform(0.4, 0.8)) * below / norm(below)
        drop_s = _time_to_drop(rng, scene, rack_m)
        drops_s.append(drop_s)
        # Until the drop the weight turns with the array, afterwards it keeps its attitude.
        turned = scene.motion.to_world(np.minimum(scene.time_s, drop_s))
        field = np.einsum("nij,nik,nk->nj", turned, scene.to_world, scene.field_T) / scene.intensity_T.mean()
        moment = 0.3 * field + 0.7 * np.outer(field @ along, along) + rng.uniform(0.5, 1.5) * draw_direction(rng)
        sunk_m = rng.uniform(0.7, 1.5) * np.maximum(scene.time_s - drop_s, 0)
        weight_m = turned @ rack_m - np.outer(sunk_m, [0, 0, 1])
        away_m = np.einsum("nij,pj->npi", scene.to_world, places_m) - weight_m[:, None]
        each = np.stack([dipole(one, away_m) for one in np.eye(3)])
        world = np.einsum("nm,mnpi->npi", np.einsum("nij,nj->ni", turned, moment), each)
        extra += np.einsum("nji,npj->npi", scene.to_world, world)
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("dropped_ballast", (ALL,), (), change, "nT", {"drops_s": sorted(drops_s)})


def _time_to_drop(rng: Generator, scene: Scene, rack_m: FloatArray) -> float:
    """Draw a time, well inside the recording, at which a rack is as low as it comes: a weight falls clear of all."""
    inside_s = scene.time_s[np.abs(scene.time_s / scene.duration_s - 0.5) < 0.35]
    height_m = scene.motion.to_world(inside_s)[:, 2] @ rack_m
    return float(rng.choice(inside_s[height_m <= np.quantile(height_m, 0.25)]))


def drooping_reference(rng: Generator, scene: Scene) -> Disturbance:
    """Convert some sensors by a reference that droops with the battery's voltage: readings grow with the load.

    The voltage falls at once by the battery's resistance, and late by what its plates cannot deliver.
    """
    converted, fine_s = draw_sensors(rng, scene), np.linspace(0, scene.duration_s, _FINE)
    late_A = low_pass(scene.current(fine_s), scene.duration_s * 10 ** rng.uniform(-2.2, -1.2), fine_s)
    late, load_A = rng.uniform(0, 0.4), scene.current(scene.time_s)
    droop = ((1 - late) * load_A + late * np.interp(scene.time_s, fine_s, late_A)) / np.ptp(load_A)
    readings = scene.readings_T / scene.intensity_T.mean()
    rows: dict[int, FloatArray] = {one: 1e-9 * droop[:, None] * readings[:, one] for one in converted}
    change = proportional(of_sensors(scene, rows))
    return Disturbance("drooping_reference", tuple(one + 1 for one in converted), (), change, "nT", {})


def shedding_vortices(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Tow the array: vortices leave an arm by turns on its two sides and sway it, so that its sensor tilts to and fro.

    The arm's own frequency holds the vortices (lock-in), and the drag sways it at twice that frequency.
    """
    along = scene.positions_m[sensor] / norm(scene.positions_m[sensor])
    across = np.cross(along, draw_direction(rng))
    across /= norm(across)
    slip = rng.uniform(0, 0.5) * draw_wander(rng, scene.duration_s, 8)(scene.time_s)
    strength = 1 + 0.4 * np.tanh(draw_wander(rng, scene.duration_s, 8)(scene.time_s))
    angle = 2 * np.pi * rng.uniform(0.05, 0.45) * scene.time_s / scene.step_s + slip
    drag = rng.uniform(0.05, 0.3) * np.sin(2 * angle + rng.uniform(0, 2 * np.pi))
    tilt = strength[:, None] * (np.outer(np.sin(angle), across) + np.outer(drag, np.cross(along, across)))
    return np.asarray(np.cross(scene.field_T / scene.intensity_T.mean(), tilt) @ scene.response[sensor].T)


def swept_multiplexer(rng: Generator, scene: Scene) -> Disturbance:
    """Convert the axes of some sensors by one converter, one after another, and write down one time for all."""
    swept = draw_sensors(rng, scene)
    channels = 3 * len(swept)
    turns = rng.permutation(channels) if rng.random() < 0.3 else np.arange(channels)

    def change(amplitude: float, _seen: object) -> Signal:
        rows: dict[int, FloatArray] = {one: np.zeros((scene.sample_count, 3)) for one in swept}
        for channel, turn in enumerate(turns):
            one, axis = swept[channel // 3], channel % 3
            then = scene.readings_at(scene.time_s + turn * amplitude)
            rows[one][:, axis] = (then - scene.readings_T)[:, one, axis]
        return of_sensors(scene, rows)

    parameters = {"turns": turns.tolist()}
    return Disturbance(
        "swept_multiplexer", tuple(one + 1 for one in swept), (), change, "s from axis to axis", parameters
    )


def galvanic_washer(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Screw a sensor to its frame with a washer of zinc: in sea water it drives a current around the screw.

    The current falls as films grow on the zinc, and grows with the flow that brings oxygen to the steel.
    """
    wet_s = scene.time_s + rng.uniform(0.02, 0.3) * scene.duration_s  # since it came into the water
    first_s, second_s = scene.duration_s * 10 ** rng.uniform(-1.2, 0, 2)
    share = rng.uniform(0.2, 0.6)
    fallen = share * np.exp(-wet_s / first_s) + (1 - share) / np.sqrt(1 + wet_s / second_s)
    flow = 1 + 0.3 * np.tanh(draw_wander(rng, scene.duration_s, 7)(scene.time_s))
    return np.outer(fallen * flow, scene.response[sensor] @ draw_direction(rng))


def slewing_feedback(rng: Generator, scene: Scene) -> Disturbance:
    """Let a digital feedback follow the field by one step of its converter a cycle: in a quick turn it falls behind."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    before = 10 * _PARTS  # in which it finds the field
    fine_s = np.arange(-before, _PARTS * (scene.duration_s / scene.step_s + 1)) * scene.step_s / _PARTS
    field = scene.readings_at(fine_s)[:, sensor]
    quickest = np.abs(np.diff(field[before:], axis=0) * mask).max()

    def change(amplitude: float, _seen: object) -> Signal:
        most = quickest / (1 + amplitude)
        axes = [_slewed(one, most) - one if on else 0 * one for one, on in zip(field.T, mask, strict=True)]
        behind = np.stack([np.interp(scene.time_s, fine_s, one) for one in axes], axis=1)
        return of_sensors(scene, {sensor: behind})

    return Disturbance("slewing_feedback", (sensor + 1,), named(mask), change, "of the limit", {})


def _slewed(values: FloatArray, most: float) -> FloatArray:
    """Follow values (n,) by no more than so much from one to the next."""
    now, path = float(values[0]), []
    for value in values.tolist():
        now += min(max(value - now, -most), most)
        path.append(now)
    return np.array(path)


def crossover_distortion(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Drive a feedback's coil by two transistors of which neither conducts near zero: the reading has a kink there.

    The loop has no integrator, so that a part of the voltage by which a transistor opens remains, with the current's
    sign.
    """
    current = scene.readings_T[:, sensor] / scene.intensity_T.mean() + rng.uniform(-0.03, 0.03, 3)
    return np.asarray(-rng.uniform(0.7, 1.3, 3) * np.tanh(current / rng.uniform(0.01, 0.1, 3)))


def ribbon_at_cell(rng: Generator, scene: Scene) -> Disturbance:
    """Leave a ribbon of amorphous metal in the scalar's housing, as of a tag against theft: it errs with its field.

    So soft and thin a ribbon is magnetised lengthwise, and a part of the Earth's field saturates it. What a body adds
    that does not saturate could not be told from the sensors' own matrices. The sensors are some ten times as far away
    as the cell: a thousandth of the field reaches them, and is left out.
    """
    along, saturating = draw_direction(rng), rng.uniform(0.1, 0.5)  # of the Earth's field
    magnetised = np.tanh(scene.field_T @ along / scene.intensity_T.mean() / saturating)
    at_cell = dipole(along, draw_direction(rng))
    extra_T = 1e-9 * np.outer(magnetised, at_cell / norm(at_cell))

    def change(amplitude: float, _seen: object) -> Signal:
        return of_scalar(scene, norm(scene.field_T + amplitude * extra_T, axis=1) - scene.intensity_T)

    return Disturbance("ribbon_at_cell", (SCALAR,), (), change, "nT at the cell", {"saturating": saturating})


def torn_bytes(rng: Generator, scene: Scene) -> Disturbance:
    """Read a word in two bytes while the sensor renews it: the upper byte is new, the lower one of the word before.

    That errs by about a full lower byte where the upper one has just changed, and else by what the lower one changed.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    age_s = scene.step_s * rng.uniform(0.1, 1)  # of the word before
    torn = rng.random((scene.sample_count, 3)) < 10 ** rng.uniform(-1.7, -1)
    since = (scene.readings_at(scene.time_s - age_s) - scene.readings_T)[:, sensor]
    since += scene.vector_noise_T * rng.normal(size=since.shape)

    def change(amplitude: float, seen: Signal) -> Signal:
        new = seen[0][:, sensor]
        old = scene.readings_T[:, sensor] + since
        return of_sensors(scene, {sensor: mask * torn * (np.mod(old, amplitude) - np.mod(new, amplitude))})

    return Disturbance(
        "torn_bytes", (sensor + 1,), named(mask), change, "T of the lower byte", {"age_s": age_s}, after_noise=True
    )


def weak_precession(rng: Generator, scene: Scene) -> Disturbance:
    """Count the precession of protons in one coil: the noise goes with the inverse of the signal.

    The coil polarises the protons and hears them too, both by the sine of its angle to the field: the signal goes with
    the square.
    """
    signal = np.maximum(1 - (scene.field_T @ draw_direction(rng) / scene.intensity_T) ** 2, _LEAST_SIGNAL)
    noise = rng.normal(size=scene.sample_count) * np.sqrt(signal**-2 - 1)
    change = proportional(of_scalar(scene, 1e-9 * noise))
    return Disturbance("weak_precession", (SCALAR,), (), change, "nT at full signal", {})


SIXTEENTH = {
    "beating_exciters": outside(beating_exciters, named="periodic_interference"),
    "valve_solenoid": outside(valve_solenoid, named="bias_jump"),
    "dropped_ballast": outside(dropped_ballast, motions=MOVING),
    "drooping_reference": outside(drooping_reference, channel="current"),
    "shedding_vortices": in_a_sensor(shedding_vortices, motions=MOVING),
    "swept_multiplexer": outside(swept_multiplexer, motions=MOVING, named="time_skew"),
    "galvanic_washer": in_a_sensor(galvanic_washer, motions=MOVING),
    "slewing_feedback": outside(slewing_feedback, motions=MOVING),
    "crossover_distortion": in_a_sensor(crossover_distortion, 0.5, named="nonlinearity"),
    "ribbon_at_cell": outside(ribbon_at_cell, scalar_needed=True, named="scalar_heading_error"),
    "torn_bytes": outside(torn_bytes, named="outliers"),
    "weak_precession": outside(weak_precession, scalar_needed=True, most_nT=100.0, named="noise_excess"),
}
"""The causes by their names; of those in a sensor the chance of one axis only.

A table stands on land, without ballast, flow or sea water. A counter that errs by more than 100 nT has lost its signal.
"""
