"""What turns a sample's row into its channels at given parameters: all of it linear but for one length.

A row is [readings, features, 1]; the features say how an ambient gradient is turned, and there are none without one.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tam_calibration.core.normal_equations import Elimination
from tam_calibration.effects.ambient_gradient import turned
from tam_calibration.model.array import TENSOR_COLUMNS, TENSOR_ROWS, UNIT_TENSORS
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Turning:
    """How the components of a gradient of the world act on an array that is turned in it.

    Parameters
    ----------
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world.
    positions_m : (K, 3) array
        Of the sensors.
    scalar_position_m : (3,) array
        Of the scalar magnetometer.
    """

    attitude: FloatArray
    positions_m: FloatArray
    scalar_position_m: FloatArray

    @cached_property
    def features(self) -> FloatArray:
        """(N, 25) components in the array frame (slow) of the five unit tensors of the world (fast)."""
        components = turned(UNIT_TENSORS, self.attitude)[:, :, TENSOR_ROWS, TENSOR_COLUMNS]
        return np.swapaxes(components, 1, 2).reshape(len(components), -1)

    @property
    def levers(self) -> FloatArray:
        """(K, 3, 5) fields at the sensors of the five unit tensors of the array frame."""
        return np.asarray(np.einsum("cij,kj->kic", UNIT_TENSORS, self.positions_m))

    @property
    def scalar_lever(self) -> FloatArray:
        """(3, 5) the same at the scalar magnetometer."""
        return np.asarray(np.einsum("cij,j->ic", UNIT_TENSORS, self.scalar_position_m))


@dataclass(frozen=True, eq=False)
class ChannelMaps:
    """Linear maps from rows of Z columns to the channels, and their derivatives by the parameters.

    The parameters are the flattened (3K, 4) rows of [D Λ | o], then the P = 5 components of the gradient, or none.

    Parameters
    ----------
    elimination : Elimination
        Of the field that the sensors agree on from the unbiased readings.
    unbiased : (3K, Z) array
        To the readings without bias and without what the gradient adds.
    at_sensors : (K, 4, Z) array
        To the field at each sensor, and 1: minus the derivative of the unbiased readings by the rows.
    by_gradient : (3K, P, Z) array
        Minus the derivative of the unbiased readings by the gradient.
    at_scalar : (3, Z) array
        To the field at the scalar magnetometer.
    response : (12K + P, 3, Z - 3K + 3) array
        Minus the derivative of the intensity there, in direction ⊗ [field there, features, 1].
    """

    elimination: Elimination
    unbiased: FloatArray
    at_sensors: FloatArray
    by_gradient: FloatArray
    at_scalar: FloatArray
    response: FloatArray

    @classmethod
    def at(
        cls,
        matrix: FloatArray,
        bias: FloatArray,
        gradient: FloatArray,
        vector_noise: FloatArray,
        turning: Turning | None,
    ) -> "ChannelMaps":
        """Return the maps at given errors of the sensors and a given ambient gradient.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            D Λ of each sensor.
        bias : (K, 3) array
            Of each sensor, in the unit of the readings.
        gradient : (P,) array
            Components xx, xy, xz, yy, yz of the ambient gradient in the world, in the unit of the readings per metre;
            not read without ``turning``.
        vector_noise : (K,) array
            Standard deviation of the noise of each sensor's axes, in the unit of the readings.
        turning : Turning, optional
            Attitudes and positions by which the gradient acts; None in a uniform field.
        """
        elimination = Elimination.of(matrix.reshape(-1, 3), 1 / np.repeat(vector_noise, 3))
        if turning is None:
            return cls._of_uniform_field(elimination, bias)
        unmix, rows = elimination.unmixing, matrix.size // 3
        levers, scalar_lever = turning.levers, turning.scalar_lever
        moved = (matrix @ levers).reshape(-1, 5)
        chosen = np.kron(np.eye(5), gradient)
        unbiased = np.column_stack([np.eye(rows), -moved @ chosen, -bias.ravel()])
        center = unmix @ unbiased
        at_sensors = _append_one(center + _features_only(levers @ chosen, rows))
        by_gradient = _features_only(_each(moved), rows)
        at_scalar = center + _features_only(scalar_lever @ chosen, rows)
        field = np.eye(3, 4 + chosen.shape[1]) + _features_only((levers - scalar_lever) @ chosen, 3)
        by_rows = _by_rows(unmix, _append_one(field))
        by_gradient_there = np.swapaxes(_features_only(_each(unmix @ moved - scalar_lever), 3), 0, 1)
        response = np.concatenate([by_rows, by_gradient_there])
        return cls(elimination, unbiased, at_sensors, by_gradient, at_scalar, response)

    @classmethod
    def _of_uniform_field(cls, elimination: Elimination, bias: FloatArray) -> "ChannelMaps":
        count = len(bias)
        unbiased = np.column_stack([np.eye(3 * count), -bias.ravel()])
        center = elimination.unmixing @ unbiased
        at_sensors = np.broadcast_to(_append_one(center), (count, 4, 3 * count + 1))
        response = _by_rows(elimination.unmixing, np.broadcast_to(np.eye(4), (count, 4, 4)))
        none = np.zeros((3 * count, 0, 3 * count + 1))
        return cls(elimination, unbiased, at_sensors, none, center, response)


def _append_one(field: FloatArray) -> FloatArray:
    """Extend maps to a field (..., 3, Z) by one to the 1 in the last column: (..., 4, Z)."""
    one = np.zeros((*field.shape[:-2], 1, field.shape[-1]))
    one[..., -1] = 1
    return np.concatenate([field, one], axis=-2)


def _features_only(of_features: FloatArray, before: int) -> FloatArray:
    """Return maps (..., Q) of the features as maps (..., before + Q + 1) of rows."""
    return np.pad(of_features, [(0, 0)] * (of_features.ndim - 1) + [(before, 1)])


def _each(of_components: FloatArray) -> FloatArray:
    """Return maps (M, 5) of components in the array frame as maps (M, 5, 25) of features, one for each unit tensor."""
    return np.asarray(np.einsum("mc,pq->mpcq", of_components, np.eye(5)).reshape(len(of_components), 5, 25))


def _by_rows(unmix: FloatArray, field: FloatArray) -> FloatArray:
    """Return the (12K, 3, V) responses of the common field to the rows, from maps (K, 4, V) to what they act on."""
    by_reading = unmix.reshape(3, -1, 3)
    return np.asarray(np.einsum("xia,icv->iacxv", by_reading, field).reshape(12 * len(field), 3, -1))
