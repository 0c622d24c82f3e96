"""Vehicles of kinds that were written last, for the judgement after the rules that `further_vehicles` had changed."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator
from scipy.linalg import eigh

from tam_calibration.model.units import FloatArray
from tam_calibration.validation.blind.conductors import Loops, disc, faded, of_wires
from tam_calibration.validation.blind.continuous_motion import VOYAGES
from tam_calibration.validation.blind.disturbance import MOVING, draw_direction
from tam_calibration.validation.blind.mount import CONDUCTIVITIES, Columns, Mount, Source, recorded, vehicles
from tam_calibration.validation.blind.processes import draw_load, draw_wander
from tam_calibration.validation.blind.scene import Scene
from tam_calibration.validation.blind.vehicle import PERMEABILITY, Body

_PIECES = 16
"""Of each edge of a mesh, shorter than the wires between them are thick."""


def casks(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Hold a hollow sphere of one metal within one of another; each shields and drives the other.

    With x the moments over those of perfect shells, A = 2π a³ / μ0 of each, A x / τ + M x' = -A b', where M holds the A
    of the outer shell for its own flux and that of the inner one for the other three.
    """
    radius = mount.distance_m * rng.uniform(0.25, 0.45)
    radii = radius * np.array([1.0, rng.uniform(0.5, 0.9)])
    walls, metals = rng.uniform(0.005, 0.03, 2), rng.choice(CONDUCTIVITIES, 2, replace=False)
    perfect = 2 * np.pi * radii**3 / PERMEABILITY
    fluxes = np.array([[perfect[0], perfect[1]], [perfect[1], perfect[1]]])
    constants, modes = eigh(fluxes, np.diag(3 * perfect / (PERMEABILITY * metals * radii * walls)))
    moment = -np.einsum("m,m,mnj->nj", (modes.T @ perfect) ** 2, 1 / constants, faded(scene, constants))
    centre = mount.at(rng.uniform([0.0, 0.0, 0.0], [0.5, 0.3, 0.3]), radius)
    return np.einsum("pij,nj->npi", Body(centre, mount.along, radius, radius).dipole(places_m), moment), {}


def blades(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Turn three to five round blades about a shaft along the vehicle and let them stand."""
    total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
    count, radius = int(rng.integers(3, 6)), mount.distance_m * rng.uniform(0.5, 0.9)
    pitch, out = rng.uniform(0.3, 1.0), radius * rng.uniform(1.1, 1.5)
    ohm = 1 / (float(rng.choice(CONDUCTIVITIES[1:])) * rng.uniform(0.01, 0.03))
    reach = (radius + out) * float(norm(np.cross(mount.along, mount.away))) + radius * np.sin(pitch)
    hub = mount.at((0.1, 0.0, 0.0), reach)
    for angle in rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(count) / count:
        arm = np.cos(angle) * mount.across + np.sin(angle) * mount.up
        normal = np.cos(pitch) * mount.along + np.sin(pitch) * np.cross(mount.along, arm)
        total += disc(hub + out * arm, normal, radius, ohm).field(scene, places_m)
    return total, {}


def coils(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Join the ends of one to three coils on iron, each of which answers along its axis alone.

    L i' + R i = -Φ', the core gathering p times the flux and leading out p times the moment: τ = μ0 σ p a t / 2.
    """
    total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
    for _ in range(int(rng.integers(1, 4))):
        axis = draw_direction(rng)
        length, radius = mount.distance_m * rng.uniform(0.3, 0.8), mount.distance_m * rng.uniform(0.1, 0.2)
        gathered = rng.uniform(1.0, 6.0)
        constant = PERMEABILITY * CONDUCTIVITIES[-1] * gathered * radius * rng.uniform(0.001, 0.01) / 2
        answer = -np.pi * radius**2 * length * gathered / PERMEABILITY * np.outer(axis, axis)
        moment = faded(scene, np.array([constant]))[0] @ answer
        middle = mount.at(rng.uniform([0.0, 0.0, 0.0], [0.5, 0.4, 0.4]), length / 2 + radius)
        parts = middle + ((np.arange(8) + 0.5)[:, None] / 8 - 0.5) * length * axis
        dipole = np.mean([Body(part, axis, length, radius).dipole(places_m) for part in parts], axis=0)
        total += np.einsum("pij,nj->npi", dipole, moment)
    return total, {}


def net(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Stretch a net of wires, whose square meshes share their edges, in a plane of any direction."""
    edge, wire = mount.distance_m * rng.uniform(0.3, 0.6), mount.distance_m * rng.uniform(0.02, 0.04)
    rows, columns = rng.integers(2, 4, 2)
    normal = draw_direction(rng)
    one = np.cross(normal, draw_direction(rng))
    one /= norm(one)
    other = np.cross(normal, one)
    cells = np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), axis=2).reshape(-1, 2)
    corners = (cells[:, None] + [[0, 0], [1, 0], [1, 1], [0, 1]] - np.array([rows, columns]) / 2) * edge
    centre = mount.at((0.1, 0.1, 0.1), float(norm([rows, columns]) / 2 * edge))
    paths = centre + corners @ np.array([one, other])
    step = (np.roll(paths, -1, axis=1) - paths) / _PIECES
    pieces = paths[:, :, None] + (np.arange(_PIECES) + 0.5)[:, None] * step[:, :, None]
    lengths = np.broadcast_to(step[:, :, None], pieces.shape).reshape(len(cells), -1, 3)
    pieces = pieces.reshape(len(cells), -1, 3)
    inductance = np.empty((len(cells), len(cells)))
    for i, near in enumerate(pieces):
        for j, far in enumerate(pieces):
            distance = np.sqrt(np.sum((near[:, None] - far) ** 2, axis=2) + wire**2)
            inductance[i, j] = PERMEABILITY / (4 * np.pi) * np.sum(lengths[i] @ lengths[j].T / distance)
    shared = np.abs(cells[:, None] - cells).sum(axis=2) == 1
    of_edge = edge / (float(rng.choice(CONDUCTIVITIES[1:])) * np.pi * wire**2 * rng.uniform(0.2, 1.0))
    return Loops(paths, inductance, of_edge * (4 * np.eye(len(cells)) - shared)).field(scene, places_m), {}


def trolley(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Move a weight of iron along the vehicle for trim; that at rest is subtracted."""
    reach = mount.distance_m * rng.uniform(0.03, 0.1)
    shift = reach * np.tanh(draw_wander(rng, scene.duration_s, int(rng.integers(6, 20)))(scene.time_s))
    home, rail = mount.at(rng.uniform([0.0, 0.0, 0.0], [0.4, 0.3, 0.3])), draw_direction(rng)
    moment = draw_direction(rng) + rng.uniform(0.2, 1.0) * scene.field_T / scene.intensity_T[:, None]
    moved = _dipoles(home + shift[:, None] * rail, moment, places_m) - _dipoles(home[None], moment, places_m)
    return moved, {"actuator_trolley": np.round(shift + rng.normal(0, 2e-3 * reach, len(shift)), 5)}


def strut(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Let a strut of steel out and in, seldom and for some time each time; that inside is subtracted."""
    moves = np.sort(rng.uniform(0.1, 0.9, int(rng.integers(1, 5)))) * scene.duration_s
    taken = scene.duration_s * rng.uniform(0.01, 0.08)
    ramps = np.clip((scene.time_s[:, None] - moves) / taken, 0, 1)
    out = np.abs(np.sum(ramps * (-1.0) ** np.arange(len(moves)), axis=1))
    home, way = mount.at((0.2, 0.2, 0.1)), mount.distance_m * rng.uniform(0.05, 0.12) * draw_direction(rng)
    moment = draw_direction(rng) + rng.uniform(0.0, 0.5) * scene.field_T / scene.intensity_T[:, None]
    moved = _dipoles(home + out[:, None] * way, moment, places_m) - _dipoles(home[None], moment, places_m)
    return moved, {"actuator_strut": np.round(out + rng.normal(0, 2e-3, len(out)), 4)}


def ram(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Push a rod of soft iron out of its cylinder: the poles that the field along it makes are at its ends."""
    longest = mount.distance_m * rng.uniform(0.05, 0.15)
    stroke = longest * (0.5 + 0.5 * np.tanh(draw_wander(rng, scene.duration_s, int(rng.integers(8, 20)))(scene.time_s)))
    home, axis = mount.at((0.2, -0.1, 0.2)), draw_direction(rng)
    pole = rng.uniform(1e-4, 1e-3) * (scene.field_T @ axis + rng.uniform(-0.5, 0.5) * scene.intensity_T.mean())
    total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
    for sign, end in ((-1, home[None]), (1, home + stroke[:, None] * axis)):
        away = places_m - end[:, None]
        total += sign * pole[:, None, None] * away / (4 * np.pi * norm(away, axis=2)[:, :, None] ** 3)
    return total, {"actuator_ram": np.round(stroke / longest + rng.normal(0, 2e-3, len(stroke)), 4)}


def tether(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Feed what hangs on a long cable, and let the current come back by its screen, which is not centred."""
    drawn = 1 + 0.5 * np.tanh(draw_wander(rng, scene.duration_s, int(rng.integers(5, 15)))(scene.time_s))
    current = rng.uniform(1, 8) * drawn + draw_load(rng, scene.duration_s)(scene.time_s) / 12
    home, far = mount.at((0.0, 0.1, 0.1)), mount.at(rng.uniform([2.0, -1.0, -1.0], [5.0, 1.0, 1.0]))
    beside = mount.distance_m * rng.uniform(0.01, 0.03) * draw_direction(rng)
    wires = of_wires(np.array([home, far, far + beside, home + beside]), places_m)
    return current[:, None, None] * wires, recorded(rng, [current])


def panels(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Charge from two panels, each as it is turned to the sun, behind clouds now and then."""
    height, azimuth = rng.uniform(0.3, 1.2), rng.uniform(0, 2 * np.pi)
    sun = np.array([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)])
    seen = np.einsum("nji,j->ni", scene.to_world, sun)
    clouds = 0.75 + 0.25 * np.tanh(2 * draw_wander(rng, scene.duration_s, int(rng.integers(8, 20)))(scene.time_s))
    total: FloatArray = np.zeros((scene.sample_count, len(places_m), 3))
    currents = []
    for _ in range(2):
        current = rng.uniform(3, 9) * clouds * (0.1 + np.maximum(seen @ draw_direction(rng), 0))
        path = mount.at(rng.uniform([0.0, -0.5, 0.0], [0.5, 0.5, 0.4]))
        sides = mount.distance_m * rng.uniform(0.05, 0.2) * np.array([draw_direction(rng), draw_direction(rng)])
        around = path + np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) @ sides
        total += current[:, None, None] * of_wires(around, places_m)
        currents.append(current)
    return total, recorded(rng, currents)


def heater(rng: Generator, scene: Scene, mount: Mount, places_m: FloatArray) -> tuple[FloatArray, Columns]:
    """Heat by a thermostat, on and off in turn, each for about as long as the time before."""
    period = scene.duration_s / rng.uniform(1.5, 8)
    spans = period * rng.uniform(0.9, 1.1, 40) * np.tile([rng.uniform(0.3, 0.7), 1.0], 20)
    is_on = np.searchsorted(np.cumsum(spans) - period * rng.random(), scene.time_s) % 2 == 1
    current = rng.uniform(2, 10) * is_on + rng.uniform(0.05, 0.5)
    home = mount.at(rng.uniform([0.0, 0.0, 0.0], [0.4, 0.3, 0.3]))
    sides = mount.distance_m * rng.uniform(0.03, 0.1) * np.array([draw_direction(rng), draw_direction(rng)])
    around = home + np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) @ sides
    return current[:, None, None] * of_wires(around, places_m), recorded(rng, [current])


def _dipoles(at_m: FloatArray, moment: FloatArray, places_m: FloatArray) -> FloatArray:
    """Return the field (N, P, 3) of moments (N, 3) at places (N, 3) or one [A m²]."""
    away = places_m - at_m[:, None]
    distance = norm(away, axis=2)[:, :, None]
    along = np.einsum("npi,ni->np", np.broadcast_to(away, (len(moment), *away.shape[1:])), moment)[:, :, None] * away
    return np.asarray(1e-7 * (3 * along / distance**5 - moment[:, None] / distance**3))


_CONDUCTORS: tuple[Source, ...] = (casks, blades, coils, net)
_KINDS: list[tuple[Source, ...]] = [
    *((one,) for one in (*_CONDUCTORS, trolley, strut, ram, tether, panels, heater)),
    (casks, heater),
    (net, ram),
    (coils, strut),
    (blades, panels),
]

LATER_VEHICLES = vehicles(_KINDS, _CONDUCTORS, (*MOVING, *VOYAGES))
"""By their names; their effect in a key is ``platform_field``."""
