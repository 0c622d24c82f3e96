"""How a vehicle of any kind carries the array, and what its field is made of: sources of its own beside iron."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_calibration.validation.blind.disturbance import ALL, Disturbance, Entry, draw_direction
from tam_calibration.validation.blind.scene import Scene
from tam_calibration.validation.blind.vehicle import IRON_OVER_CURRENTS, Body, carried, iron_of, size_of

CONDUCTIVITIES = (1.4e6, 1.6e7, 2.5e7, 5.8e7)
"""Of stainless steel, brass, an alloy of aluminium, and copper, S/m."""

Columns = dict[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Mount:
    """How a vehicle carries the array, about whose centre all is.

    Parameters
    ----------
    name : str
    nearest_m : (3,) array
        The part of the vehicle that is nearest to the array.
    along, across, up : (3,) array
        Axes of the vehicle: unit vectors, the first from that part on.
    scalar_m : (3,) array
    distance_m : float
    """

    name: str
    nearest_m: FloatArray
    along: FloatArray
    across: FloatArray
    up: FloatArray
    scalar_m: FloatArray
    distance_m: float

    @property
    def away(self) -> FloatArray:
        """Unit vector (3,) from the array to the vehicle."""
        return np.asarray(self.nearest_m / self.distance_m)

    def at(self, place: FloatArray | tuple[float, float, float], reach_m: float = 0.0) -> FloatArray:
        """Return where a place (3,) is, along, across and up from the nearest part in distances of the array.

        What reaches from there toward the array is so much farther.
        """
        axes = np.array([self.along, self.across, self.up])
        return np.asarray(self.nearest_m + self.distance_m * (np.asarray(place) @ axes) + reach_m * self.away)


def draw_mount(rng: Generator, arm_m: float) -> Mount:
    """Draw a boom behind the hull, a pod under a wing, or a body that is towed beneath a tug."""
    name = str(rng.choice(["boom", "pod", "tow"]))
    toward = draw_direction(rng)
    sideways = np.cross(toward, draw_direction(rng))
    sideways /= norm(sideways)
    other = np.cross(toward, sideways)
    if name == "boom":
        distance, axes, scalar = arm_m * rng.uniform(5, 12), (toward, sideways, other), rng.uniform(0.2, 0.5)
    elif name == "pod":
        distance, axes, scalar = arm_m * rng.uniform(5, 10), (sideways, toward, other), rng.choice([0.0, 0.3])
    else:
        distance, axes, scalar = arm_m * rng.uniform(9, 18), (sideways, other, toward), rng.choice([0.0, -0.15])
    return Mount(name, toward * distance, *axes, toward * distance * scalar, distance)


Source = Callable[[Generator, Scene, Mount, FloatArray], tuple[FloatArray, Columns]]


def recorded(rng: Generator, currents: list[FloatArray]) -> Columns:
    """Return the columns of currents, from the second on, as a shunt measures them."""
    return {
        f"current_{number}_A": np.round(one + rng.normal(0, 0.01, len(one)), 4)
        for number, one in enumerate(currents, start=2)
    }


def carrying(*sources: Source, is_bounded: bool) -> Callable[[Generator, Scene], Disturbance]:
    """Return what draws a vehicle with these sources, beside its iron; of several each is as strong as the first.

    Parameters
    ----------
    *sources : callable
    is_bounded : bool
        Whether the first is a conductor, which answers by no more than it does in nature.
    """

    def draw(rng: Generator, scene: Scene) -> Disturbance:
        mount = draw_mount(rng, float(np.abs(scene.positions_m).max()))
        places = np.vstack([scene.positions_m, mount.scalar_m])
        drawn = [source(rng, scene, mount, places) for source in sources]
        size = size_of(drawn[0][0])
        own = sum(field * (size / size_of(field)) for field, _ in drawn)
        iron = iron_of(rng, scene, _hull(mount), places)
        iron *= rng.uniform(*IRON_OVER_CURRENTS) * size / size_of(iron)
        parameters = {"mount": mount.name, "distance_m": mount.distance_m, "scalar_m": float(norm(mount.scalar_m))}
        change = carried(scene, (own + iron) * (1e-9 / size))
        columns = {name: values for _, own_columns in drawn for name, values in own_columns.items()}
        cause = Disturbance("platform_field", (ALL,), (), change, "nT", parameters, columns=columns)
        return replace(cause, largest_amplitude=size * 1e9) if is_bounded else cause

    return draw


def _hull(mount: Mount) -> list[Body]:
    """Return two bodies of iron, in which neither currents flow nor anything moves."""
    half, radius = mount.distance_m / 4, mount.distance_m / 10
    return [Body(mount.at((along, 0, 0.2)), mount.along, half, radius) for along in (0.3, 0.9)]


def vehicles(
    kinds: Iterable[tuple[Source, ...]], conductors: tuple[Source, ...], motions: tuple[str, ...]
) -> dict[str, Entry]:
    """Return the entries of vehicles with each of some tuples of sources, under way in some motions, by their names."""
    return {
        f"vehicle_with_{'_and_'.join(source.__name__ for source in sources)}": Entry(
            carrying(*sources, is_bounded=sources[0] in conductors),
            "motion",
            motions=motions,
            sensor_counts=(4, 6),
            scalar_needed=True,
            large=(30.0,),
        )
        for sources in kinds
    }
