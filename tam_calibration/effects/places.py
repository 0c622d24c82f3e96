"""Where an effect may sit: which rows of a sample it acts on, and how much of a sample's energy these explain."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from tam_calibration.effects.fitted import ALL, SCALAR, Contribution
from tam_calibration.effects.misfit import Misfit
from tam_calibration.effects.ridge import ridged
from tam_calibration.effects.situation import Situation
from tam_calibration.units import FloatArray


@dataclass(frozen=True)
class Place:
    """Some axes of a sensor, or the scalar magnetometer, or all.

    Parameters
    ----------
    sensor : int
        Index of the sensor, or ``SCALAR`` or ``ALL``.
    axes : tuple of int
        Indices of its axes.
    rows : tuple of int
        The same as rows of a sample.
    """

    sensor: int
    axes: tuple[int, ...]
    rows: tuple[int, ...]

    def contribution_keys(self, is_whole: bool = True) -> tuple[tuple[int, int | None], ...]:
        """Return sensor and axis of each contribution: one without axis for a sensor as a whole, else one per axis."""
        if not self.axes or (is_whole and len(self.axes) == 3):
            return ((self.sensor, None),)
        return tuple((self.sensor, axis) for axis in self.axes)


def places(sensor_count: int) -> list[Place]:
    """Return the scalar, and of every sensor each axis, each pair of axes and all three."""
    found = [Place(SCALAR, (), (3 * sensor_count,))]
    for sensor in range(sensor_count):
        for count in (1, 2, 3):
            for axes in combinations(range(3), count):
                found.append(Place(sensor, axes, tuple(3 * sensor + axis for axis in axes)))
    return found


def everywhere(sensor_count: int) -> Place:
    """Return the place of what acts on all sensors alike."""
    return Place(ALL, (), tuple(range(3 * sensor_count)))


def rows_of(part: Contribution, situation: Situation) -> list[int]:
    """Return the rows on which a contribution acts."""
    if part.sensor == SCALAR:
        return [situation.scalar_row]
    sensors = range(situation.sensor_count) if part.sensor == ALL else [part.sensor]
    axes = range(3) if part.axis is None else [part.axis]
    return [3 * sensor + axis for sensor in sensors for axis in axes]


def row_scores(misfit: Misfit) -> FloatArray:
    """Return the (N, 3K + 1) products of each sample's channels with what a shift of each row does to them, 1/T."""
    scores: FloatArray = misfit.row_shift_T * misfit.row_information
    return scores


def row_deviations(misfit: Misfit) -> FloatArray:
    """Return the (N, 3K + 1) shift of each row alone in its standard errors: its square is the energy it explains."""
    deviations: FloatArray = misfit.row_shift_T * np.sqrt(misfit.row_information)
    return deviations


def explained_energy(misfit: Misfit, samples: np.ndarray, place: Place) -> FloatArray:
    """Return the energy of chosen samples that shifts of the rows of a place explain."""
    rows = np.array(place.rows)
    slope = misfit.row_slope[np.ix_(samples, rows)] * np.isfinite(misfit.common_mode[samples])[:, None]
    differential = np.vstack([misfit.directions, np.zeros((1, misfit.directions.shape[1]))])[rows]
    gram = ridged(differential @ differential.T + slope[:, :, None] * slope[:, None, :])
    score = misfit.differential[samples] @ differential.T + np.nan_to_num(misfit.common_mode[samples])[:, None] * slope
    energy: FloatArray = np.sum(score * np.linalg.solve(gram, score[:, :, None])[:, :, 0], axis=1)
    return energy
