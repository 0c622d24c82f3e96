"""The nominal fit of one sensor with known attitude in a constant field of the world, despite a jump of its bias.

The readings y = M Rᵀ h + o are linear in the offset and, for each axis, in nine products of the elements of M and h.
Linear least squares therefore gives the residual for a jump at every time, or for a pair of jumps, on and off. The
products of all axes form the matrix vec(M) hᵀ of rank one, from which M and h follow; Gauss-Newton refines them.
"""

from dataclasses import dataclass

import numpy as np

from tam_calibration.core.noise import fast_noise
from tam_calibration.effects.gross_jump import LEAST_FALL, Cuts, best_cuts, shape_of
from tam_calibration.effects.states import BiasJump, is_on
from tam_calibration.gap.regression import Base
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.gap.world import World, turns
from tam_calibration.model.fitted_effect import Contribution, FittedEffect, Shape
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_OPEN = 1e-6
"""Relative singular value below which the recorded attitudes do not determine a combination of the products."""

_BIAS = [3, 7, 11]
"""Columns of the offsets in the regressors of a sensor's calibration."""


@dataclass(frozen=True, eq=False)
class Oriented:
    """Initial values of the fit in the field of the world: errors and world without a gross jump, and that jump."""

    errors: SensorErrors
    world: World
    jump: FittedEffect | None

    @classmethod
    def of(cls, recording: Recording) -> "Oriented":
        """Return the start of the fit of one sensor whose attitude is known in all samples.

        Raises
        ------
        InputError
            When no fit is one of a sensor.
        """
        assert recording.attitude is not None
        readings, turned, products = (
            recording.readings_T[:, 0],
            turns(recording.attitude),
            products_of(recording.attitude),
        )
        shape = _gross_jump(recording.time_s, readings, products)
        step = np.empty((len(turned), 0)) if shape is None else is_on(recording.time_s, shape)[:, None].astype(float)
        values = np.linalg.lstsq(np.column_stack([products, step]), readings, rcond=_OPEN)[0]
        start = min(
            (_Linear.at(matrix, turned, step, readings) for matrix in (_factor(values[:9]), np.eye(3))),
            key=lambda one: one.residual_energy,
        )
        errors, world = World.of(start.matrix[None], start.offsets[:1], start.field_T, np.eye(3))
        return cls(errors, world, None if shape is None else _jump(shape, start.offsets[1]))


def products_of(attitude: FloatArray) -> FloatArray:
    """Return the regressors (N, 10) of the readings at attitudes (N, 4): elements of the rotations, and 1."""
    turned = turns(attitude)
    return np.column_stack([turned.reshape(len(turned), 9), np.ones(len(turned))])


@dataclass(frozen=True, eq=False)
class _Linear:
    """Least-squares field and offsets (before a jump, and its size) for a given matrix, and the residual energy, T²."""

    matrix: FloatArray
    field_T: FloatArray
    offsets: FloatArray
    residual_energy: float

    @classmethod
    def at(cls, matrix: FloatArray, turned: FloatArray, step: FloatArray, readings: FloatArray) -> "_Linear":
        constant = np.column_stack([np.ones(len(step)), step])
        offsets = np.einsum("np,ij->nipj", constant, np.eye(3)).reshape(3 * len(step), -1)
        design = np.column_stack([(matrix @ turned).reshape(-1, 3), offsets])
        values = np.linalg.lstsq(design, readings.ravel(), rcond=_OPEN)[0]
        energy = float(np.sum((readings.ravel() - design @ values) ** 2))
        return cls(matrix, values[:3], values[3:].reshape(-1, 3), energy)


def _gross_jump(time_s: FloatArray, readings: FloatArray, products: FloatArray) -> Shape | None:
    """Return the times of a jump, or of one on and off, so large that no calibration fits without it; else None."""
    left, singular, _ = np.linalg.svd(products, full_matrices=False)
    basis = left[:, singular > _OPEN * singular[0]]
    residual = readings - basis @ (basis.T @ readings)
    energy, sums = float(np.sum(residual**2)), np.zeros((len(time_s) + 1, 3 + basis.shape[1]))
    np.cumsum(np.column_stack([residual, basis]), axis=0, out=sums[1:])

    def energies(cuts: Cuts) -> FloatArray:
        between = sums[cuts[:, 1]] - sums[cuts[:, 0]]
        free = np.diff(cuts, axis=1)[:, 0] - np.sum(between[:, 3:] ** 2, axis=1)
        return np.asarray(energy - np.sum(between[:, :3] ** 2, axis=1) / np.maximum(free, _OPEN * len(time_s)))

    best = best_cuts(energies, len(time_s))
    if best is None or energy < LEAST_FALL * float(energies(best[None])[0]):
        return None
    return shape_of(time_s, best)


def _factor(products: FloatArray) -> FloatArray:
    """Return the right-handed matrix M whose products with some field h are nearest to products (9, 3)."""
    of_axis = products.T.reshape(9, 3)
    left, _, _ = np.linalg.svd(of_axis, full_matrices=False)
    matrix = np.sqrt(3) * left[:, 0].reshape(3, 3)
    # (M, h) and (-M, -h) are the same.
    return np.asarray(matrix * np.sign(np.linalg.det(matrix)))


def _jump(shape: Shape, offset_T: FloatArray) -> FittedEffect:
    contributions = (Contribution(0, axis, "offset", {"offset": value}) for axis, value in enumerate(offset_T.tolist()))
    return FittedEffect(BiasJump.name, shape, tuple(contributions))


def attitude_variance(channels: WhitenedChannels, world: World) -> FloatArray:
    """Return the variance (3,) that the white noise of the attitude adds to each row of a sensor, T².

    A small rotation changes a field only across its direction. The white noise of the residual across the field of the
    world therefore exceeds that along it by the noise of the attitude; each row has the part of it that lies across.

    Parameters
    ----------
    channels : WhitenedChannels
        Of one sensor in the field of the world; only samples that count are used.
    world : World
        The fitted field: the noise along it is that of the sensor alone, across it that of the attitude as well.
    """
    covariates, counted = channels.covariates, channels.is_counted
    assert covariates.attitude is not None
    residual = channels.residuals.row_shift_T[counted, :-1]
    in_world = np.einsum("nji,nj->ni", turns(covariates.attitude[counted]), residual)
    frame = np.linalg.qr(world.field_T[:, None], mode="complete")[0]
    along, *across = fast_noise(in_world @ frame)
    variance = max(float(np.mean(np.square(across)) - along**2), 0.0)
    part_across: FloatArray = 1 - np.mean(channels.direction[counted, :3] ** 2, axis=0)
    return variance * part_across


def bias_variance(base: Base) -> float:
    """Return the summed variance of a sensor's three offsets, scaled by the residual, over the squared intensity.

    Directions that the recording does not determine count as zero: compare fits of equal rank only.
    """
    covariance = base.inverse[np.ix_(_BIAS, _BIAS)]
    return float(np.trace(covariance)) * base.energy / max(base.channels.count - base.rank, 1.0)
