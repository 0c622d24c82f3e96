"""Regressors of the rows of a recording: terms side by side, and the calibration itself in the same form."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.term import Term
from tam_calibration.model.exceptions import Refused
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
        return of_atoms if self._scatter is None else self._scatter.T @ of_atoms

    def of_atoms(self, values: FloatArray) -> FloatArray:
        """Return values by feature and row (F, 3K + 1, ...) as those of the atoms (J, ...)."""
        of_atoms: FloatArray = (
            values[self.index, self.rows]
            if self.rows.ndim == 1
            else np.einsum("jr,jr...->j...", self.rows, values[self.index])
        )
        return of_atoms

    @cached_property
    def _scatter(self) -> FloatArray | None:
        """(J, P) sums of atoms to columns; None where they are the same."""
        if np.array_equal(self.columns, np.arange(self.width)):
            return None
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
