"""The sources' common part, and the magnetic dipole: its field, gradient, and derivative by the moment."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.model.units import FloatArray

VACUUM_PERMEABILITY = 1.25663706127e-6
"""μ₀, T m/A, CODATA 2022. That of ``scipy.constants`` takes a third of the time in which a command starts."""


@dataclass(frozen=True, eq=False)
class Source(ABC):
    """A magnetic source at rest.

    Parameters
    ----------
    position_m : (3,) array
        Its centre, metres, in the frame of the points at which its field is asked for.
    moment_Am2 : (3,) array
        Magnetic moment in the same frame, A m².
    """

    position_m: FloatArray
    moment_Am2: FloatArray

    @abstractmethod
    def from_offset(self, offset_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return field, gradient and the field's derivative by the moment at offsets (…, 3) from the source, SI."""

    def field_T(self, points_m: FloatArray) -> FloatArray:
        """Return the field (…, 3) at points (…, 3), tesla."""
        return self.from_offset(points_m - self.position_m)[0]

    def gradient_T_per_m(self, points_m: FloatArray) -> FloatArray:
        """Return the symmetric, trace-free gradient tensor (…, 3, 3) at points (…, 3), T/m."""
        return self.from_offset(points_m - self.position_m)[1]


_STRENGTH = VACUUM_PERMEABILITY / (4 * np.pi)
"""μ₀/4π, T m/A."""


@dataclass(frozen=True, eq=False)
class Dipole(Source):
    """A magnetic dipole at rest; place and moment are those of ``Source``."""

    def from_offset(self, offset_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what ``dipole_field`` does for its moment."""
        return dipole_field(offset_m, self.moment_Am2)


def dipole_field(offset_m: FloatArray, moment_Am2: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the field μ₀/4π (3 (m·n) n - m)/r³, its gradient, and its derivative by the moment.

    Parameters
    ----------
    offset_m : (…, 3) array
        From the dipole to the point, metres.
    moment_Am2 : (…, 3) array
        Magnetic moment, A m².

    Returns
    -------
    field : (…, 3) array
        Tesla.
    gradient : (…, 3, 3) array
        T/m.
    by_moment : (…, 3, 3) array
        Rows of the field, columns of the moment, T/(A m²).
    """
    # Components first: loops then run over the points, and not over three numbers each.
    both = np.broadcast_arrays(offset_m, moment_Am2)
    offset, moment = (np.ascontiguousarray(np.moveaxis(each, -1, 0)) for each in both)
    square = np.sum(offset**2, axis=0)
    distance = np.sqrt(square)
    unit = offset / distance
    along = np.sum(unit * moment, axis=0)
    near = _STRENGTH / (square * distance)
    steep = 3 * near / distance
    crossed = unit[:, None] * (steep * (moment - 2.5 * along * unit))
    gradient = crossed + np.swapaxes(crossed, 0, 1)
    by_moment = (3 * near * unit)[:, None] * unit
    for axis in range(3):
        gradient[axis, axis] += steep * along
        by_moment[axis, axis] -= near
    field = near * (3 * along * unit - moment)
    last = [np.moveaxis(field, 0, -1), *(np.moveaxis(each, (0, 1), (-2, -1)) for each in (gradient, by_moment))]
    field, gradient, by_moment = map(np.ascontiguousarray, last)
    return field, gradient, by_moment


def moment_of_field(offset_m: FloatArray, field_T: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the moment of the dipole that makes a given field, and its derivatives.

    As n nᵀ is a projection, the inverse of 3 n nᵀ - 1 is (3/2) n nᵀ - 1.

    Parameters
    ----------
    offset_m : (…, 3) array
        From the dipole to the point, metres.
    field_T : (…, 3) array
        Field of the dipole at the point, tesla.

    Returns
    -------
    moment : (…, 3) array
        Magnetic moment, A m².
    by_offset : (…, 3, 3) array
        Rows of the moment, columns of the offset, A m.
    by_field : (…, 3, 3) array
        Rows of the moment, columns of the field, A m²/T.
    """
    distance = norm(offset_m, axis=-1)[..., None, None]
    column, field = offset_m[..., :, None], field_T[..., :, None]
    row = np.swapaxes(column, -1, -2)
    unit = row / distance
    along = row @ field
    by_field = (1.5 * distance * column @ row - distance**3 * np.eye(3)) / _STRENGTH
    by_offset = (
        1.5 * distance * (along * np.eye(3) + column @ np.swapaxes(field, -1, -2))
        + 1.5 * along * column @ unit
        - 3 * distance**2 * field @ unit
    ) / _STRENGTH
    return (by_field @ field)[..., 0], by_offset, by_field
