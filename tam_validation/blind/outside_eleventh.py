"""An eleventh set of causes outside the library: what cameras, heaters, lifts, pumps, queues and weights do."""

import numpy as np
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_validation.blind.continuous_motion import about
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
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of


def magnet_pump(rng: Generator, scene: Scene) -> Disturbance:
    """Turn a pump through its wall by magnets: they run the slower the more other loads draw from their supply."""
    fine_s = np.arange(0, scene.duration_s + scene.step_s, scene.step_s / 5)
    load_A = scene.current(fine_s)
    speed = rng.uniform(0.15, 0.4) / scene.step_s * (1 - rng.uniform(0.03, 0.2) * load_A / load_A.max())
    angle = 2 * np.pi * np.interp(scene.time_s, fine_s, np.cumsum(speed) * scene.step_s / 5)
    axle = draw_direction(rng)
    across = np.cross(axle, draw_direction(rng))
    across /= np.linalg.norm(across)
    moment = np.outer(np.cos(angle), across) + np.outer(np.sin(angle), np.cross(axle, across))
    return _on_board(rng, scene, "magnet_pump", moment, {})


def _on_board(
    rng: Generator, scene: Scene, effect: str, moment: FloatArray, parameters: dict[str, float]
) -> Disturbance:
    """Return the cause that a moment (N, 3) is which the array carries at some distance."""
    distance_m = float(np.abs(scene.positions_m).max()) * rng.uniform(3, 9)
    away_m = np.vstack([scene.positions_m, np.zeros(3)]) - distance_m * draw_direction(rng)
    extra = np.einsum("nm,mpi->npi", moment, np.stack([dipole(one, away_m) for one in np.eye(3)]))
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance(effect, (ALL,), (), change, "nT", {"distance_m": distance_m, **parameters})


def dropped_weight(rng: Generator, scene: Scene) -> Disturbance:
    """Drop steel weights to rise again: from then on neither their magnetism nor what the field induces is there."""
    drops, share = int(rng.integers(1, 3)), scene.time_s / scene.duration_s
    held = 1 - np.searchsorted(np.sort(rng.uniform(0.15, 0.85, drops)), share) / drops
    induced = rng.uniform(0, 0.3) * scene.field_T / scene.intensity_T.mean()
    moment = held[:, None] * (draw_direction(rng) + induced)
    return _on_board(rng, scene, "dropped_weight", moment, {"drops": drops})


def neighbouring_lift(rng: Generator, scene: Scene) -> Disturbance:
    """Turn the array beside a lift's shaft: its cabin of steel stands at one floor or another."""
    rides, near_m, heading = int(rng.integers(4, 9)), rng.uniform(2, 5), rng.uniform(0, 2 * np.pi)
    floors_m = rng.uniform(-1, 1) + 3.0 * np.array([-2, -1, 0, 1, 2])
    stops = (int(rng.integers(5)) + np.cumsum(np.append(0, rng.integers(1, 5, rides)))) % 5
    height_m = np.repeat(floors_m[stops], 2)[1:-1]
    leaves = np.sort(rng.uniform(0.03, 0.95, rides))
    arrives = np.minimum(leaves + 0.01, np.append(leaves[1:], 1.0))
    cabin_m = np.zeros((scene.sample_count, 3)) + near_m * np.array([np.cos(heading), np.sin(heading), 0])
    cabin_m[:, 2] = np.interp(scene.time_s / scene.duration_s, np.stack([leaves, arrives], axis=1).ravel(), height_m)
    at_m = np.einsum("nij,kj->nki", scene.to_world, np.vstack([scene.positions_m, np.zeros(3)]))
    extra = np.einsum("nji,nkj->nki", scene.to_world, dipole(draw_direction(rng), at_m - cabin_m[:, None]))
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("neighbouring_lift", (ALL,), (), change, "nT", {"rides": rides, "distance_m": near_m})


def gimballed_camera(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Hold a camera level near a sensor: the magnets of its gimbal turn with the heading, and not with the tilt."""
    heading = about("z", scene.motion.angles(scene.time_s)[:, 0])
    moment = np.einsum("nji,njk,k->ni", scene.to_world, heading, draw_direction(rng))
    toward = draw_direction(rng)
    return np.asarray((3 * np.outer(moment @ toward, toward) - moment) @ scene.response[sensor].T)


def crossover_distortion(rng: Generator, scene: Scene) -> Disturbance:
    """Drive a feedback coil by two transistors: where one hands over to the other, neither of them conducts."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.6)
    reading_T = scene.readings_T[:, sensor]
    beyond_T = reading_T - np.quantile(reading_T, rng.uniform(0.3, 0.7), axis=0)

    def change(amplitude: float, _seen: object) -> Signal:
        return of_sensors(scene, {sensor: -mask * np.clip(beyond_T, -amplitude, amplitude)})

    return Disturbance("crossover_distortion", (sensor + 1,), named(mask), change, "T of half the gap", {})


def sagging_supply(rng: Generator, scene: Scene) -> Disturbance:
    """Feed some bridges from the battery of a load: its voltage falls with the current at once, and then some more."""
    fed, lag_s = draw_sensors(rng, scene), scene.duration_s * 10 ** rng.uniform(-2, -1)
    fine_s = np.linspace(0, scene.duration_s, 2000)
    load_A = scene.current(fine_s)
    sag = np.interp(scene.time_s, fine_s, load_A + rng.uniform(0.1, 0.6) * low_pass(load_A, lag_s, fine_s))
    readings = -1e-9 * (sag / sag.max())[:, None, None] * scene.readings_T / scene.intensity_T.mean()
    change = proportional(of_sensors(scene, {one: readings[:, one] for one in fed}))
    return Disturbance("sagging_supply", tuple(one + 1 for one in fed), (), change, "nT", {"lag_s": lag_s})


def creeping_mount(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Screw a sensor to a plastic that creeps: it turns about one line, with the logarithm of the time under load."""
    crept = np.log1p(scene.time_s / scene.duration_s * 10 ** rng.uniform(0.3, 1.5))
    return np.asarray(crept[:, None] * np.cross(draw_direction(rng), scene.core(sensor)))


def stalled_queue(rng: Generator, scene: Scene) -> Disturbance:
    """Stamp readings when they leave a queue: it fills while a memory card is busy, and empties soon after."""
    queued, stalls = draw_sensors(rng, scene), int(rng.integers(4, 10))
    late = np.zeros(scene.sample_count)
    for busy_s in rng.uniform(0, 0.95, stalls) * scene.duration_s:
        since = (scene.time_s - busy_s) / (scene.duration_s * rng.uniform(0.02, 0.08))
        late = np.maximum(late, rng.uniform(0.5, 1.5) * np.maximum(1 - since, 0) * (since >= 0))

    def change(amplitude: float, _seen: object) -> Signal:
        waited = scene.readings_at(scene.time_s - amplitude * late) - scene.readings_T
        return of_sensors(scene, {one: waited[:, one] for one in queued})

    return Disturbance("stalled_queue", tuple(one + 1 for one in queued), (), change, "s", {"stalls": stalls})


def slewing_integrator(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Null the field by an integrator of limited speed: turned faster than that, an axis falls behind."""
    short_s = scene.step_s / 50
    after, before = (scene.readings_at(scene.time_s + by)[:, sensor] for by in (short_s, -short_s))
    rate = (after - before) / np.abs(after - before).max(axis=0)
    limit = np.quantile(np.abs(rate), rng.uniform(0.4, 0.8), axis=0)
    return np.asarray(-np.sign(rate) * np.maximum(np.abs(rate) - limit, 0))


def draining_polariser(rng: Generator, scene: Scene) -> Disturbance:
    """Polarise the protons of a scalar from a battery that drains: they precess ever fainter in the same noise."""
    drained = (scene.time_s / scene.duration_s) ** rng.uniform(1, 3)
    signal = 1 - rng.uniform(0.6, 0.85) * drained
    noise = 1e-9 * rng.normal(size=scene.sample_count) / signal
    change = proportional(of_scalar(scene, noise))
    return Disturbance("draining_polariser", (SCALAR,), (), change, "nT when it is fresh", {})


def heater_leads(rng: Generator, scene: Scene) -> Disturbance:
    """Heat the cell of a scalar the more the colder it is: it sees what of its leads' field lies along the Earth's."""
    air_C = scene.temperature(scene.time_s)
    heating = (air_C.max() - air_C) / np.ptp(air_C) + rng.uniform(0, 0.3)
    along = scene.field_T @ draw_direction(rng) / scene.intensity_T
    change = proportional(of_scalar(scene, 1e-9 * heating * along))
    return Disturbance("heater_leads", (SCALAR,), (), change, "nT in the cold", {})


def inrush_surge(rng: Generator, scene: Scene) -> Disturbance:
    """Switch a load on: its capacitors draw a surge, which one reading of the sensors near its cable holds."""
    near, rise = draw_sensors(rng, scene), np.diff(scene.current(scene.time_s), prepend=scene.current(np.zeros(1)))
    rises = rise > 0.05 * rise.max()
    surge = 1e-9 * rises * ~np.append(False, rises[:-1]) * rng.uniform(0.4, 1.6, scene.sample_count)
    rows: dict[int, FloatArray] = {one: np.outer(surge, draw_direction(rng)) for one in near}
    change = proportional(of_sensors(scene, rows))
    return Disturbance("inrush_surge", tuple(one + 1 for one in near), (), change, "nT", {})


ELEVENTH = {
    "magnet_pump": outside(magnet_pump, channel="current", named="periodic_interference"),
    "dropped_weight": outside(dropped_weight, named="bias_jump"),
    "neighbouring_lift": outside(neighbouring_lift, channel="attitude"),
    "gimballed_camera": in_a_sensor(gimballed_camera, channel="attitude"),
    "crossover_distortion": outside(crossover_distortion, named="nonlinearity"),
    "sagging_supply": outside(sagging_supply, channel="current"),
    "creeping_mount": in_a_sensor(creeping_mount),
    "stalled_queue": outside(stalled_queue, motions=MOVING),
    "slewing_integrator": in_a_sensor(slewing_integrator, 1.0, motions=MOVING),
    "draining_polariser": outside(draining_polariser, scalar_needed=True, named="noise_excess"),
    "heater_leads": outside(heater_leads, channel="temperature", scalar_needed=True, most_nT=100.0),
    "inrush_surge": outside(inrush_surge, channel="current", named="outliers"),
}
"""The causes by their names; of those in a sensor the chance of one axis only. An ampere in twisted leads is 100 nT."""
