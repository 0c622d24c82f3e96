"""Vehicles of yet other kinds, for the judgement after a rule was changed by that of `other_vehicles`."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.validation.blind.conductors import Loops, faded, neumann, of_wires
from tam_calibration.validation.blind.continuous_motion import VOYAGES
from tam_calibration.validation.blind.disturbance import MOVING, draw_direction
from tam_calibration.validation.blind.mount import CONDUCTIVITIES, Columns, Mount, Source, recorded, vehicles
from tam_calibration.validation.blind.processes import draw_load, draw_wander
from tam_calibration.validation.blind.scene import Scene
from tam_calibration.validation.blind.vehicle import PERMEABILITY, Body

_SIDES = 24
"""Of the polygon that stands for a hoop."""


def hulls(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Hold one to three hollow spheres, thin of wall: τ = μ0 σ a t / 3."""
    total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
    for _ in range(int(rng.integers(1, 4))):
        radius, wall = mount.distance_m * rng.uniform(0.15, 0.4), rng.uniform(0.005, 0.03)
        centre = mount.at(rng.uniform([0.0, 0.0, 0.0], [0.8, 0.4, 0.4]), radius)
        constant = PERMEABILITY * float(rng.choice(CONDUCTIVITIES[1:])) * radius * wall / 3
        moment = -2 * np.pi * radius**3 / PERMEABILITY * faded(scene, np.array([constant]))[0]
        total += np.einsum("pij,nj->npi", Body(centre, mount.along, radius, radius).dipole(places_m), moment)
    return total, {}


def pipes(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Lead two to five pipes, thin of wall, in any direction away: τ = μ0 σ a t / 2, twice as strong across."""
    total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
    for _ in range(int(rng.integers(2, 6))):
        axis = draw_direction(rng)
        axis *= np.sign(axis @ mount.away)
        radius, wall = mount.distance_m * rng.uniform(0.1, 0.3), rng.uniform(0.005, 0.03)
        length = mount.distance_m * rng.uniform(0.5, 1.5)
        begin = mount.at(rng.uniform([0.0, 0.0, 0.0], [0.5, 0.4, 0.4]), radius)
        constant = PERMEABILITY * float(rng.choice(CONDUCTIVITIES[1:])) * radius * wall / 2
        answer = -np.pi * radius**2 * length / PERMEABILITY * (2 * np.eye(3) - np.outer(axis, axis))
        moment = faded(scene, np.array([constant]))[0] @ answer
        parts = begin + (np.arange(8) + 0.5)[:, None] / 8 * length * axis
        dipole = np.mean([Body(part, axis, length, radius).dipole(places_m) for part in parts], axis=0)
        total += np.einsum("pij,nj->npi", dipole, moment)
    return total, {}


def hoops(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Put three to five closed hoops behind each other, each in a plane of its own."""
    radius, wire = mount.distance_m * rng.uniform(0.4, 0.8), mount.distance_m * rng.uniform(0.02, 0.05)
    circle, spacing = np.linspace(0, 2 * np.pi, _SIDES, endpoint=False)[:, None], rng.uniform(2.1, 2.6)
    corners = []
    for hoop in range(int(rng.integers(3, 6))):
        normal = draw_direction(rng)
        first = np.cross(normal, draw_direction(rng))
        first /= norm(first)
        centre = mount.at((0.1, 0.1, 0.1), (1 + spacing * hoop) * radius)
        corners.append(centre + radius * (np.cos(circle) * first + np.sin(circle) * np.cross(normal, first)))
    ohm_per_m = 1 / (float(rng.choice(CONDUCTIVITIES[1:])) * np.pi * wire**2 * rng.uniform(0.2, 1.0))
    own = PERMEABILITY * radius * (np.log(8 * radius / wire) - 2)
    inductance = np.array(
        [[own if i == j else neumann(one, other) for j, other in enumerate(corners)] for i, one in enumerate(corners)]
    )
    resistance = ohm_per_m * 2 * np.pi * radius * np.eye(len(corners))
    return Loops(np.array(corners), inductance, resistance).field(scene, places_m), {}


def arm(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Swing an arm with a steel tool at its end, which keeps a moment and is magnetised; that at rest is subtracted."""
    limit = from_degrees(rng.uniform(5, 15))
    angle = limit * np.tanh(draw_wander(rng, scene.duration_s, int(rng.integers(8, 20)))(scene.time_s))
    shoulder, length = mount.at((0.2, 0.1, 0.1)), mount.distance_m * rng.uniform(0.1, 0.2)
    kept, gathers = draw_direction(rng), rng.uniform(0.2, 1.0)
    moment = kept + gathers * scene.field_T / scene.intensity_T[:, None]

    def field(turn: FloatArray) -> FloatArray:
        tips = shoulder + length * (np.cos(turn)[:, None] * mount.up + np.sin(turn)[:, None] * mount.along)
        away = places_m - tips[:, None]
        distance = norm(away, axis=2)[:, :, None]
        along = np.einsum("npi,ni->np", away, moment)[:, :, None] * away
        return np.asarray(1e-7 * (3 * along / distance**5 - moment[:, None] / distance**3))

    error = rng.normal(0, 2e-4, len(angle))
    return field(angle) - field(0 * angle), {"actuator_arm": np.round(angle + error, 5)}


def pump(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Switch a pump on and off: the mean field of its magnets is not that at rest."""
    runs = (draw_wander(rng, scene.duration_s, int(rng.integers(12, 30)))(scene.time_s) > 0).astype(float)
    body = Body(mount.at(rng.uniform([0.1, 0.0, 0.0], [0.5, 0.3, 0.3])), mount.along, 0.1, 0.05)
    return runs[:, None, None] * (body.dipole(places_m) @ draw_direction(rng)), {"actuator_pump": runs}


def electrodes(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Protect two parts against corrosion by currents that return through the water, where they make no field."""
    load = draw_load(rng, scene.duration_s)(scene.time_s)
    wander = draw_wander(rng, scene.duration_s, int(rng.integers(10, 30)))(scene.time_s)
    currents = [load, rng.uniform(2, 10) * (1 + 0.4 * np.tanh(wander))]
    total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
    for current in currents:
        begin, end = (mount.at(rng.uniform([0.0, 0.0, 0.0], [1.0, 0.5, 0.5])) for _ in range(2))
        total += current[:, None, None] * of_wires(np.array([begin, end]), places_m)
    return total, recorded(rng, currents)


_CONDUCTORS: tuple[Source, ...] = (hulls, pipes, hoops)
_KINDS: list[tuple[Source, ...]] = [
    *((one,) for one in (*_CONDUCTORS, arm, pump, electrodes)),
    (hulls, pipes),
    (hulls, arm),
    (pipes, electrodes),
    (hoops, pump),
]

FURTHER_VEHICLES = vehicles(_KINDS, _CONDUCTORS, (*MOVING, *VOYAGES))
"""By their names; their effect in a key is ``platform_field``."""
