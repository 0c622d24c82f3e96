"""A field that is constant in the world, rotated into the array's frame by the recorded attitude.

One sensor alone measures the intensity of the field only: any rotation fits its readings. With the attitude recorded,
its three axes read y = D Λ Rᵀ h + o, with h the field of the world, Rᵀ the rotation from the world to the frame of the
attitude, Λ the rotation from that to the sensor's own frame, and D and o the sensor's errors: three channels with no
other noise than the sensor's and the attitude's. The scale of D and the length of h are not separable: det D = 1.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from tam_calibration.effects.covariates import Covariates
from tam_calibration.fit.scale import free_scale
from tam_calibration.gap.regressors import Regressors, update
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class World:
    """The field of the world, and the rotation from the frame of the attitude to the array's.

    Parameters
    ----------
    field_T : (3,) array
        In the world, tesla.
    mount : (3, 3) array
        Rotation that turns vectors of the attitude's frame into the array's, which is the first sensor's own.
    variance_T2 : (3,) array
        Variance that the noise of the attitude adds to each row of the sensor, T².
    """

    field_T: FloatArray
    mount: FloatArray
    variance_T2: FloatArray = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def of(
        cls, matrix: FloatArray, bias_T: FloatArray, field_T: FloatArray, mount: FloatArray
    ) -> tuple[SensorErrors, "World"]:
        """Return the errors of sensors in the frame of the first, and the world beside them.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            From the field in the frame that the mount leads to, to the readings without bias; of any scale.
        bias_T : (K, 3) array
            Reading in zero field, tesla.
        field_T : (3,) array
            In the world; matrix times field is what is read, tesla.
        mount : (3, 3) array
            From the frame of the attitude to that of the matrices.

        Raises
        ------
        InputError
            When a matrix is singular or its sensor left-handed.
        """
        first = SensorErrors.from_matrix(matrix, bias_T).rotation[0]
        own = matrix @ first.T
        scale = float(free_scale(own))
        return SensorErrors.from_matrix(scale * own, bias_T), cls(field_T / scale, first @ mount)

    @property
    def intensity_T(self) -> float:
        """Length of the field."""
        return float(np.linalg.norm(self.field_T))

    @property
    def aligned(self) -> "World":
        """The same field, for attitudes of the array's own frame."""
        return replace(self, mount=np.eye(3))

    def attitude(self, recorded: FloatArray) -> FloatArray:
        """Return quaternions (N, 4) from the array's frame to the world of those recorded."""
        from scipy.spatial.transform import Rotation

        x, y, z, w = Rotation.from_matrix(self.mount).inv().as_quat()
        # Rows (x, y, z, w) times these are the products, for which SciPy takes thirty times as long.
        behind = np.array([[w, -z, y, -x], [z, w, -x, -y], [-y, x, w, -z], [x, y, z, w]])
        return np.asarray(recorded / np.linalg.norm(recorded, axis=1)[:, None] @ behind)

    def field(self, attitude: FloatArray) -> FloatArray:
        """Return the field (N, 3) in the array's frame at attitudes (N, 4) of the array, tesla."""
        return turns(attitude) @ self.field_T

    def stepped(self, errors: SensorErrors, step: FloatArray, unit_T: float) -> tuple[SensorErrors, "World"]:
        """Return errors and world after a step of their designs.

        Parameters
        ----------
        errors : SensorErrors
            Before the step, of K sensors.
        step : (12K + 3,) array
            Change of each row of [D Λ | o], then of the world's field; biases o and field in units of ``unit_T``.
        unit_T : float
            Mean intensity of the field, tesla.

        Raises
        ------
        InputError, Refused
            When a matrix is no longer one of a sensor.
        """
        matrix, bias = update(errors, step[:-3], unit_T)
        in_world = self.field_T + step[-3:] * unit_T
        if not (np.isfinite(matrix).all() and np.isfinite(bias).all() and in_world.any()):
            raise Refused("the nominal fit does not settle: the readings do not fit one calibration")
        stepped, world = World.of(matrix, bias, in_world, self.mount)
        return stepped, replace(world, variance_T2=self.variance_T2)


def world_design(covariates: Covariates, unit_T: float, stride: int = 1) -> Regressors:
    """Return the regressors of the world's field: its three components in each row.

    Parameters
    ----------
    covariates : Covariates
        Of K sensors, with the attitude of the array.
    unit_T : float
        Tesla per unit of a coefficient: the mean intensity of the field.
    stride : int
        Every stride-th sample is taken.
    """
    assert covariates.attitude is not None
    read = unit_T * covariates.errors.matrix.reshape(-1, 3) @ turns(covariates.attitude[::stride])
    rows, columns = np.divmod(np.arange(read[0].size), 3)
    return Regressors(read.reshape(len(read), -1), np.arange(len(rows)), rows, columns, 3)


def turns(attitude: FloatArray) -> FloatArray:
    """Return the rotation matrices (N, 3, 3) from the world to a frame with attitudes (N, 4)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(attitude).inv().as_matrix())
