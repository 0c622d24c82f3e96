"""A ninth set of causes outside the library: what brushes, clocks, filters, magnets, plugs, sparks and tethers do."""

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
from tam_validation.blind.outside import followed, in_a_sensor, outside
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of


def swinging_shackle(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Hang a magnetised shackle beside a sensor: knocked now and then, it swings as a pendulum until that fades."""
    turning = 2 * np.pi * rng.uniform(0.04, 0.3) / scene.step_s
    lasting_s = scene.duration_s * 10 ** rng.uniform(-1.3, -0.7)
    swing = np.zeros(scene.sample_count)
    for knock_s in rng.uniform(-0.05, 0.9, int(rng.integers(4, 9))) * scene.duration_s:
        since_s = np.maximum(scene.time_s - knock_s, 0)
        swing += rng.uniform(0.5, 1.5) * np.exp(-since_s / lasting_s) * np.sin(turning * since_s)
    return np.outer(swing, draw_direction(rng)) + 0.3 * np.outer(swing**2, draw_direction(rng))


def warm_magnets(rng: Generator, scene: Scene) -> Disturbance:
    """Let the losses of a motor warm its magnets, late: they are weaker by a thousandth for each degree."""
    warm = followed(rng, scene, lambda time_s: np.asarray(scene.current(time_s) ** 2))
    distance_m = float(np.abs(scene.positions_m).max()) * rng.uniform(3, 9)
    away_m = np.vstack([scene.positions_m, np.zeros(3)]) - distance_m * draw_direction(rng)
    extra = -warm[:, None, None] * dipole(draw_direction(rng), away_m)
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("warm_magnets", (ALL,), (), change, "nT", {"distance_m": distance_m})


def hopping_laser(rng: Generator, scene: Scene) -> Disturbance:
    """Let the laser of a pumped scalar hop from mode to mode as it warms: each shifts the line by its own amount."""
    warm = followed(rng, scene, scene.temperature)
    hops = np.sort(np.quantile(warm, rng.uniform(0.1, 0.9, int(rng.integers(2, 5)))))
    shifts = np.cumsum(rng.choice([-1.0, 1.0], len(hops) + 1) * rng.uniform(0.5, 1.5, len(hops) + 1))
    change = proportional(of_scalar(scene, 1e-9 * shifts[np.searchsorted(hops, warm)]))
    return Disturbance("hopping_laser", (SCALAR,), (), change, "nT", {"hops": len(hops)})


def loose_crimp(rng: Generator, scene: Scene) -> Disturbance:
    """Let a crimp in the supply of some bridges come loose for a while, again and again: all they read is less."""
    fed, times = draw_sensors(rng, scene), int(rng.integers(4, 10))
    lost = rng.uniform(0.5, 1.5, 2 * times + 1)
    lost[::2] = 0
    now = np.searchsorted(np.sort(rng.uniform(0, 1, 2 * times)) * scene.duration_s, scene.time_s)
    readings = -1e-9 * lost[now, None, None] * scene.readings_T / scene.intensity_T.mean()
    change = proportional(of_sensors(scene, {one: readings[:, one] for one in fed}))
    return Disturbance("loose_crimp", tuple(one + 1 for one in fed), (), change, "nT", {"times": times})


def wet_plug(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let salt water creep into a sensor's plug: it shunts the signal more and more, until the plug is full."""
    since = np.maximum(scene.time_s / scene.duration_s - rng.uniform(0, 0.4), 0)
    shunted = 1 - np.exp(-((since / rng.uniform(0.2, 0.5)) ** rng.uniform(1, 2)))
    return np.outer(-shunted / scene.intensity_T.mean(), rng.uniform(0.4, 1.6, 3)) * scene.readings_T[:, sensor]


def reset_filter(rng: Generator, scene: Scene) -> Disturbance:
    """Let someone set the filter of some sensors to a mean over more time: from then on they are late and smooth."""
    served, taps = draw_sensors(rng, scene), int(rng.integers(2, 7))
    start, lasting = rng.uniform(0.2, 0.65), rng.uniform(0.15, 0.35) if rng.random() < 0.3 else 1.0
    share = scene.time_s / scene.duration_s
    longer = ((share > start) & (share < start + lasting))[:, None, None]

    def change(amplitude: float, _seen: object) -> Signal:
        mean_T = sum(scene.readings_at(scene.time_s - amplitude * tap) for tap in range(taps)) / taps
        smoothed = longer * (mean_T - scene.readings_T)
        return of_sensors(scene, {one: smoothed[:, one] for one in served})

    return Disturbance("reset_filter", tuple(one + 1 for one in served), (), change, "s", {"taps": taps})


def watch_crystal(rng: Generator, scene: Scene) -> Disturbance:
    """Time some sensors by a watch crystal that is set once: it loses by the square of its distance from 25 °C."""
    timed, set_s = draw_sensors(rng, scene), scene.duration_s * rng.uniform(0, 1)
    fine_s = np.linspace(0, scene.duration_s, 2000)
    lost = np.cumsum((scene.temperature(fine_s) - 25) ** 2)
    late = (np.interp(scene.time_s, fine_s, lost) - np.interp(set_s, fine_s, lost)) / lost.std()

    def change(amplitude: float, _seen: object) -> Signal:
        waited = scene.readings_at(scene.time_s - amplitude * late) - scene.readings_T
        return of_sensors(scene, {one: waited[:, one] for one in timed})

    return Disturbance("watch_crystal", tuple(one + 1 for one in timed), (), change, "s", {})


def unequal_halves(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Turn negative inputs around before a converter of one sign: they have a gain and an offset of their own."""
    reading = scene.readings_T[:, sensor] / scene.intensity_T.mean()
    return np.asarray((reading < 0) * (rng.choice([-1.0, 1.0], 3) * reading + rng.uniform(-0.3, 0.3, 3)))


def hanging_tether(rng: Generator, scene: Scene) -> Disturbance:
    """Tie a tether with a steel sinker to an arm: it hangs straight down, whichever way the array is turned."""
    arm_m, down = float(np.abs(scene.positions_m).max()), -scene.to_world[:, 2]
    length_m = arm_m * rng.uniform(3, 7)
    sinker_m = arm_m * rng.uniform(0.5, 1.5) * draw_direction(rng) + length_m * down
    away_m = np.vstack([scene.positions_m, np.zeros(3)]) - sinker_m[:, None]
    extra = np.einsum("nm,mnpi->npi", down, np.stack([dipole(one, away_m) for one in np.eye(3)]))
    change = carried(scene, rng.choice([-1e-9, 1e-9]) * extra / size_of(extra))
    return Disturbance("hanging_tether", (ALL,), (), change, "nT", {"length_m": length_m})


def seismic_sparker(rng: Generator, scene: Scene) -> Disturbance:
    """Fire a sparker at equal intervals: what some sensors convert at that moment holds a part of its pulse."""
    near, between_s = draw_sensors(rng, scene), scene.step_s * rng.uniform(8, 40)
    since_s = (scene.time_s + between_s * rng.random()) % between_s
    pulse = 1e-9 * (since_s < scene.step_s * rng.uniform(0.3, 0.7)) * rng.uniform(0.4, 1.6, scene.sample_count)
    rows: dict[int, FloatArray] = {one: np.outer(pulse, draw_direction(rng)) for one in near}
    change = proportional(of_sensors(scene, rows))
    return Disturbance("seismic_sparker", tuple(one + 1 for one in near), (), change, "nT", {"interval_s": between_s})


def faint_resonance(rng: Generator, scene: Scene) -> Disturbance:
    """Turn a pumped scalar towards its dead zones: its signal goes with the sine of twice the angle, its noise not."""
    cosine = scene.field_T @ draw_direction(rng) / scene.intensity_T
    bright = 2 * np.abs(cosine) * np.sqrt(np.maximum(1 - cosine**2, 0))
    noise = 1e-9 * rng.normal(size=scene.sample_count) / np.maximum(bright, 0.08)
    return Disturbance("faint_resonance", (SCALAR,), (), proportional(of_scalar(scene, noise)), "nT at best", {})


def sparking_brushes(rng: Generator, scene: Scene) -> Disturbance:
    """Feed a motor through worn brushes: their sparks are noise in some sensors, the louder the more it draws."""
    reached, load_A = draw_sensors(rng, scene), scene.current(scene.time_s)
    loud = 1e-9 * (load_A / load_A.max())[:, None] ** rng.uniform(1, 2)
    rows: dict[int, FloatArray] = {one: loud * rng.normal(size=(scene.sample_count, 3)) for one in reached}
    change = proportional(of_sensors(scene, rows))
    return Disturbance("sparking_brushes", tuple(one + 1 for one in reached), (), change, "nT at full load", {})


NINTH = {
    "swinging_shackle": in_a_sensor(swinging_shackle, named="periodic_interference"),
    "warm_magnets": outside(warm_magnets, channel="current"),
    "hopping_laser": outside(hopping_laser, channel="temperature", scalar_needed=True, most_nT=100.0),
    "loose_crimp": outside(loose_crimp),
    "wet_plug": in_a_sensor(wet_plug, 0.4),
    "reset_filter": outside(reset_filter, motions=MOVING),
    "watch_crystal": outside(watch_crystal, motions=MOVING),
    "unequal_halves": in_a_sensor(unequal_halves, 0.6, named="nonlinearity"),
    "hanging_tether": outside(hanging_tether, named="ambient_gradient"),
    "seismic_sparker": outside(seismic_sparker, named="outliers"),
    "faint_resonance": outside(faint_resonance, scalar_needed=True, named="noise_excess"),
    "sparking_brushes": outside(sparking_brushes, channel="current", named="noise_excess"),
}
"""The causes by their names; of those in a sensor the chance of one axis only. Light shifts a line by tens of nT."""
