"""Plain figures of the readings of a recording, and those of two beside each other."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tam_calibration.comparison.result import Figure, Side, Standing
from tam_calibration.core.noise import noise_deviation
from tam_calibration.effects.quantization import find_lattices
from tam_calibration.effects.saturation import find_limits
from tam_calibration.fit.coverage import field_of, measure_coverage
from tam_calibration.gap.delays import estimate_delays
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.sensor_errors import PARAMETER_NAMES
from tam_calibration.model.units import FloatArray

LEAST_HOLE = 1.5
"""Interval over the median from which samples are missing: half a sample late is the most that jitter makes."""

CERTAIN = 4.5
"""Standard errors from which two figures differ: of some hundred by chance in one of a thousand comparisons."""

SAME_RATE = 0.01
"""Part of a rate by which two may differ: drivers keep theirs no better."""

SAME_TIME = 0.01
"""Part of the interval by which two jitters may differ: clocks of computers make as much."""

RESOLUTION_S = 1e-9
"""Of stamps in ROS, seconds: jitter below it is rounding."""

SAME_PART = 0.01
"""Part of the samples by which two losses may differ: no figure of the rest depends on it."""

SAME_STEP = 0.01
"""Part of a step by which two may differ: it is found to much less."""

SAME_RANGE = 0.01
"""Part of a range by which two may differ: the offset of an amplifier moves its ends by as much."""

UNITS = ("1", "rad", "T", "rad")
"""SI units of scale factors, non-orthogonality, biases and misalignment."""


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
    standard_error: float
    tolerance: float
    is_of_simulation: bool


def figures_of(side: Side) -> tuple[ReadingFigure, ...]:
    """Return the figures of a recording: of its stamps, of each sensor and its errors, of the scalar and of the path.

    Parameters
    ----------
    side : Side
        Recording with its diagnosis, which tells the noise beside which steps are coarse.
    """
    return (
        *_of_stamps(side.recording.time_s),
        *_delays(side),
        *_of_sensors(side),
        *_errors_of_sensors(side),
        *_of_scalar(side),
        _coverage(side),
    )


def side_by_side(simulation: Side, recording: Side) -> tuple[Figure, ...]:
    """Return the figures of two recordings beside each other.

    Figures are the same where they differ by no more than their tolerance or 4.5 standard errors. What is of the path
    is stated, and never differs. Where one side is NaN nothing can be told.

    Parameters
    ----------
    simulation, recording : Side
        Of arrays with equally many sensors.
    """
    return tuple(_beside(*pair) for pair in zip(figures_of(simulation), figures_of(recording), strict=True))


def _beside(simulation: ReadingFigure, recording: ReadingFigure) -> Figure:
    return Figure(
        simulation.group,
        simulation.name,
        simulation.unit,
        simulation.value,
        recording.value,
        simulation.standard_error,
        recording.standard_error,
        _standing(simulation, recording),
    )


def _standing(simulation: ReadingFigure, recording: ReadingFigure) -> Standing:
    difference = abs(recording.value - simulation.value)
    if not np.isfinite(difference):
        return "cannot tell"
    errors = np.nan_to_num([simulation.standard_error, recording.standard_error])
    chance = CERTAIN * float(np.hypot(errors[0], errors[1]))
    is_same = difference <= max(simulation.tolerance, recording.tolerance, chance)
    return "same" if is_same or not simulation.is_of_simulation else "differs"


def _of_stamps(time_s: FloatArray) -> Iterator[ReadingFigure]:
    """Yield rate, jitter and loss."""
    interval = np.diff(time_s)
    step = float(np.median(interval))
    is_hole = interval >= LEAST_HOLE * step
    missing = float(np.rint(interval[is_hole] / step - 1).sum())
    jitter = float(noise_deviation(interval[~is_hole] - step))
    jitter = jitter if jitter > RESOLUTION_S else 0.0
    lost = missing / (missing + len(time_s))
    rate, count = 1 / step, len(interval)
    # A median has 2/π of the information on a mean, a median of absolute deviations 37 % of that on a deviation.
    rate_error = rate * jitter / step * float(np.sqrt(np.pi / 2 / count))
    jitter_error = jitter / float(np.sqrt(2 * 0.37 * count))
    yield ReadingFigure("stamps", "rate", "Hz", rate, rate_error, SAME_RATE * rate, True)
    yield ReadingFigure("stamps", "jitter", "s", jitter, jitter_error, SAME_TIME * step, True)
    yield ReadingFigure("stamps", "part lost", "1", lost, float(np.sqrt(lost * (1 - lost) / count)), SAME_PART, True)


def _delays(side: Side) -> Iterator[ReadingFigure]:
    """Yield how much later than sensor 1 the others are stamped; NaN where the motion does not tell."""
    count, step = side.recording.sensor_count, float(np.median(np.diff(side.recording.time_s)))
    delays = errors = np.full(count, np.nan)
    try:
        found = estimate_delays(side.recording, side.array)
        delays, errors = found.delay_s, found.standard_error_s
    except (InputError, Refused, np.linalg.LinAlgError):
        pass
    for sensor in range(1, count):
        name = f"delay of sensor {sensor + 1}"
        yield ReadingFigure("stamps", name, "s", float(delays[sensor]), float(errors[sensor]), SAME_TIME * step, True)


def _errors_of_sensors(side: Side) -> Iterator[ReadingFigure]:
    """Yield scale factors, non-orthogonality, biases and misalignment, which a calibration removes."""
    values, errors = side.calibration.errors.to_vector(), side.calibration.standard_errors
    for sensor in range(side.recording.sensor_count):
        for index, name in enumerate(PARAMETER_NAMES):
            value, error = float(values[sensor, index]), float(errors[sensor, index])
            yield ReadingFigure(f"sensor {sensor + 1}", name, UNITS[index // 3], value, error, 0.0, True)


def _of_sensors(side: Side) -> Iterator[ReadingFigure]:
    """Yield the step of each axis, each sensor's range, and its largest reading.

    The step is NaN where none is seen beside the noise. The range is where the readings of an axis stay at an end, the
    least of its axes; NaN where the field never reached it.
    """
    residuals = side.found.nominal.channels().residuals
    steps = {lattice.row: lattice.step_T for lattice in find_lattices(residuals)}
    ends = [(limit.row // 3, abs(limit.value_T)) for limit in find_limits(residuals)]
    for row in range(3 * side.recording.sensor_count):
        step, name = steps.get(row, np.nan), f"{'xyz'[row % 3]} step"
        yield ReadingFigure(f"sensor {row // 3 + 1}", name, "T", step, np.nan, SAME_STEP * step, True)
    for sensor, largest in enumerate(np.abs(side.recording.readings_T).max(axis=(0, 2)).tolist()):
        reached, group = min((end for of, end in ends if of == sensor), default=np.nan), f"sensor {sensor + 1}"
        yield ReadingFigure(group, "range", "T", reached, np.nan, SAME_RANGE * reached, True)
        yield ReadingFigure(group, "largest reading", "T", largest, np.nan, 0.0, False)


def _of_scalar(side: Side) -> Iterator[ReadingFigure]:
    """Yield whether there is a scalar, and the rate of its readings; NaN without one."""
    scalar_T, rate = side.recording.scalar_T, np.nan
    if scalar_T is not None and np.isfinite(scalar_T).sum() > 1:
        rate = 1 / float(np.median(np.diff(side.recording.time_s[np.isfinite(scalar_T)])))
    yield ReadingFigure("scalar", "present", "1", float(scalar_T is not None), 0.0, 0.0, True)
    yield ReadingFigure("scalar", "rate", "Hz", rate, np.nan, SAME_RATE * rate, True)


def _coverage(side: Side) -> ReadingFigure:
    """Return the part of the sphere of directions in which the field was seen."""
    fraction = measure_coverage(field_of(side.recording, side.calibration.errors)).fraction
    return ReadingFigure("path", "part of the sphere", "1", fraction, np.nan, 0.0, False)
