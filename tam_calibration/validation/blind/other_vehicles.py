"""Vehicles of other kinds: each another source of its field, on another mount of the array, under way.

No rule of the diagnosis was made by them. Conductors are loops, plates and solid bodies of metals, of which none
answers by more than it does in nature; what moves is recorded beside, and currents flow through wires.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.validation.blind.conductors import SLOWEST_ACROSS, disc, of_cylinder, of_sphere, of_wires, ribs
from tam_calibration.validation.blind.continuous_motion import VOYAGES
from tam_calibration.validation.blind.disturbance import draw_direction
from tam_calibration.validation.blind.mount import CONDUCTIVITIES, Columns, Mount, Source, recorded, vehicles
from tam_calibration.validation.blind.processes import draw_load, draw_wander
from tam_calibration.validation.blind.scene import Scene
from tam_calibration.validation.blind.vehicle import PERMEABILITY, Body


def frame(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Weld ribs of tubes to a frame, every rectangle of which is a circuit."""
    width, height, spacing = rng.uniform([0.3, 0.2, 0.2], [0.8, 0.6, 0.5])
    half = (mount.distance_m * width * mount.across, mount.distance_m * height * mount.up)
    reach = float(sum(abs(edge @ mount.away) for edge in half))
    centres = np.array([mount.at((0.1 + spacing * rib, 0, 0.3), reach) for rib in range(int(rng.integers(2, 5)))])
    wire = mount.distance_m * rng.uniform(0.01, 0.025)
    ohm_per_m = 1 / (float(rng.choice(CONDUCTIVITIES)) * np.pi * wire**2 * rng.uniform(0.2, 1.0))
    return ribs(centres, *half, wire, ohm_per_m).field(scene, places_m), {}


def plates(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Lay one thin plate or two, in planes that are not parallel."""
    total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
    for normal in (mount.up, mount.across)[: int(rng.integers(1, 3))]:
        radius = mount.distance_m * rng.uniform(0.3, 0.8)
        reach = radius * float(norm(np.cross(normal, mount.away)))
        centre = mount.at(rng.uniform([0.0, 0.0, 0.0], [0.5, 0.3, 0.3]), reach)
        ohm = 1 / (float(rng.choice(CONDUCTIVITIES)) * rng.uniform(0.001, 0.006))
        total += disc(centre, normal, radius, ohm).field(scene, places_m)
    return total, {}


def spheres(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Load one to three solid spheres of metals."""
    total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
    for _ in range(int(rng.integers(1, 4))):
        radius = min(mount.distance_m * rng.uniform(0.1, 0.3), rng.uniform(0.1, 0.5))
        centre = mount.at(rng.uniform([0.0, 0.0, 0.0], [0.8, 0.4, 0.4]), radius)
        total += of_sphere(scene, places_m, centre, radius, float(rng.choice(CONDUCTIVITIES)))
    return total, {}


def shafts(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Fit a shaft or two beside each other, solid cylinders along the vehicle."""
    total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
    for across in (0.0, rng.uniform(0.2, 0.6))[: int(rng.integers(1, 3))]:
        ends = np.array([mount.at((start, across, 0.1)) for start in (0.0, rng.uniform(0.5, 1.2))])
        radius = min(mount.distance_m * rng.uniform(0.05, 0.12), 0.4)
        total += of_cylinder(scene, places_m, ends, radius, float(rng.choice(CONDUCTIVITIES[1:])))
    return total, {}


def trim_tabs(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Tilt two tabs of soft iron about hinges across the vehicle: bars that the field along them magnetises.

    What a bar makes is the field of the poles at its ends; that of the tabs at rest is subtracted.
    """
    total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
    columns: Columns = {}
    limit = from_degrees(rng.uniform(5, 15))
    for side, name in ((-0.4, "actuator_tab_port"), (0.4, "actuator_tab_starboard")):
        steered = draw_wander(rng, scene.duration_s, int(rng.integers(8, 16)))(scene.time_s)
        angle = limit * np.tanh(steered + 0.5 * _rate_of_pitch(scene))
        bar = _Bar(mount, mount.at((0.1, side, 0.1)), mount.distance_m * rng.uniform(0.1, 0.2), rng.uniform(1e-4, 1e-3))
        total += bar.field(scene, angle, places_m) - bar.field(scene, np.zeros(1), places_m)
        columns[name] = np.round(angle + rng.normal(0, 2e-4, len(angle)), 5)
    return total, columns


@dataclass(frozen=True, eq=False)
class _Bar:
    """A bar of soft iron with one end at a hinge: its poles are the flux that it gathers [m²] times the field."""

    mount: Mount
    hinge_m: FloatArray
    length_m: float
    gathers_m2: float

    def field(self, scene: Scene, angle: FloatArray, places_m: FloatArray) -> FloatArray:
        """Return its field (N, P, 3) at angles (N,) or one."""
        turned = np.cos(angle)[:, None] * self.mount.along + np.sin(angle)[:, None] * self.mount.up
        flux = self.gathers_m2 * np.sum(turned * scene.field_T, axis=1)
        ends = (self.hinge_m + 0 * turned, self.hinge_m + self.length_m * turned)
        total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
        for sign, end in zip((-1, 1), ends, strict=True):
            away = places_m - end[:, None]
            total += sign * flux[:, None, None] * away / (4 * np.pi * norm(away, axis=2)[:, :, None] ** 3)
        return total


def _rate_of_pitch(scene: Scene) -> FloatArray:
    """Return the rate of pitch (N,) over its standard deviation."""
    rate = np.gradient(scene.motion.angles(scene.time_s)[:, 1], scene.time_s)
    return np.asarray(rate / rate.std())


def motor(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Turn a motor at a speed that is recorded: its winding leaks, and the Earth's field drags along its rotor.

    In the rotor's frame the field turns; a solid one across answers to it by χ = i ω τ / (1 + i ω τ).
    """
    top = rng.uniform(2, 12)
    speed = top * (0.6 + 0.4 * np.tanh(draw_wander(rng, scene.duration_s, int(rng.integers(8, 20)))(scene.time_s)))
    centre, radius, length = mount.at((0.2, 0, 0.1)), rng.uniform(0.02, 0.04), rng.uniform(0.1, 0.3)
    lagging = 2 * np.pi * speed * PERMEABILITY * float(rng.choice(CONDUCTIVITIES[1:])) * (radius / SLOWEST_ACROSS) ** 2
    across = scene.field_T - np.outer(scene.field_T @ mount.along, mount.along)
    answer = lagging[:, None] * (lagging[:, None] * across + np.cross(mount.along, scene.field_T))
    moment = -2 * np.pi * radius**2 * length / PERMEABILITY * answer / (1 + lagging[:, None] ** 2)
    leaks = norm(moment, axis=1).mean() * rng.uniform(0.5, 5) * draw_direction(rng)
    moment += leaks * (speed / top)[:, None]
    dipole = Body(centre, mount.along, length, radius).dipole(places_m)
    error = rng.normal(0, 2e-3 * top, len(speed))
    return np.einsum("pij,nj->npi", dipole, moment), {"actuator_motor": np.round(speed + error, 4)}


def batteries(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Feed two loads by wires of their own, and let both currents return through one conductor."""
    far = 1.2 * mount.along * mount.distance_m
    home = mount.at((0.0, 0, 0.1))
    returns = np.array([home + far, home])
    load = draw_load(rng, scene.duration_s)(scene.time_s)
    wander = draw_wander(rng, scene.duration_s, int(rng.integers(10, 30)))(scene.time_s)
    currents = [load, rng.uniform(2, 10) * (1 + 0.4 * np.tanh(wander))]
    total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
    for current in currents:
        apart = mount.distance_m * rng.uniform(0.02, 0.15) * draw_direction(rng)
        there = np.array([home, home + apart, home + apart + far, home + far])
        total += current[:, None, None] * of_wires(np.vstack([there, returns]), places_m)
    return total, recorded(rng, currents)


def thrusters(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Steer by thrusters, each of which draws a current of its own as the vehicle turns and is driven on."""
    count = int(rng.integers(2, 4))
    rate = scene.motion.turning_rate(scene.time_s, scene.step_s) @ rng.normal(size=(3, count))
    turning = rate / rate.std(axis=0)
    currents, total = [], np.zeros((scene.sample_count, len(places_m), 3))
    for thruster in range(count):
        ahead = draw_wander(rng, scene.duration_s, int(rng.integers(6, 20)))(scene.time_s)
        current = rng.uniform(1, 6) * (1 + 0.3 * np.tanh(turning[:, thruster]) + 0.3 * np.tanh(ahead))
        home, end = mount.at((0.1, 0, 0.2)), mount.at(rng.uniform([0.2, -0.5, 0.0], [0.8, 0.5, 0.4]))
        beside = mount.distance_m * rng.uniform(0.01, 0.1) * draw_direction(rng)
        total += current[:, None, None] * of_wires(np.array([home, end, end + beside, home + beside, home]), places_m)
        currents.append(current)
    return total, recorded(rng, currents)


CONDUCTORS: tuple[Source, ...] = (frame, plates, spheres, shafts)
MOVED: tuple[Source, ...] = (trim_tabs, motor, batteries, thrusters)


_KINDS: list[tuple[Source, ...]] = [
    *((one,) for one in (*CONDUCTORS, *MOVED)),
    (spheres, trim_tabs),
    (frame, thrusters),
]

OTHER_VEHICLES = vehicles(_KINDS, CONDUCTORS, VOYAGES)
"""By their names; their effect in a key is ``platform_field``."""
