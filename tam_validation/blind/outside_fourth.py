"""A fourth set of causes outside the library: what crystals, feedback, motors, packs, panels and tethers do."""

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
    named,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_validation.blind.material import low_pass
from tam_validation.blind.outside import in_a_sensor, outside, read_late
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(7)
"""Of the mean over a filter's window, from its begin at -1 to its end at 1."""

_TRIES = 50
"""Attempts to draw a sun that lights a panel for a part of the time."""


def free_running_clock(rng: Generator, scene: Scene) -> Disturbance:
    """Let a sensor's crystal run too fast or too slow, and warm up; it was set at the start, or set to fit the end."""
    share = scene.time_s / scene.duration_s
    late = share + rng.uniform(-0.4, 0.4) * share * (1 - share)
    late -= rng.choice([0.0, 1.0])
    return read_late(scene, "free_running_clock", draw_sensor(rng, scene), rng.choice([-1.0, 1.0]) * late)


def long_average(rng: Generator, scene: Scene) -> Disturbance:
    """Let a sensor average over a longer time than the others; the delay of that is corrected, the smoothing is not."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.2)

    def change(amplitude: float, _seen: object) -> Signal:
        half_s, averaged = np.sqrt(amplitude) / 2, np.zeros((scene.sample_count, 3))
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            averaged += weight / 2 * scene.readings_at(scene.time_s + node * half_s)[:, sensor]
        return of_sensors(scene, {sensor: mask * (averaged - scene.readings_T[:, sensor])})

    return Disturbance("long_average", (sensor + 1,), named(mask), change, "s2, of the window its square", {})


def bimetal_snap(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Let a bimetal switch near a sensor snap over when it is warm, and back when it is a little cooler."""
    air_C, first = scene.temperature(scene.time_s), rng.uniform(0.3, 0.6)
    cool_C, warm_C = np.quantile(air_C, [first, first + rng.uniform(0.05, 0.2)])
    decided = np.where((air_C < cool_C) | (air_C > warm_C), np.arange(scene.sample_count), 0)
    snapped = air_C[np.maximum.accumulate(decided)] > warm_C
    return np.outer(snapped, draw_direction(rng))


def rotor_magnet(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Let a motor's rotor, magnetised across its shaft, turn below a sensor; its governor hunts about the speed."""
    hunting = 10 ** rng.uniform(-4, -2.3) * np.tanh(draw_wander(rng, scene.duration_s, 12)(scene.time_s))
    steps = np.diff(scene.time_s, prepend=scene.time_s[0]) / scene.step_s
    angle = 2 * np.pi * np.cumsum((rng.uniform(0.1, 0.45) + hunting) * steps) + rng.uniform(0, 2 * np.pi)
    shaft, away = draw_direction(rng), draw_direction(rng)
    first = np.cross(shaft, draw_direction(rng))
    first /= norm(first)
    magnet = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), np.cross(shaft, first))
    return np.asarray(3 * np.outer(magnet @ away, away) - magnet)


def brush_noise(rng: Generator, scene: Scene) -> Disturbance:
    """Let a motor's brushes spark into the cable of a sensor or of two: the more the larger the recorded current."""
    load_A = scene.current(scene.time_s)
    sparks = rng.normal(size=scene.sample_count) * (load_A / load_A.max()) ** rng.uniform(0.7, 1.5)
    struck = np.sort(rng.choice(scene.sensor_count, int(rng.integers(1, 3)), replace=False)).tolist()
    couplings = [rng.uniform(0.8, 1.2) * draw_direction(rng) for _ in struck]
    rows: dict[int, FloatArray] = {
        sensor: 1e-9 * np.outer(sparks, one) for sensor, one in zip(struck, couplings, strict=True)
    }
    places = tuple(sensor + 1 for sensor in struck)
    return Disturbance("brush_noise", places, (), proportional(of_sensors(scene, rows)), "nT", {})


def solar_panel(rng: Generator, scene: Scene) -> Disturbance:
    """Carry a panel of solar cells near the array: its current follows the cosine of the sun's angle."""
    for _ in range(_TRIES):
        sun, panel = draw_direction(rng), draw_direction(rng)
        lit = np.maximum(np.einsum("nij,j,i->n", scene.to_world, panel, [*sun[:2], abs(sun[2])]), 0)
        if 0.2 < np.mean(lit > 0) < 0.9:
            break
    place_m = float(np.abs(scene.positions_m).max()) * rng.uniform(2.5, 7) * draw_direction(rng)
    loop = dipole(panel, np.vstack([scene.positions_m, np.zeros(3)]) - place_m)
    extra = lit[:, None, None] * loop
    parameters = {"distance_m": float(norm(place_m))}
    return Disturbance("solar_panel", (ALL,), (), carried(scene, 1e-9 * extra / size_of(extra)), "nT", parameters)


def bit_flips(rng: Generator, scene: Scene) -> Disturbance:
    """Send words over a bus with reflections: now and then one of some bits is read as the other."""
    sensor, mask, bits = draw_sensor(rng, scene), draw_axes(rng, 0.4), int(rng.integers(3, 9))
    struck = mask * (rng.random((scene.sample_count, 3)) < 10 ** rng.uniform(-2.0, -1.2))
    values = 2.0 ** rng.integers(0, bits, (scene.sample_count, 3))

    def change(amplitude: float, seen: Signal) -> Signal:
        ones = np.floor(seen[0][:, sensor] / (amplitude * values)) % 2
        return of_sensors(scene, {sensor: struck * amplitude * values * (1 - 2 * ones)})

    parameters = {"bits": bits}
    return Disturbance(
        "bit_flips", (sensor + 1,), named(mask), change, "T of the least bit", parameters, after_noise=True
    )


def feedback_heat(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let the current that nulls the field heat its own coil: the gain of an axis follows what it read before."""
    lag_s = scene.duration_s * 10 ** rng.uniform(-2.3, -1.2)
    fine_s = np.arange(-5 * lag_s, scene.duration_s + scene.step_s, scene.step_s)
    power = (scene.readings_at(fine_s)[:, sensor] / scene.intensity_T.mean()) ** 2
    heat = np.stack([low_pass(one, lag_s, fine_s) for one in power.T], axis=1)
    warm = np.stack([np.interp(scene.time_s, fine_s, one) for one in heat.T], axis=1)
    return np.asarray(rng.uniform(0.6, 1.4, 3) * (warm - warm.mean(axis=0)) * scene.core(sensor))


def wound_tether(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let a tether wind up as the array goes round: it twists a sensor's arm by all turns since the start."""
    turned = scene.motion.angles(scene.time_s)[:, 0]
    twist = (turned - turned.mean()) / np.ptp(turned)
    twist += rng.uniform(0, 0.8) * twist**3  # stiffer the more it is wound
    return np.cross(np.outer(twist, draw_direction(rng)), scene.core(sensor))


def flipped_domains(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let a shock flip domains in a film: a part of its sensitivity is lost, until the next pulse sets them again."""
    pulses = rng.uniform(8, 20) * scene.time_s / scene.duration_s + rng.random()
    index = np.floor(pulses).astype(int)
    shocks = rng.choice(index[-1] + 1, int(rng.integers(3, 6)), replace=False)
    lost = np.zeros(index[-1] + 1)
    lost[shocks] = rng.uniform(0.5, 1.0, len(shocks))
    since = pulses % 1 >= rng.uniform(0, 0.7, len(lost))[index]
    return -np.outer(lost[index] * since, rng.uniform(0.5, 1.5, 3)) * scene.core(sensor)


def swapped_pack(rng: Generator, scene: Scene) -> Disturbance:
    """Change the battery below the array for another in the middle of a recording: its steel has another moment."""
    place_m = float(np.abs(scene.positions_m).max()) * rng.uniform(2.5, 6) * draw_direction(rng)
    other = dipole(draw_direction(rng), np.vstack([scene.positions_m, np.zeros(3)]) - place_m)
    after = scene.time_s > rng.uniform(0.2, 0.8) * scene.duration_s
    extra = after[:, None, None] * other
    parameters = {"distance_m": float(norm(place_m))}
    return Disturbance("swapped_pack", (ALL,), (), carried(scene, 1e-9 * extra / size_of(extra)), "nT", parameters)


def dim_resonance(rng: Generator, scene: Scene) -> Disturbance:
    """Let the resonance of a pumped scalar grow dim near its dead zones: the dimmer it is, the noisier is its count."""
    cosine = scene.field_T @ draw_direction(rng) / scene.intensity_T
    bright = np.abs(2 * cosine * np.sqrt(np.maximum(1 - cosine**2, 0)))
    noise = rng.normal(size=scene.sample_count) / np.hypot(bright, rng.uniform(0.05, 0.15))
    return Disturbance("dim_resonance", (SCALAR,), (), proportional(of_scalar(scene, 1e-9 * noise)), "nT", {})


FOURTH = {
    "free_running_clock": outside(free_running_clock, motions=MOVING),
    "long_average": outside(long_average, motions=MOVING),
    "bimetal_snap": in_a_sensor(bimetal_snap, 0.3, channel="temperature"),
    "rotor_magnet": in_a_sensor(rotor_magnet, named="periodic_interference"),
    "brush_noise": outside(brush_noise, channel="current"),
    "solar_panel": outside(solar_panel, channel="attitude"),
    "bit_flips": outside(bit_flips, named="outliers"),
    "feedback_heat": in_a_sensor(feedback_heat, 0.5),
    "wound_tether": in_a_sensor(wound_tether),
    "flipped_domains": in_a_sensor(flipped_domains, 0.5),
    "swapped_pack": outside(swapped_pack),
    "dim_resonance": outside(dim_resonance, scalar_needed=True, most_nT=300.0),
}
"""The causes by their names; of those in a sensor the chance that it is one axis only."""
