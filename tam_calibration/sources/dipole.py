"""The magnetic dipole and the circular loop of current: field, gradient, and derivative by the moment.

Of the loop: with the ring integrals J_n = ∫ cosⁿφ/D^(3/2) dφ and L_n = ∫ cosⁿφ/D^(5/2) dφ over 0 to π, D = a² + ρ² + z²
- 2aρ cosφ, the law of Biot and Savart gives B_ρ = c a z J₁ and B_z = c a (a J₀ - ρ J₁), c = μ₀I/2π. They are complete
elliptic integrals of the parameter m = 4aρ/((a+ρ)² + z²), written so that nothing is divided by ρ or m: the axis and
the far field lose no digits.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.linalg import norm

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.sensor_errors import crossing
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
        """Return the field (…, 3) at points (…, 3), tesla.

        Raises
        ------
        InputError
            When it is not finite, as at the place of the source.
        """
        return self._finite(points_m)[0]

    def gradient_T_per_m(self, points_m: FloatArray) -> FloatArray:
        """Return the symmetric, trace-free gradient tensor (…, 3, 3) at points (…, 3), T/m.

        Raises
        ------
        InputError
            When it is not finite, as at the place of the source.
        """
        return self._finite(points_m)[1]

    def _finite(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        with np.errstate(all="ignore"):
            found = self.from_offset(points_m - self.position_m)
        if not all(np.isfinite(each).all() for each in found):
            raise InputError(
                "the field of the source is not finite: it lies at a sensor or the array's centre, or has no size"
            )
        return found


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
    offset, moment = map(_components, np.broadcast_arrays(offset_m, moment_Am2))
    unit, distance, near, by_moment = _by_moment(offset)
    along = np.sum(unit * moment, axis=0)
    steep = 3 * near / distance
    crossed = unit[:, None] * (steep * (moment - 2.5 * along * unit))
    gradient = crossed + np.swapaxes(crossed, 0, 1)
    for axis in range(3):
        gradient[axis, axis] += steep * along
    field = near * (3 * along * unit - moment)
    field, gradient, by_moment = (np.ascontiguousarray(each.T) for each in (field, gradient, by_moment))
    return field, gradient, by_moment


def field_alone(offset_m: FloatArray, moment_Am2: FloatArray) -> FloatArray:
    """Return the first of what ``dipole_field`` does, (…, 3), in tesla."""
    offset, moment = map(_components, np.broadcast_arrays(offset_m, moment_Am2))
    square = np.sum(offset**2, axis=0)
    along = 3 * np.sum(offset * moment, axis=0) / square
    return np.asarray(((along * offset - moment) * (_STRENGTH / (square * np.sqrt(square)))).T)


def field_by_moment(offset_m: FloatArray) -> FloatArray:
    """Return the third of what ``dipole_field`` does, (…, 3, 3), in T/(A m²)."""
    return _by_moment(_components(offset_m))[3].T


def _components(vectors: FloatArray) -> FloatArray:
    """Return vectors (…, 3) with components first: loops then run over the points, and not over three numbers each.

    All axes are reversed. So they are again by the transpose of a field, and of a matrix (3, 3, …), which is symmetric.
    """
    return np.ascontiguousarray(vectors.T)


def _by_moment(offset: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return unit vector, distance, strength of a moment there, and the field's derivative by it, (3, 3, …)."""
    square = np.sum(offset**2, axis=0)
    distance = np.sqrt(square)
    unit = offset / distance
    near = _STRENGTH / (square * distance)
    by_moment = (3 * near * unit)[:, None] * unit
    for axis in range(3):
        by_moment[axis, axis] -= near
    return unit, distance, near, by_moment


def moment_of_field(offset_m: Any, field_T: Any) -> Any:
    """Return the moment of the dipole that makes a given field.

    As n nᵀ is a projection, the inverse of 3 n nᵀ - 1 is (3/2) n nᵀ - 1.

    Parameters
    ----------
    offset_m : (…, 3) array
        From the dipole to the point, metres.
    field_T : (…, 3) array
        Field of the dipole at the point, tesla.

    Returns
    -------
    (…, 3) array
        Magnetic moment, A m².
    """
    square = np.sum(offset_m**2, axis=-1, keepdims=True)
    along = np.sum(offset_m * field_T, axis=-1, keepdims=True)
    return np.sqrt(square) * (1.5 * along * offset_m - square * field_T) / _STRENGTH


@dataclass(frozen=True, eq=False)
class Loop(Source):
    """A circular loop of current at rest; its moment is along its axis, current times turns times area.

    Parameters
    ----------
    position_m, moment_Am2 : (3,) array
        As of every ``Source``, metres and A m².
    radius_m : float
        Of the circle, metres.
    """

    radius_m: float

    @property
    def current_A(self) -> float:
        """Current times turns, ampere."""
        return float(norm(self.moment_Am2) / area_of(self.radius_m))

    def from_offset(self, offset_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what ``loop_field`` does for its moment and radius."""
        return loop_field(offset_m, self.moment_Am2, self.radius_m)


def area_of(radius_m: float) -> float:
    """Return the area of a circle, m²."""
    return float(np.pi * radius_m**2)


def loop_field(
    offset_m: FloatArray, moment_Am2: FloatArray, radius_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return field, gradient and the derivative of the field by the moment.

    Parameters
    ----------
    offset_m : (…, 3) array
        From the centre of the loop to the point, metres; not on the wire.
    moment_Am2 : (…, 3) array
        Magnetic moment, A m², not zero.
    radius_m : float
        Of the circle, metres.

    Returns
    -------
    field, gradient, by_moment : (…, 3), (…, 3, 3), (…, 3, 3) array
        As of ``dipole_field``: T, T/m, T/(A m²).
    """
    moment = np.asarray(moment_Am2)
    strength = norm(moment, axis=-1)[..., None, None]
    axis = moment / strength[..., 0]
    z = np.sum(offset_m * axis, axis=-1)[..., None, None]
    across = offset_m - z[..., 0] * axis
    rho = norm(across, axis=-1)[..., None, None]
    outwards = np.divide(across, rho[..., 0], out=np.zeros_like(across), where=rho[..., 0] > 0)
    j0, j1, l1, l2, difference = _ring_integrals(rho, z, radius_m)
    unit = VACUUM_PERMEABILITY * strength / (2 * np.pi**2 * radius_m)
    along = (unit * (radius_m * j0 - rho * j1))[..., 0]
    field = (unit * z * j1)[..., 0] * outwards + along * axis
    # Of ∂B_ρ/∂ρ, B_ρ/ρ and ∂B_ρ/∂z; trace and curl give the others.
    along_rho, around, along_z = 3 * z * (radius_m * l2 - rho * l1), 3 * radius_m * z * difference, j1 - 3 * z**2 * l1
    mixed = outwards[..., :, None] * axis[..., None, :]
    gradient = unit * (
        (along_rho - around) * outwards[..., :, None] * outwards[..., None, :]
        + around * np.eye(3)
        - (along_rho + 2 * around) * axis[..., :, None] * axis[..., None, :]
        + along_z * (mixed + np.swapaxes(mixed, -1, -2))
    )
    # A turn ω of the loop turns its field and moves the point in its frame: dB = ω × B - G (ω × offset).
    turned = (gradient @ crossing(offset_m) - crossing(field)) @ crossing(moment) / strength**2
    return field, gradient, field[..., :, None] * axis[..., None, :] / strength + turned


def _ring_integrals(rho: FloatArray, z: FloatArray, radius: float) -> tuple[FloatArray, ...]:
    """Return the ring integrals J₀, J₁, L₁ and L₂, and the difference L₀ - L₂."""
    from scipy.special import ellipe, ellipkm1, hyp2f1

    far, near = (radius + rho) ** 2 + z**2, (radius - rho) ** 2 + z**2
    m, rest = 4 * radius * rho / far, near / far
    k, e = ellipkm1(rest), ellipe(m)
    # (K - E)/m - C, with C the complete integral of sin² cos² over (1 - m sin²)^(3/2)
    part = np.pi * (hyp2f1(0.5, 1.5, 2, m) / 4 - hyp2f1(1.5, 1.5, 3, m) / 16)
    j0 = 2 * e / (np.sqrt(far) * near)
    j1 = 2 * m * part / (np.sqrt(far) * near)
    difference = 8 * part / (3 * far**1.5 * near)
    l2 = 2 / (3 * far**2.5 * rest) * (2 * (2 - m) * e / rest - k) - difference
    l1 = (j1 + 2 * radius * rho * l2) / (radius**2 + rho**2 + z**2)
    return j0, j1, l1, l2, difference
