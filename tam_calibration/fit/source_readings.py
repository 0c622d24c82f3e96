"""The readings of a known source, and their derivatives to baselines, common frame and places of the axes.

The reading of axis a of sensor k in pose n is row a of its matrix D Λ times X Rₙᵀ B(cₙ + Rₙ (s p_k + d_ka)). B is the
field of the source in the world, p_k the stated position of the sensor, s the scale of the baselines, d_ka the place of
the element of the axis beside the sensor, and X the turn from the array frame into that of the calibration so far.
"""

from dataclasses import dataclass

import numpy as np

from tam_calibration.array import Array
from tam_calibration.localization.poses import Poses
from tam_calibration.localization.source import Source
from tam_calibration.sensor_errors import SensorErrors
from tam_calibration.units import FloatArray


@dataclass(frozen=True, eq=False)
class SourceReadings:
    """What the sensors of an array read of a source.

    Parameters
    ----------
    source : Source
        In the world.
    poses : Poses
        Of the array in the world, N.
    errors : SensorErrors
        Of the sensors, in the frame of the calibration so far.
    array : Array
        As stated.
    """

    source: Source
    poses: Poses
    errors: SensorErrors
    array: Array

    def predict(self, scale: float, rotation: FloatArray, offsets_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the readings (N, K, 3) in tesla and their derivatives (N, K, 3, 4 + 9 K).

        Parameters
        ----------
        scale : float
            True distances of the sensors from the centre over the stated ones.
        rotation : (3, 3) array
            From the array frame into that of the calibration so far.
        offsets_m : (K, 3, 3) array
            Places of the elements of axis x, y, z of each sensor beside it, metres.
        """
        turn, positions = self.poses.matrix, self.array.positions_m
        elements = scale * positions[:, None] + offsets_m
        world = self.poses.position_m[:, None, None] + np.einsum("nij,kaj->nkai", turn, elements)
        field = np.einsum("nji,nkaj->nkai", turn, self.source.field_T(world))
        gradient = np.einsum("nji,nkajl,nlm->nkaim", turn, self.source.gradient_T_per_m(world), turn, optimize=True)
        rows = self.errors.matrix
        turned = field @ rotation.T
        by_place = np.einsum("kai,ij,nkajm->nkam", rows, rotation, gradient, optimize=True)
        derivative = np.zeros((*field.shape[:3], 4 + 9 * len(positions)))
        derivative[..., 0] = np.einsum("nkam,km->nka", by_place, positions)
        # A further turn by ω adds ω × b, of which the row takes b × row · ω.
        derivative[..., 1:4] = np.cross(turned, rows)
        own = derivative[..., 4:].reshape(*field.shape[:3], len(positions), 3, 3)
        for sensor, axis in np.ndindex(*field.shape[1:3]):
            own[:, sensor, axis, sensor, axis] = by_place[:, sensor, axis]
        return np.einsum("kai,nkai->nka", rows, turned), derivative
