"""One of the two recordings with what the judge says of it, and plain figures of both in pairs."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from tam_calibration.core.noise import noise_deviation
from tam_calibration.correction.calibration import Calibration
from tam_calibration.effects.grades import NEGLIGIBLE
from tam_calibration.fit.coverage import field_of, measure_coverage
from tam_calibration.gap.delays import estimate_delays
from tam_calibration.gap.result import Gap
from tam_calibration.gap.steps import Search
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import PARAMETER_NAMES
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Side:
    """One of the two recordings, and what the judge says of it.

    Parameters
    ----------
    recording : Recording
        The samples.
    array : Array
        As its file states it.
    gap : Gap
        Diagnosis.
    calibration : Calibration
        With the effects of the diagnosis.
    found : Search
        The search that the diagnosis rests on: models without and with the causes.
    """

    recording: Recording = field(repr=False)
    array: Array
    gap: Gap
    calibration: Calibration
    found: Search = field(repr=False)


Standing = Literal["same", "differs", "cannot tell"]


@dataclass(frozen=True)
class ReadingFigure:
    """A plain figure of one recording.

    Parameters
    ----------
    group, name : str
        Such as "stamps", "rate".
    unit : str
        SI unit; "1" for none.
    value : float
        NaN where the recording has none.
    standard_error : float
        NaN where it is not known.
    tolerance : float
        Difference that is none in practice, in the unit of the value.
    is_of_simulation : bool
        Whether a difference is one of the simulation; else it is of the path that was flown.
    """

    group: str
    name: str
    unit: str
    value: float
    standard_error: float = float("nan")
    tolerance: float = 0.0
    is_of_simulation: bool = True


CERTAIN = 4.5
"""Standard errors from which two figures differ: of some hundred by chance in one of a thousand comparisons."""


@dataclass(frozen=True)
class Figure:
    """One figure of the simulation and the same of the recording."""

    simulation: ReadingFigure
    recording: ReadingFigure

    @property
    def difference(self) -> float:
        """How far the two values are apart, in the unit of the figure."""
        return abs(self.recording.value - self.simulation.value)

    @property
    def standard_errors(self) -> float:
        """The recording's value less the simulation's, in standard errors of the difference; NaN where not known."""
        size = float(np.hypot(self.simulation.standard_error, self.recording.standard_error))
        return (self.recording.value - self.simulation.value) / size if size > 0 else float("nan")

    @property
    def standing(self) -> Standing:
        """Whether the two differ beyond tolerance and chance; what is of the path never does."""
        if not np.isfinite(self.difference):
            return "cannot tell"
        chance = CERTAIN * np.hypot(*np.nan_to_num([self.simulation.standard_error, self.recording.standard_error]))
        is_same = self.difference <= max(self.simulation.tolerance, self.recording.tolerance, chance)
        return "same" if is_same or not self.simulation.is_of_simulation else "differs"


LEAST_HOLE = 1.5
"""Interval over the median from which samples are missing: half a sample late is the most that jitter makes."""

UNITS = ("1", "rad", "T", "rad")
"""SI units of scale factors, non-orthogonality, biases and misalignment."""


def side_by_side(simulation: Side, recording: Side) -> tuple[Figure, ...]:
    """Return the figures of two recordings in pairs.

    Parameters
    ----------
    simulation, recording : Side
        Of arrays with equally many sensors.
    """
    return tuple(map(Figure, _figures_of(simulation), _figures_of(recording)))


def _figures_of(side: Side) -> Iterator[ReadingFigure]:
    """Yield the figures of a recording: of its stamps, of each sensor and its errors, of the scalar and of the path."""
    recording, errors = side.recording, side.calibration.errors
    yield from _of_stamps(recording.time_s)
    yield from _delays(side)
    # The diagnosis states steps and ranges that matter, as effects.
    for sensor, largest in enumerate(np.abs(recording.readings_T).max(axis=(0, 2)).tolist(), 1):
        yield ReadingFigure(f"sensor {sensor}", "largest reading", "T", largest, is_of_simulation=False)
    pairs = zip(errors.to_vector().tolist(), side.calibration.standard_errors.tolist(), strict=True)
    for sensor, (values, their_errors) in enumerate(pairs, 1):
        for index, name in enumerate(PARAMETER_NAMES):
            yield ReadingFigure(f"sensor {sensor}", name, UNITS[index // 3], values[index], their_errors[index])
    yield from _of_scalar(recording)
    fraction = measure_coverage(field_of(recording, errors)).fraction
    yield ReadingFigure("path", "part of the sphere", "1", fraction, is_of_simulation=False)


def _of_stamps(time_s: FloatArray) -> Iterator[ReadingFigure]:
    """Yield rate, jitter and loss."""
    interval = np.diff(time_s)
    step = float(np.median(interval))
    is_hole = interval >= LEAST_HOLE * step
    missing = float(np.rint(interval[is_hole] / step - 1).sum())
    jitter = float(noise_deviation(interval[~is_hole] - step))
    # Jitter below the resolution of stamps in ROS is rounding.
    jitter = jitter if jitter > 1e-9 else 0.0
    lost = missing / (missing + len(time_s))
    rate, count = 1 / step, len(interval)
    # A median has 2/π of the information on a mean, a median of absolute deviations 37 % of that on a deviation.
    rate_error = rate * jitter / step * float(np.sqrt(np.pi / 2 / count))
    jitter_error = jitter / float(np.sqrt(2 * 0.37 * count))
    # Clocks and drivers keep rates and intervals no better than to a negligible part.
    yield ReadingFigure("stamps", "rate", "Hz", rate, rate_error, NEGLIGIBLE * rate)
    yield ReadingFigure("stamps", "jitter", "s", jitter, jitter_error, NEGLIGIBLE * step)
    yield ReadingFigure("stamps", "part lost", "1", lost, float(np.sqrt(lost * (1 - lost) / count)), NEGLIGIBLE)


def _delays(side: Side) -> Iterator[ReadingFigure]:
    """Yield how much later than sensor 1 the others are stamped; NaN where the motion does not show it."""
    count, step = side.recording.sensor_count, float(np.median(np.diff(side.recording.time_s)))
    delays = errors = np.full(count, np.nan)
    with suppress(InputError, Refused, np.linalg.LinAlgError):
        found = estimate_delays(side.recording, side.array)
        delays, errors = found.delay_s, found.standard_error_s
    for sensor in range(1, count):
        name = f"delay of sensor {sensor + 1}"
        yield ReadingFigure("stamps", name, "s", float(delays[sensor]), float(errors[sensor]), NEGLIGIBLE * step)


def _of_scalar(recording: Recording) -> Iterator[ReadingFigure]:
    """Yield whether there is a scalar, and the rate of its readings; NaN without one."""
    scalar_T, rate = recording.scalar_T, np.nan
    if scalar_T is not None and np.isfinite(scalar_T).sum() > 1:
        rate = 1 / float(np.median(np.diff(recording.time_s[np.isfinite(scalar_T)])))
    yield ReadingFigure("scalar", "present", "1", float(scalar_T is not None), 0.0)
    yield ReadingFigure("scalar", "rate", "Hz", rate, np.nan, NEGLIGIBLE * rate)
