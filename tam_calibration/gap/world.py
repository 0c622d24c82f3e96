"""A field that is constant in the world, rotated into the array's frame by the recorded attitude.

One sensor alone measures the intensity of the field only: any rotation fits its readings. With the attitude recorded,
its three axes read y = D Λ Rᵀ h + o, with h the field of the world, Rᵀ the rotation from the world to the frame of the
attitude, Λ the rotation from that to the sensor's own frame, and D and o the sensor's errors: three channels with no
other noise than the sensor's and the attitude's. The scale of D and the length of h are not separable: det D = 1.

The readings are linear in the offset and, for each axis, in nine products of the elements of M = D Λ and h. Linear
least squares therefore gives the residual for a jump at every time, or for a pair of jumps, on and off. The products of
all axes form the matrix vec(M) hᵀ of rank one, from which M and h follow; Gauss-Newton refines them.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.states import LEAST_FALL, BiasJump, Cuts, best_cuts, is_on, shape_of
from tam_calibration.fit.ellipsoid import free_scale
from tam_calibration.gap.regressors import Regressors, update
from tam_calibration.model.fitted_effect import Contribution, FittedEffect, Shape
from tam_calibration.model.recording import Recording
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
        stepped, world = World.of(matrix, bias, self.field_T + step[-3:] * unit_T, self.mount)
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


_OPEN = 1e-6
"""Relative singular value below which the recorded attitudes do not determine a combination of the products."""


def oriented(recording: Recording) -> tuple[SensorErrors, World, FittedEffect | None]:
    """Return initial values of the fit in the field of the world: errors and world without a gross jump, and that jump.

    Parameters
    ----------
    recording : Recording
        Of one sensor whose attitude is known in all samples.

    Raises
    ------
    InputError
        When no fit is one of a sensor.
    """
    assert recording.attitude is not None
    readings = recording.readings_T[:, 0]
    turned, products = turns(recording.attitude), products_of(recording.attitude)
    shape = _gross_jump(recording.time_s, readings, products)
    step = np.empty((len(turned), 0)) if shape is None else is_on(recording.time_s, shape)[:, None].astype(float)
    values = np.linalg.lstsq(np.column_stack([products, step]), readings, rcond=_OPEN)[0]
    fits = [_linear_fit(matrix, turned, step, readings) for matrix in (_factor(values[:9]), np.eye(3))]
    _, matrix, field_T, offsets = min(fits, key=lambda one: one[0])
    errors, world = World.of(matrix[None], offsets[:1], field_T, np.eye(3))
    if shape is None:
        return errors, world, None
    jump = tuple(Contribution(0, axis, "offset", {"offset": value}) for axis, value in enumerate(offsets[1].tolist()))
    return errors, world, FittedEffect(BiasJump.name, shape, jump)


def products_of(attitude: FloatArray) -> FloatArray:
    """Return the regressors (N, 10) of the readings at attitudes (N, 4): elements of the rotations, and 1."""
    turned = turns(attitude)
    return np.column_stack([turned.reshape(len(turned), 9), np.ones(len(turned))])


def _linear_fit(
    matrix: FloatArray, turned: FloatArray, step: FloatArray, readings: FloatArray
) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Return the residual energy, T², of a given matrix, itself, and field and offsets (before a jump, its size)."""
    constant = np.column_stack([np.ones(len(step)), step])
    offsets = np.einsum("np,ij->nipj", constant, np.eye(3)).reshape(3 * len(step), -1)
    design = np.column_stack([(matrix @ turned).reshape(-1, 3), offsets])
    values = np.linalg.lstsq(design, readings.ravel(), rcond=_OPEN)[0]
    energy = float(np.sum((readings.ravel() - design @ values) ** 2))
    return energy, matrix, values[:3], values[3:].reshape(-1, 3)


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
