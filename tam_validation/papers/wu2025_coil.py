"""Wu 2025 Fig. 12: the coil located by constrained Euler localisation before and after calibration, section 4.2.

The array turns about its z axis in twelve headings, 2.64 m from a coil of 0.82 m and 0.96 m diameter. The paper does
not print how the coil was turned. Alternating fields of 10 Hz are taken as amplitudes: bias and drift do not enter, and
noise of 0.015 nT/√Hz moves nothing here.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import inv, norm, solve
from scipy.special import ellipe, ellipk

from tam_calibration.localization.euler import locate
from tam_calibration.model.array import Array
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.sources.dipole import VACUUM_PERMEABILITY, area_of, loop_field
from tam_validation.papers.cross import SetUp

POSITION_M = np.array([2.40, -1.00, 0.46])
RADIUS_M = (0.82 + 0.96) / 4
AMPERE_TURNS = 708.0
"""From 10 G at the centre with 3.3 A: 2 a B/μ₀, at that current."""
FREQUENCY_HZ = 10.0
HEADINGS_DEG = 30.0 * np.arange(12)
AXES = ("x", "y", "z", "r")


def directions(count: int, generator: np.random.Generator) -> FloatArray:
    """Return (count, 3) axes of the coil, drawn at random."""
    axes = generator.normal(size=(count, 3))
    return np.asarray(axes / norm(axes, axis=1, keepdims=True))


_RINGS = 12
"""Into which a plate is divided; more change the amplitude of its field by less than a hundredth."""
_CONDUCTIVITY = 3.5e7
"""Of aluminium, S/m."""


@dataclass(frozen=True)
class Plate:
    """A round plate of aluminium under the array, as a turntable has, in which the coil drives eddy currents.

    The currents flow in rings that see one another and the field at the plate's centre along z: (R + iωL) I = -iω Φ.

    Parameters
    ----------
    radius_m, thickness_m : float
    below_m : float
        From the array's centre down to the plate.
    """

    radius_m: float
    thickness_m: float
    below_m: float

    @classmethod
    def drawn(cls, generator: np.random.Generator) -> "Plate":
        """Return a plate of a size that such a table may have; the paper prints none."""
        return cls(generator.uniform(0.1, 0.3), generator.uniform(0.005, 0.03), generator.uniform(0.05, 0.3))

    @cached_property
    def rings_m(self) -> FloatArray:
        """Radii (rings,)."""
        return self.radius_m * (np.arange(_RINGS) + 0.5) / _RINGS

    @cached_property
    def currents_A(self) -> FloatArray:
        """Complex currents (rings,) in a field of 1 T along z at the centre."""
        radius, width = self.rings_m, self.radius_m / _RINGS
        one, other = np.meshgrid(radius, radius)
        modulus = 4 * one * other / (one + other) ** 2
        # Maxwell's mutual inductance of coaxial circles; of a ring with itself at its geometric mean distance.
        apart = 0.2235 * (width + self.thickness_m)
        np.fill_diagonal(modulus, 4 * radius**2 / (4 * radius**2 + apart**2))
        root = np.sqrt(modulus)
        inductance = VACUUM_PERMEABILITY * np.sqrt(one * other)
        inductance = inductance * ((2 / root - root) * ellipk(modulus) - 2 / root * ellipe(modulus))
        resistance = 2 * np.pi * radius / (_CONDUCTIVITY * width * self.thickness_m)
        angular = 2 * np.pi * FREQUENCY_HZ
        return np.asarray(solve(np.diag(resistance) + 1j * angular * inductance, -1j * angular * np.pi * radius**2))

    def field(self, points_m: FloatArray) -> FloatArray:
        """Return the complex field (P, 3) of these currents at points (P, 3) from the array's centre, tesla."""
        offset = points_m + np.array([0, 0, self.below_m])
        fields = [loop_field(offset, np.array([0, 0, area_of(r)]), radius_m=r)[0] for r in self.rings_m]
        return np.asarray(np.einsum("r,rpi->pi", self.currents_A, fields))


@dataclass(frozen=True, eq=False)
class Experiment:
    """The array before the coil.

    Parameters
    ----------
    array : Array
        As stated.
    errors : SensorErrors
        The truth.
    estimates : dict
        What the readings are corrected with, by the names of stages.
    """

    array: Array
    errors: SensorErrors
    estimates: dict[str, SensorErrors]

    @classmethod
    def of(cls, case: SetUp, found: SensorErrors) -> "Experiment":
        """Return the experiment of an array before its calibration and after it."""
        none = SensorErrors.none(case.array.sensor_count)
        return cls(case.array, case.errors, {"before": none, "after": found})

    def rmse_m(self, stage: str, axes: FloatArray, plate: Plate | None = None) -> FloatArray:
        """Return the root mean square errors of the position over the headings.

        x, y and z are those of the turntable at rest, in which the paper prints the position; r is the distance.

        Parameters
        ----------
        stage : str
            One of the estimates.
        axes : (O, 3) array
            Unit vectors along the axis of the coil, in the frame of the turntable at rest.
        plate : Plate, optional
            Of metal, that turns with the array.

        Returns
        -------
        (O, 4) array
            Errors of ``AXES`` for each direction of the coil, metres.
        """
        turns = _turns(from_degrees(HEADINGS_DEG))
        fields = np.einsum("kij,ohkj->ohki", inv(self.estimates[stage].matrix), self._raw(axes, turns, plate))
        found = locate(fields.reshape(-1, 3 * self.array.sensor_count) @ self.array.operator.T)
        positions = np.einsum("hij,ohj->ohi", turns, found.position_m.reshape(len(axes), -1, 3))
        distance = norm(positions, axis=2) - norm(POSITION_M)
        error = np.concatenate([positions - POSITION_M, distance[..., None]], axis=2)
        return np.asarray(np.sqrt(np.mean(error**2, axis=1)))

    def _raw(self, axes: FloatArray, turns: FloatArray, plate: Plate | None) -> FloatArray:
        """Return the (O, 12, K, 3) raw amplitudes; with a plate those of the part in phase with the coil's current."""
        points = np.einsum("hij,kj->hki", turns, self.array.positions_m)
        moment = AMPERE_TURNS * area_of(RADIUS_M) * axes[:, None]

        def coil(at_m: FloatArray) -> FloatArray:
            return loop_field(at_m - POSITION_M, moment, radius_m=RADIUS_M)[0]

        world = coil(points.reshape(-1, 3)).reshape(len(axes), *points.shape)
        if plate is not None:
            driving = coil(np.array([[0, 0, -plate.below_m]]))[:, 0, 2]
            world = world + driving[:, None, None, None] * plate.field(points.reshape(-1, 3)).real.reshape(points.shape)
        return np.asarray(np.einsum("kai,hji,ohkj->ohka", self.errors.matrix, turns, world, optimize=True))


def _turns(angles: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("z", angles[:, None]).as_matrix())
