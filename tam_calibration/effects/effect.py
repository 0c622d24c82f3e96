"""What a physical effect is: the channels that it needs, what it adds to the readings, what it leaves in a residual.

A sample's rows are the readings of all sensors, row 3 i + a for axis a of sensor i, and last the scalar magnetometer.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.array import Array
from tam_calibration.effects.memory import Memory
from tam_calibration.errors import SensorErrors
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

SCALAR = -1
"""In place of a sensor's index: the scalar magnetometer."""

ALL = -2
"""In place of a sensor's index: all sensors alike."""

Shape = Mapping[str, float]
"""Parameters on which an effect depends otherwise than linearly, by name, SI: a time constant, a frequency."""

_HOLE = 3.0
"""A step of time that is so many times the median is a hole in the record."""


@dataclass(frozen=True, eq=False)
class Situation:
    """What happens to the array, as far as it is known.

    Parameters
    ----------
    time_s : (N,) array
        Time stamps, strictly increasing.
    field_T : (N, 3) array
        Field at the centre in the array frame: the truth in a simulation, what the sensors agree on in a diagnosis.
    errors : SensorErrors
        Of the sensors, in the same frame.
    array : Array
        Positions of the sensors.
    temperature_C, current_A : (N,) array, optional
        Channels, finite.
    attitude : (N, 4) array, optional
        Quaternions x, y, z, w from the array frame to the world, finite.
    memory : Memory, optional
        Of what was before, where these samples continue others.
    """

    time_s: FloatArray
    field_T: FloatArray
    errors: SensorErrors
    array: Array
    temperature_C: FloatArray | None = None
    current_A: FloatArray | None = None
    attitude: FloatArray | None = None
    memory: Memory | None = None

    @property
    def sample_count(self) -> int:
        """Number of samples N."""
        return len(self.time_s)

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""
        return self.errors.sensor_count

    @property
    def scalar_row(self) -> int:
        """The row of the scalar magnetometer, 3 K."""
        return 3 * self.sensor_count

    @cached_property
    def sensed_T(self) -> FloatArray:
        """(N, 3K) readings without bias: each axis' own share of the field."""
        sensed: FloatArray = self.field_T @ self.errors.matrix.reshape(-1, 3).T
        return sensed

    @cached_property
    def intensity_T(self) -> FloatArray:
        """(N,) length of the field."""
        intensity: FloatArray = norm(self.field_T, axis=1)
        return intensity

    @cached_property
    def step_s(self) -> float:
        """Median step of time; 1 for a single sample."""
        return float(np.median(np.diff(self.time_s))) if self.sample_count > 1 else 1.0

    @cached_property
    def stretches(self) -> tuple[slice, ...]:
        """The samples between holes of the record."""
        cuts = np.flatnonzero(np.diff(self.time_s) > _HOLE * self.step_s) + 1
        bounds = [0, *cuts.tolist(), self.sample_count]
        return tuple(slice(start, stop) for start, stop in pairwise(bounds))

    def take(self, index: slice | NDArray[Any]) -> "Situation":
        """Return the situation at the samples that a slice, mask or index selects."""
        channels = (self.temperature_C, self.current_A, self.attitude)
        temperature, current, attitude = (None if channel is None else channel[index] for channel in channels)
        field, time = self.field_T[index], self.time_s[index]
        return Situation(time, field, self.errors, self.array, temperature, current, attitude)


@dataclass(frozen=True)
class Coefficient:
    """Name and SI unit of a coefficient of an effect, as people read it: "offset x", "T/K"."""

    name: str
    unit: str


@dataclass(frozen=True, eq=False)
class Term:
    """Coefficients that stand or fall together, and what each adds to the rows.

    Atom j adds ``features[:, j]`` to row ``rows[j]`` per unit of coefficient ``columns[j]``.

    Parameters
    ----------
    sensor : int
        Index of the sensor, or ``SCALAR`` or ``ALL``.
    axis : int, optional
        Index of the axis, where a single one is affected.
    name : str
        What it is, "offset"; unique among the terms of the same sensor and axis.
    coefficients : tuple of Coefficient
        P of them.
    features : (N, J) array
        In tesla per unit of the coefficient.
    rows, columns : (J,) array of int
        Row and coefficient of each atom.
    """

    sensor: int
    axis: int | None
    name: str
    coefficients: tuple[Coefficient, ...]
    features: FloatArray
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]

    @classmethod
    def of_row(
        cls, situation: Situation, row: int, name: str, coefficients: Sequence[Coefficient], features: FloatArray
    ) -> "Term":
        """Make the term of one row whose coefficients have a feature each, (N, P)."""
        sensor, axis = (SCALAR, None) if row == situation.scalar_row else divmod(row, 3)
        columns = np.arange(len(coefficients))
        return cls(sensor, axis, name, tuple(coefficients), features, np.full(len(columns), row), columns)

    def signal(self, values: FloatArray, row_count: int) -> FloatArray:
        """Return what coefficients (P,) add to the rows, (N, row_count), tesla."""
        added = np.zeros((len(self.features), row_count))
        for atom, (row, column) in enumerate(zip(self.rows, self.columns, strict=True)):
            added[:, row] += values[column] * self.features[:, atom]
        return added


@dataclass(frozen=True)
class Contribution:
    """The values of a term: which sensor (index, ``SCALAR`` or ``ALL``), axis and term, and its coefficients in SI.

    ``standard_errors`` has an entry for each coefficient whose error is known.
    """

    sensor: int
    axis: int | None
    term: str
    values: Mapping[str, float]
    standard_errors: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FittedEffect:
    """An effect with numbers: what a diagnosis finds, a calibration keeps and a simulation adds.

    Parameters
    ----------
    effect : str
        Name of the effect.
    shape : mapping
        Parameters on which it depends otherwise than linearly, SI; empty where there are none.
    contributions : tuple of Contribution
        What it does, and to which sensors and axes.
    shape_errors : mapping
        Standard errors of the parameters of the shape, where they are known.
    """

    effect: str
    shape: Shape
    contributions: tuple[Contribution, ...]
    shape_errors: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Misfit:
    """What a model leaves of a recording, for effects that are found in it otherwise than by regression.

    Parameters
    ----------
    recording : Recording
        As read.
    situation : Situation
        What the model knows of it.
    differential : (N, 3K - 3) array
        Whitened residuals between the sensors, of unit variance under the model.
    directions : (3K, 3K - 3) array
        How a shift of each row by one tesla moves them.
    common_mode : (N,) array
        Whitened residual of the scalar against the length of the field; NaN where there is no reference.
    row_slope : (N, 3K + 1) array
        How a shift of each row by one tesla moves the common mode.
    channel_count : (N,) array
        Number of whitened channels of each sample.
    is_counted : (N,) array of bool
        False where a sample was given up, as an outlier or as saturated.
    """

    recording: Recording
    situation: Situation
    differential: FloatArray
    directions: FloatArray
    common_mode: FloatArray
    row_slope: FloatArray
    channel_count: FloatArray
    is_counted: NDArray[np.bool_]

    @cached_property
    def energy(self) -> FloatArray:
        """(N,) sums of the squares of each sample's whitened channels."""
        energy: FloatArray = np.sum(self.differential**2, axis=1) + np.nan_to_num(self.common_mode) ** 2
        return energy

    @cached_property
    def row_information(self) -> FloatArray:
        """(N, 3K + 1) inverse variance with which a sample tells a shift of one row alone, 1/T²."""
        of_rows = np.append(np.sum(self.directions**2, axis=1), 0.0)
        has_reference = np.isfinite(self.common_mode)
        information: FloatArray = of_rows + has_reference[:, None] * self.row_slope**2
        return information

    @cached_property
    def row_shift_T(self) -> FloatArray:
        """(N, 3K + 1) the shift of one row alone that explains a sample best, tesla; 0 where nothing tells it."""
        score = np.nan_to_num(self.common_mode)[:, None] * self.row_slope
        score[:, :-1] += self.differential @ self.directions.T
        information = self.row_information
        shift: FloatArray = np.divide(score, information, out=np.zeros_like(score), where=information > 0)
        return shift


@dataclass(frozen=True, eq=False)
class Finding:
    """What an effect says of a misfit without regression.

    Parameters
    ----------
    fitted : FittedEffect
        Where it was found, with its numbers.
    gain : float
        Twice the logarithm of the likelihood ratio against white noise of one free variance, at its best.
    parameter_count : int
        Free numbers that were spent on it, positions included.
    flagged : (N,) array of bool, optional
        Samples that cannot be used once it is known.
    variance : (3K + 1,) array, optional
        What it adds to the variance of each row, T².
    """

    fitted: FittedEffect
    gain: float
    parameter_count: int
    flagged: NDArray[np.bool_] | None = None
    variance: FloatArray | None = None


class Effect(ABC):
    """A physical effect that the model of scale factor, non-orthogonality, bias and misalignment does not hold.

    Attributes
    ----------
    name : str
        As in reports and on the command line.
    title : str
        For people: "bias that drifts with temperature".
    physics : str
        One or two sentences: what happens, and the source.
    channels : tuple of str
        Names of the fields of ``Recording`` that it needs.
    excitation : str
        What a recording must do to make it visible.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    physics: ClassVar[str]
    channels: ClassVar[tuple[str, ...]] = ()
    excitation: ClassVar[str]

    def obstacle(self, situation: Situation) -> str | None:
        """Return why a recording that has the channels cannot show this effect, in one clause; None where it can."""
        return None

    @abstractmethod
    def add(
        self, rows_T: FloatArray, situation: Situation, fitted: FittedEffect, generator: np.random.Generator
    ) -> FloatArray:
        """Return simulated rows (N, 3K + 1) with the effect in them, tesla."""


class LinearEffect(Effect):
    """An effect that adds a linear combination of known functions to the rows, for given parameters of its shape.

    Attributes
    ----------
    is_free_in_time : bool
        Whether it is a free function of time, so that whole blocks of time cannot be predicted from the others.
    is_causal : bool
        Whether what it adds to a sample depends on no later one, so that it can be taken off while samples arrive; its
        recursions then use the memory of the situation.
    is_of_site : bool
        Whether it belongs to where the recording was made: it does not go with the array to another place.
    shape_units : dict
        SI unit of each parameter of the shape.
    """

    is_free_in_time: ClassVar[bool] = False
    is_causal: ClassVar[bool] = True
    is_of_site: ClassVar[bool] = False
    shape_units: ClassVar[Mapping[str, str]] = {}

    def shapes(self, situation: Situation, misfit: Misfit) -> Iterable[Shape]:
        """Return the shapes to try; by default the one without parameters."""
        return ({},)

    @abstractmethod
    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return all that the effect could add, at all sensors that it could act on."""

    def signal(self, situation: Situation, fitted: FittedEffect) -> FloatArray:
        """Return what the effect adds to the rows, (N, 3K + 1), tesla."""
        row_count = situation.scalar_row + 1
        total = np.zeros((situation.sample_count, row_count))
        found = {(term.sensor, term.axis, term.name): term for term in self.terms(situation, fitted.shape)}
        for contribution in fitted.contributions:
            term = found[contribution.sensor, contribution.axis, contribution.term]
            values = np.array([contribution.values.get(coefficient.name, 0.0) for coefficient in term.coefficients])
            total += term.signal(values, row_count)
        return total

    def add(
        self, rows_T: FloatArray, situation: Situation, fitted: FittedEffect, generator: np.random.Generator
    ) -> FloatArray:
        """Return simulated rows (N, 3K + 1) with the effect in them, tesla."""
        return rows_T + self.signal(situation, fitted)


class FoundEffect(Effect):
    """An effect that is found in the readings or the residual by another test than regression.

    Attributes
    ----------
    is_certain : bool
        Whether it is a fact of the readings that no chance makes, and so comes before what explains as much.
    """

    is_certain: ClassVar[bool] = False

    @abstractmethod
    def find(self, misfit: Misfit) -> Finding | str:
        """Return what was found, or why nothing was, in one clause."""
