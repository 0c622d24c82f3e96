"""Regressors of the rows of a recording: terms, the calibration in the same form, and a field constant in the world.

One sensor alone measures the intensity of the field only: any rotation fits its readings. With the attitude recorded,
its three axes read y = D Λ Rᵀ h + o, with h the field of the world, Rᵀ the rotation from the world to the frame of the
attitude, Λ the rotation from that to the sensor's own frame, and D and o the sensor's errors: three channels with no
other noise than the sensor's and the attitude's. The scale of D and the length of h are not separable: det D = 1.

The readings are linear in the offset and, for each axis, in nine products of the elements of M = D Λ and h. The
products of all axes form the matrix vec(M) hᵀ of rank one, from which M and h follow; Gauss-Newton refines them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.term import Term
from tam_calibration.fit.ellipsoid import free_scale
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Regressors:
    """Regressors of the rows: terms side by side, one column for each coefficient.

    Parameters
    ----------
    features : (N, F) array
        Tesla per unit of a coefficient; best with the samples of a feature side by side in memory.
    index, columns : (J,) array of int
        Feature and column of each atom; atoms of several rows may share a feature.
    rows : (J,) array of int, or (J, 3K + 1) array
        Row of each atom, or what each row reads of it.
    width : int
        Number of columns P.
    """

    features: FloatArray
    index: NDArray[np.intp]
    rows: NDArray[np.intp] | FloatArray
    columns: NDArray[np.intp]
    width: int

    @classmethod
    def of(cls, terms: Sequence[Term]) -> "Regressors":
        """Put terms side by side; those that hold the same features share them."""
        each = (
            cls(term.features, np.arange(len(term.rows)), term.rows, term.columns, len(term.coefficients))
            for term in terms
        )
        return cls.joined(list(each))

    @classmethod
    def joined(cls, designs: "Sequence[Regressors]") -> "Regressors":
        """Put designs side by side; those that hold the same features share them."""
        columns = np.cumsum([0, *(design.width for design in designs)])
        features = {id(design.features): design.features for design in designs}
        ends = np.cumsum([one.shape[1] for one in features.values()])
        starts = {key: end - one.shape[1] for (key, one), end in zip(features.items(), ends, strict=True)}
        return cls(
            np.concatenate([one.T for one in features.values()]).T,
            np.concatenate([design.index + starts[id(design.features)] for design in designs]),
            _side_by_side([design.rows for design in designs]),
            np.concatenate([design.columns + start for design, start in zip(designs, columns[:-1], strict=True)]),
            int(columns[-1]),
        )

    def by_column(self, of_atoms: FloatArray) -> FloatArray:
        """Return the sums (P, ...) of values (J, ...) by atom."""
        return self._scatter.T @ of_atoms

    def of_atoms(self, values: FloatArray) -> FloatArray:
        """Return values by feature and row (F, 3K + 1, ...) as those of the atoms (J, ...)."""
        of_atoms: FloatArray = (
            values[self.index, self.rows]
            if self.rows.ndim == 1
            else np.einsum("jr,jr...->j...", self.rows, values[self.index])
        )
        return of_atoms

    @cached_property
    def _scatter(self) -> FloatArray:
        """(J, P) sums of atoms to columns."""
        scatter = np.zeros((len(self.columns), self.width))
        scatter[np.arange(len(self.columns)), self.columns] = 1
        return scatter


def _side_by_side(rows: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return the rows of atoms of several terms or designs, each as what the rows read of it where one has that."""
    counts = {one.shape[1] for one in rows if one.ndim == 2}
    if not counts:
        return np.concatenate(rows)
    alone = np.eye(*counts)
    return np.concatenate([one if one.ndim == 2 else alone[one] for one in rows])


def calibration_regressors(covariates: Covariates, stride: int = 1) -> Regressors:
    """Return the design of the calibration itself: each row of [D Λ | o], in units of the mean intensity.

    The regressors are made of noisy data; their noise enters the residual to second order only.

    Parameters
    ----------
    covariates : Covariates
        Of K sensors, with the field in the array frame.
    stride : int
        Every stride-th sample is taken.
    """
    unit = float(np.mean(covariates.intensity_T))
    field = covariates.field_T[::stride]
    features = np.stack([*field.T, np.full(len(field), unit)]).T
    count = covariates.scalar_row
    rows = np.repeat(np.arange(count), 4)
    return Regressors(features, np.tile(np.arange(4), count), rows, np.arange(4 * count), 4 * count)


def update(errors: SensorErrors, step: FloatArray, unit_T: float) -> tuple[FloatArray, FloatArray]:
    """Return matrices and biases after a step (12 K,) of ``calibration_regressors``.

    Parameters
    ----------
    errors : SensorErrors
        Before the step, of K sensors.
    step : (12K,) array
        Change of each row of [D Λ | o], the biases o in units of ``unit_T``.
    unit_T : float
        Mean intensity of the field, tesla.

    Returns
    -------
    (K, 3, 3) array, (K, 3) array
        Matrices D Λ, and biases in tesla.

    Raises
    ------
    Refused
        When the step leads to a value that is not finite.
    """
    if not np.isfinite(step).all():
        raise Refused("the nominal fit does not settle: the readings do not fit one calibration")
    change: Any = step.reshape(errors.sensor_count, 3, 4)
    return errors.matrix + change[..., :3], errors.bias_T + change[..., 3] * unit_T


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


def oriented(recording: Recording) -> tuple[SensorErrors, World]:
    """Return initial values of the fit in the field of the world: errors and world.

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
    readings, turned = recording.readings_T[:, 0], turns(recording.attitude)
    values = np.linalg.lstsq(products_of(recording.attitude), readings, rcond=_OPEN)[0]
    fits = [_linear_fit(matrix, turned, readings) for matrix in (_factor(values[:9]), np.eye(3))]
    _, matrix, field_T, offset_T = min(fits, key=lambda one: one[0])
    return World.of(matrix[None], offset_T[None], field_T, np.eye(3))


def products_of(attitude: FloatArray) -> FloatArray:
    """Return the regressors (N, 10) of the readings at attitudes (N, 4): elements of the rotations, and 1."""
    turned = turns(attitude)
    return np.column_stack([turned.reshape(len(turned), 9), np.ones(len(turned))])


def _linear_fit(
    matrix: FloatArray, turned: FloatArray, readings: FloatArray
) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Return the residual energy, T², of a given matrix, itself, and field and offset."""
    design = np.column_stack([(matrix @ turned).reshape(-1, 3), np.tile(np.eye(3), (len(turned), 1))])
    values = np.linalg.lstsq(design, readings.ravel(), rcond=_OPEN)[0]
    energy = float(np.sum((readings.ravel() - design @ values) ** 2))
    return energy, matrix, values[:3], values[3:]


def _factor(products: FloatArray) -> FloatArray:
    """Return the right-handed matrix M whose products with some field h are nearest to products (9, 3)."""
    of_axis = products.T.reshape(9, 3)
    left, _, _ = np.linalg.svd(of_axis, full_matrices=False)
    matrix = np.sqrt(3) * left[:, 0].reshape(3, 3)
    # (M, h) and (-M, -h) are the same.
    return np.asarray(matrix * np.sign(np.linalg.det(matrix)))
