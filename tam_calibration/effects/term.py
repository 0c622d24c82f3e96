"""What an effect could add to the rows: functions of the situation, each times an unknown coefficient."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.fitted import SCALAR
from tam_calibration.effects.situation import Situation
from tam_calibration.units import FloatArray

Key = tuple[int, int | None, str]
"""Sensor, axis and name of a term."""


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
        return cls(sensor, axis, name, tuple(coefficients), features, *_of_row(row, len(coefficients)))

    @property
    def key(self) -> Key:
        """What tells it from the other terms of an effect."""
        return self.sensor, self.axis, self.name

    def signal(self, values: FloatArray, row_count: int) -> FloatArray:
        """Return what coefficients (P,) add to the rows, (N, row_count), tesla."""
        added = np.zeros((len(self.features), row_count))
        for atom, (row, column) in enumerate(zip(self.rows, self.columns, strict=True)):
            added[:, row] += values[column] * self.features[:, atom]
        return added


def chosen(terms: Iterable[Term], keys: Sequence[Key]) -> list[Term]:
    """Return those of an effect's terms that have some keys, in the order of these."""
    wanted = set(keys)
    found = {term.key: term for term in terms if term.key in wanted}
    return [found[key] for key in keys]


def thinned(terms: Iterable[Term], stride: int) -> Iterator[Term]:
    """Yield terms at samples of a distance; those that hold the same features go on sharing them."""
    known: dict[int, tuple[ref[FloatArray], FloatArray]] = {}
    for term in terms:
        whole, own = known.get(id(term.features), (None, term.features))
        if whole is None or whole() is not term.features:
            own = term.features[::stride].copy()
            known[id(term.features)] = ref(term.features), own
        yield replace(term, features=own)


@cache
def _of_row(row: int, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns of atoms that are all of one row."""
    rows, columns = np.full(count, row), np.arange(count)
    rows.flags.writeable = columns.flags.writeable = False
    return rows, columns
