"""The whitened channels of a recording at a nominal calibration, and normal equations of what may be added to its rows.

The field of every sample is eliminated: left are 3K - 3 differential channels between the sensors and one common-mode
channel, the scalar minus the length of the field that the sensors agree on; white with unit variance under the model.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.linalg import inv, norm
from numpy.typing import NDArray

from tam_calibration.array import Array
from tam_calibration.effects.effect import Misfit, Situation, Term
from tam_calibration.errors import SensorErrors
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

_PIECE = 8192


@dataclass(frozen=True, eq=False)
class Design:
    """What may be added to the rows: terms side by side, one column for each coefficient.

    Parameters
    ----------
    features : (N, J) array
        Of the atoms, tesla per unit of their coefficient.
    rows, columns : (J,) array of int
        Row and column of each atom.
    width : int
        Number of columns P.
    """

    features: FloatArray
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    width: int

    @classmethod
    def of(cls, terms: Sequence[Term]) -> "Design":
        """Put terms side by side."""
        widths = [len(term.coefficients) for term in terms]
        starts = np.cumsum([0, *widths])
        features = np.concatenate([term.features for term in terms], axis=1)
        rows = np.concatenate([term.rows for term in terms])
        columns = np.concatenate([term.columns + start for term, start in zip(terms, starts[:-1], strict=True)])
        return cls(features, rows, columns, int(starts[-1]))

    @classmethod
    def joined(cls, designs: "Sequence[Design]") -> "Design":
        """Put designs side by side."""
        starts = np.cumsum([0, *(design.width for design in designs)])
        return cls(
            np.concatenate([design.features for design in designs], axis=1),
            np.concatenate([design.rows for design in designs]),
            np.concatenate([design.columns + start for design, start in zip(designs, starts[:-1], strict=True)]),
            int(starts[-1]),
        )

    @cached_property
    def scatter(self) -> FloatArray | None:
        """(J, P) sums of atoms to columns; None where they are the same."""
        if len(self.columns) == self.width and (self.columns == np.arange(self.width)).all():
            return None
        scatter = np.zeros((len(self.columns), self.width))
        scatter[np.arange(len(self.columns)), self.columns] = 1
        return scatter


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations: information matrix (P, P), score (P,), energy of the channels and their number."""

    information: FloatArray
    score: FloatArray
    energy: float
    count: float

    def __add__(self, other: "Normal") -> "Normal":
        """Return the normal equations of both sets of samples."""
        return Normal(
            self.information + other.information,
            self.score + other.score,
            self.energy + other.energy,
            self.count + other.count,
        )

    def __sub__(self, other: "Normal") -> "Normal":
        """Return the normal equations without a part of the samples."""
        return Normal(
            self.information - other.information,
            self.score - other.score,
            self.energy - other.energy,
            self.count - other.count,
        )


@dataclass(frozen=True, eq=False)
class Channels:
    """Whitened channels of every sample at nominal errors.

    Parameters
    ----------
    recording : Recording
        As read; a scalar channel is NaN or None where there is no reference.
    situation : Situation
        With the field that the sensors agree on.
    directions : (3K, 3K - 3) array
        How a shift of each row moves the differential channels, 1/T.
    differential : (N, 3K - 3) array
        Residuals of them.
    row_direction : (N, 3K + 1) array
        How a shift of each row moves the scalar minus the length of the field.
    misfit_T : (N,) array
        That difference; 0 where there is no reference.
    precision : (N,) array
        Its inverse variance, 1/T²; 0 where there is no reference.
    is_counted : (N,) array of bool
        Whether the sample counts.
    """

    recording: Recording
    situation: Situation
    directions: FloatArray
    differential: FloatArray
    row_direction: FloatArray
    misfit_T: FloatArray
    precision: FloatArray
    is_counted: NDArray[np.bool_]

    @classmethod
    def at(
        cls,
        recording: Recording,
        array: Array,
        errors: SensorErrors,
        intensity_T: float,
        added_T: FloatArray | None = None,
        is_counted: NDArray[np.bool_] | None = None,
    ) -> "Channels":
        """Return the channels of a recording.

        Parameters
        ----------
        recording : Recording
            With the channels of the situation finite.
        array : Array
            With the noise of sensors and scalar.
        errors : SensorErrors
            At which the channels are linearised.
        intensity_T : float
            Of the field, where the recording has no scalar channel.
        added_T : (N, 3K + 1) array, optional
            What known effects add to the rows, and what is taken off them.
        is_counted : (N,) array of bool, optional
            By default every sample counts.
        """
        assert array.vector_noise_T is not None
        count = recording.sensor_count
        added = np.zeros(3 * count + 1) if added_T is None else added_T
        matrix = errors.matrix.reshape(-1, 3)
        weight = 1 / np.repeat(array.vector_noise_T, 3)
        covariance = inv(matrix.T @ (weight[:, None] ** 2 * matrix))
        unmix = covariance @ (weight[:, None] ** 2 * matrix).T
        basis, _ = np.linalg.qr(weight[:, None] * matrix, mode="complete")
        directions = weight[:, None] * basis[:, 3:]
        rows = recording.readings_T.reshape(-1, 3 * count) - errors.bias_T.ravel() - added[..., :-1]
        field = rows @ unmix.T
        length = norm(field, axis=1)
        direction = field / length[:, None]
        scalar = np.full(len(rows), intensity_T) if recording.scalar_T is None else recording.scalar_T - added[..., -1]
        variance = (array.scalar_noise_T or 0.0) ** 2 + np.einsum("ni,ij,nj->n", direction, covariance, direction)
        known = np.isfinite(scalar)
        row_direction = np.column_stack([-direction @ unmix, np.ones(len(rows))])
        situation = Situation(
            recording.time_s,
            field,
            errors,
            array,
            recording.temperature_C,
            recording.current_A,
            recording.attitude,
        )
        return cls(
            recording,
            situation,
            directions,
            rows @ directions,
            row_direction,
            np.where(known, scalar - length, 0.0),
            np.where(known, 1 / variance, 0.0),
            np.ones(len(rows), dtype=bool) if is_counted is None else is_counted,
        )

    @cached_property
    def coupling(self) -> FloatArray:
        """(3K + 1, 3K + 1) information of the differential channels on shifts of the rows, 1/T²."""
        coupling = np.zeros((len(self.directions) + 1,) * 2)
        coupling[:-1, :-1] = self.directions @ self.directions.T
        return coupling

    @property
    def channels_per_sample(self) -> FloatArray:
        """(N,) number of channels of each sample that counts."""
        count: FloatArray = self.is_counted * (self.differential.shape[1] + (self.precision > 0))
        return count

    @cached_property
    def count(self) -> float:
        """Number of channels n."""
        return float(self.channels_per_sample.sum())

    @cached_property
    def energy_per_sample(self) -> FloatArray:
        """(N,) sums of the squares of each sample's channels."""
        energy: FloatArray = np.sum(self.differential**2, axis=1) + self.precision * self.misfit_T**2
        return energy

    @cached_property
    def energy(self) -> float:
        """Sum of the squares of all channels that count."""
        return float(self.energy_per_sample[self.is_counted].sum())

    @cached_property
    def misfit(self) -> Misfit:
        """What effects that are not found by regression look at."""
        root = np.sqrt(self.precision)
        return Misfit(
            self.recording,
            self.situation,
            self.differential,
            self.directions,
            np.where(self.precision > 0, root * self.misfit_T, np.nan),
            root[:, None] * self.row_direction,
            self.differential.shape[1] + (self.precision > 0.0),
            self.is_counted,
        )

    def cross(self, left: Design, right: Design, part: slice | None = None) -> FloatArray:
        """Return the information (P, Q) between the columns of two designs, from all samples or a slice of them."""
        total = np.zeros((len(left.rows), len(right.rows)))
        same = left is right
        coupling = self.coupling[np.ix_(left.rows, right.rows)]
        for piece in self._pieces(part):
            counted = self.is_counted[piece]
            first = left.features[piece] * counted[:, None]
            second = first if same else right.features[piece]
            total += coupling * (first.T @ second)
            direction, precision = self.row_direction[piece], self.precision[piece]
            first = first * direction[:, left.rows] * precision[:, None]
            total += first.T @ (second * direction[:, right.rows])
        if left.scatter is not None:
            total = left.scatter.T @ total
        return total if right.scatter is None else total @ right.scatter

    def score(self, design: Design, part: slice | None = None) -> FloatArray:
        """Return the score (P,) of the columns of a design: their products with the residuals."""
        total = np.zeros(len(design.rows))
        for piece in self._pieces(part):
            by_row = self.row_score[piece]
            total += np.einsum("nj,nj->j", design.features[piece], by_row[:, design.rows])
        return total if design.scatter is None else total @ design.scatter

    @cached_property
    def row_score(self) -> FloatArray:
        """(N, 3K + 1) score of a shift of each row in each sample."""
        by_row = self.row_direction * (self.precision * self.misfit_T)[:, None]
        by_row[:, :-1] += self.differential @ self.directions.T
        by_row[~self.is_counted] = 0
        return by_row

    def normal(self, design: Design, part: slice | None = None) -> Normal:
        """Return the normal equations of a design from all samples or a slice of them."""
        chosen = slice(None) if part is None else part
        counted = self.is_counted[chosen]
        return Normal(
            self.cross(design, design, part),
            self.score(design, part),
            float(self.energy_per_sample[chosen][counted].sum()),
            float(self.channels_per_sample[chosen].sum()),
        )

    def _pieces(self, part: slice | None) -> Iterator[slice]:
        start, stop, step = (part or slice(None)).indices(len(self.misfit_T))
        for first in range(start, stop, _PIECE * step):
            yield slice(first, min(first + _PIECE * step, stop), step)


def calibration_design(situation: Situation) -> Design:
    """Return the design of the calibration itself: each row of [D Λ | o], in units of the mean intensity.

    Linear in data that hold noise of their own; that noise is part of the residual to second order only.
    """
    unit = float(np.mean(situation.intensity_T))
    features = np.column_stack([situation.field_T, np.full(situation.sample_count, unit)])
    count = situation.scalar_row
    rows = np.repeat(np.arange(count), 4)
    return Design(np.tile(features, count), rows, np.arange(4 * count), 4 * count)


def update(errors: SensorErrors, step: FloatArray, unit_T: float) -> tuple[FloatArray, FloatArray]:
    """Return matrices and biases after a step (12 K,) of ``calibration_design``."""
    change: Any = step.reshape(errors.sensor_count, 3, 4)
    return errors.matrix + change[..., :3], errors.bias_T + change[..., 3] * unit_T
