"""The vehicle that carries an array: ellipsoids of iron and shells of metal along its hull, a rudder and a cable."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray, from_degrees
from tam_validation.blind.continuous_motion import about
from tam_validation.blind.disturbance import ALL, Disturbance, Signal, draw_direction
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene

_PERMEABILITY = 4e-7 * np.pi
"""μ0 in SI."""

_FINE = 6
"""Steps of the conductors' integration within one of the recording."""

_IRON_OVER_CURRENTS = (3.0, 8.0)
"""What the iron makes over what the currents make, at the scalar: not so much that its square counts."""


@dataclass(frozen=True, eq=False)
class Body:
    """A part of the hull: an ellipsoid of revolution.

    Parameters
    ----------
    place_m : (3,) array
        In the array's frame.
    along : (3,) array
        Unit vector of its axis.
    half_m, radius_m : float
        Half its length, and its radius.
    """

    place_m: FloatArray
    along: FloatArray
    half_m: float
    radius_m: float

    @property
    def volume_m3(self) -> float:
        """Of the solid."""
        return float(4 / 3 * np.pi * self.half_m * self.radius_m**2)

    def tensor(self, along: float, across: float) -> FloatArray:
        """Return the matrix (3, 3) with one value along the axis and another across."""
        own = np.outer(self.along, self.along)
        return along * own + across * (np.eye(3) - own)

    def magnetised(self, susceptibility: float, filled: float) -> FloatArray:
        """Return the moment (3, 3) of a unit field [A m²/T] of iron that fills a part of the volume.

        Source: Osborn, Demagnetizing factors of the general ellipsoid, Phys. Rev. 67, 1945, p. 351.
        """
        ratio = self.half_m / self.radius_m
        root = np.sqrt(ratio**2 - 1)
        lengthwise = (ratio / root * np.log(ratio + root) - 1) / root**2
        factors = np.array([lengthwise, (1 - lengthwise) / 2])
        along, across = filled * self.volume_m3 / _PERMEABILITY * susceptibility / (1 + susceptibility * factors)
        return self.tensor(along, across)

    def dipole(self, at_m: FloatArray) -> FloatArray:
        """Return the field (P, 3, 3) at places (P, 3) of a unit moment along each axis [T/(A m²)]."""
        away = at_m - self.place_m
        distance = norm(away, axis=1)[:, None, None]
        unit = away[:, :, None] / distance
        return np.asarray(1e-7 * (3 * unit * np.swapaxes(unit, 1, 2) - np.eye(3)) / distance**3)


def platform_field(rng: Generator, scene: Scene) -> Disturbance:
    """Carry the array on a vehicle: its iron, the currents in its shells, and now and then a rudder and a cable.

    The array is not far out on a boom, and the scalar at its centre or nearer to the hull.
    """
    arm = float(np.abs(scene.positions_m).max())
    toward, distance = draw_direction(rng), arm * rng.uniform(6, 14)
    scalar_m = toward * (distance * rng.uniform(0.2, 0.5) if rng.random() < 0.6 else 0.0)
    places = np.vstack([scene.positions_m, scalar_m])
    hull = _draw_hull(rng, toward, distance)
    shells = _shells(rng, scene, hull, places)
    iron = iron_of(rng, scene, hull, places)
    iron *= rng.uniform(*_IRON_OVER_CURRENTS) * size_of(shells) / size_of(iron)
    moved, columns = _moved(rng, scene, hull, places, size_of(shells))
    extra = (iron + shells + moved) * (1e-9 / size_of(shells + moved))
    parameters = {"distance_m": distance, "bodies": len(hull), "scalar_m": float(norm(scalar_m))}
    return Disturbance("platform_field", (ALL,), (), carried(scene, extra), "nT", parameters, columns=columns)


def carried(scene: Scene, extra_T: FloatArray) -> Callable[[float, Signal], Signal]:
    """Return the change of the readings by a field (N, K + 1, 3) at the sensors and the scalar, which is a length."""

    def change(amplitude: float, _seen: Signal) -> Signal:
        field = amplitude * extra_T
        intensity = norm(scene.field_T + field[:, -1], axis=1)
        return scene.through(field[:, :-1]), intensity - scene.intensity_T

    return change


def size_of(field: FloatArray) -> float:
    """Return the root of the mean square of what changes of fields (N, P, 3)."""
    return float(np.sqrt(np.mean((field - field.mean(axis=0)) ** 2)))


def _draw_hull(rng: Generator, toward: FloatArray, distance: float) -> list[Body]:
    """Draw the bodies along a hull, none nearer than a distance."""
    keel = np.cross(toward, draw_direction(rng))
    keel = keel / norm(keel)
    steps = np.linspace(-1, 1, int(rng.integers(2, 6))) * distance * rng.uniform(0.3, 1.0)
    half = distance * rng.uniform(0.1, 0.3)
    return [
        Body(toward * distance * rng.uniform(1, 1.3) + step * keel, keel, half, half / rng.uniform(1.5, 5))
        for step in steps
    ]


def iron_of(rng: Generator, scene: Scene, hull: list[Body], places: FloatArray) -> FloatArray:
    """Return the field (N, P, 3) of iron that keeps a moment and is magnetised by the Earth's field."""
    total = np.zeros((scene.sample_count, len(places), 3))
    for body in hull:
        induced = body.magnetised(rng.uniform(50, 300), rng.uniform(0.02, 0.1))
        kept = norm(induced) * scene.intensity_T.mean() * rng.uniform(0.3, 1.5) * draw_direction(rng)
        moment = scene.field_T @ induced.T + kept
        total += np.einsum("pij,nj->npi", body.dipole(places), moment)
    return total


def _shells(rng: Generator, scene: Scene, hull: list[Body], places: FloatArray) -> FloatArray:
    """Return the field (N, P, 3) of the currents in shells, of one resistance and inductance each.

    m' = -m / τ - A b', integrated in steps that are short against both; A is what a shell without resistance would
    answer to a change, of a sphere -2π r³ / μ0.
    """
    lag_s = scene.step_s * 10 ** rng.uniform(-0.5, 0.6)
    total = np.zeros((scene.sample_count, len(places), 3))
    for body in hull:
        own_s = lag_s * rng.uniform(0.8, 1.25)
        fine_s = np.arange(-8 * own_s, scene.duration_s + scene.step_s, min(scene.step_s, own_s) / _FINE)
        field = scene.field_at(fine_s)
        answer = -1.5 * body.volume_m3 / _PERMEABILITY * body.tensor(*rng.uniform(0.5, 1.0, 2))
        moment = driven(np.diff(field, axis=0) @ answer.T, float(fine_s[1] - fine_s[0]), own_s)
        sampled = np.stack([np.interp(scene.time_s, fine_s, one) for one in moment.T], axis=1)
        total += np.einsum("pij,nj->npi", body.dipole(places), sampled)
    return total


def driven(steps: FloatArray, step_s: float, time_constant_s: float) -> FloatArray:
    """Return (n + 1, 3) what steps (n, 3) drive and a resistance damps, by the trapezoidal rule from nothing."""
    half = step_s / (2 * time_constant_s)
    keep, gain = (1 - half) / (1 + half), 1 / (1 + half)
    now, course = np.zeros(3), [np.zeros(3)]
    for step in steps:
        now = keep * now + gain * step
        course.append(now)
    return np.array(course)


def _moved(
    rng: Generator, scene: Scene, hull: list[Body], places: FloatArray, size: float
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return the field (N, P, 3) of a rudder of iron and of a motor's cable, either now and then, and their columns."""
    total: FloatArray = np.zeros((scene.sample_count, len(places), 3))
    columns: dict[str, FloatArray] = {}
    if rng.random() < 0.4:
        angle = from_degrees(rng.uniform(5, 12)) * np.tanh(draw_wander(rng, scene.duration_s, 12)(scene.time_s))
        turn, blade = about("z", angle), hull[-1]
        induced = blade.magnetised(rng.uniform(50, 300), 0.05)
        kept = norm(induced) * scene.intensity_T.mean() * rng.uniform(0.5, 2.0) * draw_direction(rng)
        in_blade = np.einsum("nji,nj->ni", turn, scene.field_T) @ induced.T + kept
        moment = np.einsum("nij,nj->ni", turn, in_blade) - (scene.field_T @ induced.T + kept)
        field = np.einsum("pij,nj->npi", blade.dipole(places), moment)
        total += field * (size * rng.uniform(0.5, 1.5) / size_of(field))
        columns["actuator_rudder"] = np.round(angle + rng.normal(0, 2e-4, len(angle)), 5)
    if rng.random() < 0.3:
        load = 4 + 3 * np.sign(draw_wander(rng, scene.duration_s, 10)(scene.time_s))
        loop = hull[0].dipole(places) @ draw_direction(rng)
        field = load[:, None, None] * loop
        total += field * (size * rng.uniform(0.5, 1.5) / size_of(field))
        columns["current_2_A"] = np.round(load + rng.normal(0, 0.01, len(load)), 4)
    return total, columns
