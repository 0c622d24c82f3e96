"""Conductors of vehicles of other kinds: loops with inductance and resistance, solid spheres and cylinders."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from scipy.linalg import eigh
from scipy.signal import lfilter
from scipy.special import ellipe, ellipk, jn_zeros

from tam_calibration.model.units import FloatArray
from tam_calibration.validation.blind.scene import Scene
from tam_calibration.validation.blind.vehicle import PERMEABILITY, Body

_FINE = 12
"""Steps, within one of the recording, through which the field is taken to change evenly."""

_SETTLED = 8.0
"""Longest time constants before the recording from which on currents flow."""

_MODES = 12
"""Of solid bodies: what is left out decays within a hundredth of the first one's time."""

SLOWEST_ACROSS = float(jn_zeros(0, 1)[0])
"""Zero of Bessel's function: a cylinder's slowest time constant is μ0 σ times the square of its radius over this."""


def faded(scene: Scene, time_constants_s: FloatArray) -> FloatArray:
    """Return what is left (M, N, 3) of all changes of the field, which fade with each of the time constants (M,).

    y' = b' - y / τ, exact where the field changes evenly through a fine step.
    """
    step_s = scene.step_s / _FINE
    fine_s = np.arange(-_SETTLED * time_constants_s.max(), scene.duration_s + scene.step_s, step_s)
    changes = np.diff(scene.field_at(fine_s), axis=0)
    left = []
    for constant in time_constants_s:
        keep = np.exp(-step_s / constant)
        course = lfilter([constant / step_s * (1 - keep)], [1, -keep], changes, axis=0)
        left.append([np.interp(scene.time_s, fine_s[1:], one) for one in course.T])
    return np.swapaxes(np.array(left), 1, 2)


@dataclass(frozen=True, eq=False)
class Loops:
    """Closed circuits of straight wires, in which only the change of the flux drives currents.

    Parameters
    ----------
    corners_m : (M, S, 3) array
        Of each circuit, in order.
    inductance_H : (M, M) array
        Of each, and between them.
    resistance_ohm : (M, M) array
        Of each, and less that of wires which two share.
    """

    corners_m: FloatArray
    inductance_H: FloatArray
    resistance_ohm: FloatArray

    @property
    def areas_m2(self) -> FloatArray:
        """Vectors (M, 3) whose product with a uniform field is its flux."""
        ahead = np.roll(self.corners_m, -1, axis=1)
        return np.asarray(np.cross(self.corners_m, ahead).sum(axis=1) / 2)

    def field(self, scene: Scene, places_m: FloatArray) -> FloatArray:
        """Return the field (N, P, 3) of the currents at places (P, 3): L i' + R i = -Φ', by its modes."""
        constants, modes = eigh(self.inductance_H, self.resistance_ohm)
        drive = modes.T @ self.areas_m2
        currents = -np.einsum("mnj,mj,m->nm", faded(scene, constants), drive, 1 / constants) @ modes.T
        return np.asarray(np.einsum("pjm,nm->npj", self.per_ampere(places_m), currents))

    def per_ampere(self, places_m: FloatArray) -> FloatArray:
        """Return the field (P, 3, M) of one ampere in each circuit."""
        return np.stack([of_wires(np.vstack([one, one[:1]]), places_m) for one in self.corners_m], axis=2)


def of_wires(path_m: FloatArray, places_m: FloatArray) -> FloatArray:
    """Return the field (P, 3) of an ampere along a path (S + 1, 3), by Biot and Savart."""
    away = places_m[:, None] - path_m
    distance = norm(away, axis=2)
    begin, end, near, far = away[:, :-1], away[:, 1:], distance[:, :-1], distance[:, 1:]
    size = (1 / near + 1 / far) / (near * far + np.sum(begin * end, axis=2))
    return np.asarray(PERMEABILITY / (4 * np.pi) * np.sum(np.cross(begin, end) * size[:, :, None], axis=1))


def neumann(path_m: FloatArray, other_m: FloatArray) -> float:
    """Return the mutual inductance of two closed polygons (S, 3) that are some edges apart, by Neumann's integral."""
    (middle, edge), (far, opposite) = (
        ((one + np.roll(one, -1, axis=0)) / 2, np.roll(one, -1, axis=0) - one) for one in (path_m, other_m)
    )
    distance = norm(middle[:, None] - far, axis=2)
    return float(PERMEABILITY / (4 * np.pi) * np.sum(edge @ opposite.T / distance))


def ribs(along_m: FloatArray, across_m: FloatArray, up_m: FloatArray, wire_m: float, ohm_per_m: float) -> Loops:
    """Return equal rectangles behind each other, one lengthwise upright through their axis and one lying.

    The last two have no flux of the ribs or of each other, by symmetry. Source of the inductances of parallel and of
    closed edges: Grover, Inductance Calculations, Dover, 1946, chapters 5 and 7.

    Parameters
    ----------
    along_m : (M, 3) array
        Centres of the ribs, on a straight line at even distances.
    across_m, up_m : (3,) array
        Half the edges of a rib.
    wire_m, ohm_per_m : float
        Radius of the tubes, and their resistance.
    """
    middle, half = along_m.mean(axis=0), (along_m[-1] - along_m[0]) / 2
    frames = [(centre, across_m, up_m) for centre in along_m] + [(middle, half, across_m), (middle, up_m, half)]
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    corners = np.array([[centre + s * one + t * other for s, t in signs] for centre, one, other in frames])
    edges = 2 * np.array([[norm(one), norm(other)] for _, one, other in frames])
    count = len(along_m)
    inductance: FloatArray = np.diag([_of_rectangle(width, height, wire_m) for width, height in edges])
    apart = norm(along_m[:, None] - along_m, axis=2)
    width, height = edges[0]
    for one, other in zip(*np.triu_indices(count, 1), strict=True):
        gap = apart[one, other]
        between = sum(
            2 * (_parallel(edge, gap) - _parallel(edge, np.hypot(gap, opposite)))
            for edge, opposite in ((width, height), (height, width))
        )
        inductance[one, other] = inductance[other, one] = between
    return Loops(corners, inductance, np.diag(ohm_per_m * 2 * edges.sum(axis=1)))


def _of_rectangle(width_m: float, height_m: float, wire_m: float) -> float:
    """Return the inductance of a rectangle of tubes, in which the current flows at the surface."""
    edges = ((width_m, height_m), (height_m, width_m))
    return sum(2 * (_parallel(edge, wire_m) - _parallel(edge, opposite)) for edge, opposite in edges)


def _parallel(edge_m: float, apart_m: float) -> float:
    """Return the mutual inductance of parallel wires side by side; with a tube's radius, that of the tube itself."""
    ratio = edge_m / apart_m
    return float(PERMEABILITY / (2 * np.pi) * (edge_m * np.arcsinh(ratio) - np.hypot(edge_m, apart_m) + apart_m))


def disc(centre_m: FloatArray, normal: FloatArray, radius_m: float, ohm: float, rings: int = 6) -> Loops:
    """Return a thin plate, round, as rings beside each other.

    Source of the inductances: Maxwell, A Treatise on Electricity and Magnetism, 1873, article 701.

    Parameters
    ----------
    centre_m, normal : (3,) array
    radius_m : float
    ohm : float
        Resistance of a square of it.
    rings : int
    """
    width = radius_m / rings
    radii = width * (np.arange(rings) + 0.5)
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= norm(first)
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)[:, None]
    circle = np.cos(angle) * first + np.sin(angle) * np.cross(normal, first)
    one, other = np.meshgrid(radii, radii)
    # A flat ribbon has the inductance of a wire of 0.2235 of its width: its mean distance from itself.
    squared = 4 * one * other / ((one + other) ** 2 + np.where(one == other, 0.2235 * width, 0) ** 2)
    root = np.sqrt(squared)
    inductance = (
        PERMEABILITY * np.sqrt(one * other) * ((2 / root - root) * ellipk(squared) - 2 / root * ellipe(squared))
    )
    return Loops(centre_m + radii[:, None, None] * circle, inductance, np.diag(ohm * 2 * np.pi * radii / width))


def of_sphere(
    scene: Scene, places_m: FloatArray, centre_m: FloatArray, radius_m: float, conductivity: float
) -> FloatArray:
    """Return the field (N, P, 3) of the currents in a solid sphere [S/m], by its modes.

    Source: Landau, Lifshitz, Electrodynamics of Continuous Media, 2nd edition, Pergamon, 1984, section 59.
    """
    orders = np.pi * np.arange(1, _MODES + 1)
    constants = PERMEABILITY * conductivity * radius_m**2 / orders**2
    moments = -2 * np.pi * radius_m**3 / PERMEABILITY * np.einsum("m,mnj->nj", 6 / orders**2, faded(scene, constants))
    dipole = Body(centre_m, np.array([1.0, 0, 0]), radius_m, radius_m).dipole(places_m)
    return np.asarray(np.einsum("pij,nj->npi", dipole, moments))


def of_cylinder(
    scene: Scene, places_m: FloatArray, ends_m: FloatArray, radius_m: float, conductivity: float
) -> FloatArray:
    """Return the field (N, P, 3) of the currents in a long solid cylinder between two ends (2, 3) [S/m], by its modes.

    Each length of it answers as one without end: across twice as strongly as along. Source as of the sphere.
    """
    orders = jn_zeros(0, _MODES)
    constants = PERMEABILITY * conductivity * radius_m**2 / orders**2
    length = float(norm(ends_m[1] - ends_m[0]))
    axis = (ends_m[1] - ends_m[0]) / length
    answer = -np.pi * radius_m**2 * length / PERMEABILITY * (2 * np.eye(3) - np.outer(axis, axis))
    moments = np.einsum("m,mnj->nj", 4 / orders**2, faded(scene, constants)) @ answer
    parts = ends_m[0] + (np.arange(8) + 0.5)[:, None] / 8 * (ends_m[1] - ends_m[0])
    dipole = np.mean([Body(part, axis, length, radius_m).dipole(places_m) for part in parts], axis=0)
    return np.asarray(np.einsum("pij,nj->npi", dipole, moments))
