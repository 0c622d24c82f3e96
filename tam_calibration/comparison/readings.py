"""Plain figures of the readings of a recording, and of two recordings in pairs."""

from collections.abc import Iterator

import numpy as np

from tam_calibration.comparison.figure import Figure, ReadingFigure
from tam_calibration.comparison.result import Side
from tam_calibration.core.noise import noise_deviation
from tam_calibration.fit.coverage import field_of, measure_coverage
from tam_calibration.gap.delays import estimate_delays
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.sensor_errors import PARAMETER_NAMES
from tam_calibration.model.units import FloatArray

LEAST_HOLE = 1.5
"""Interval over the median from which samples are missing: half a sample late is the most that jitter makes."""

SAME_RATE = 0.01
"""Part of a rate by which two may differ: drivers keep theirs no better."""

SAME_TIME = 0.01
"""Part of the interval by which two jitters may differ: clocks of computers make as much."""

SAME_PART = 0.01
"""Part of the samples by which two losses may differ: no figure of the rest depends on it."""

UNITS = ("1", "rad", "T", "rad")
"""SI units of scale factors, non-orthogonality, biases and misalignment."""


def figures_of(side: Side) -> tuple[ReadingFigure, ...]:
    """Return the figures of a recording: of its stamps, of each sensor and its errors, of the scalar and of the path.

    Parameters
    ----------
    side : Side
        Recording with its diagnosis.
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
    """Return the figures of two recordings in pairs.

    Parameters
    ----------
    simulation, recording : Side
        Of arrays with equally many sensors.
    """
    return tuple(map(Figure, figures_of(simulation), figures_of(recording)))


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
    yield ReadingFigure("stamps", "rate", "Hz", rate, rate_error, SAME_RATE * rate)
    yield ReadingFigure("stamps", "jitter", "s", jitter, jitter_error, SAME_TIME * step)
    yield ReadingFigure("stamps", "part lost", "1", lost, float(np.sqrt(lost * (1 - lost) / count)), SAME_PART)


def _delays(side: Side) -> Iterator[ReadingFigure]:
    """Yield how much later than sensor 1 the others are stamped; NaN where the motion does not show it."""
    count, step = side.recording.sensor_count, float(np.median(np.diff(side.recording.time_s)))
    delays = errors = np.full(count, np.nan)
    try:
        found = estimate_delays(side.recording, side.array)
        delays, errors = found.delay_s, found.standard_error_s
    except (InputError, Refused, np.linalg.LinAlgError):
        pass
    for sensor in range(1, count):
        name = f"delay of sensor {sensor + 1}"
        yield ReadingFigure("stamps", name, "s", float(delays[sensor]), float(errors[sensor]), SAME_TIME * step)


def _errors_of_sensors(side: Side) -> Iterator[ReadingFigure]:
    """Yield scale factors, non-orthogonality, biases and misalignment, which a calibration removes."""
    values, errors = side.calibration.errors.to_vector(), side.calibration.standard_errors
    for sensor in range(side.recording.sensor_count):
        for index, name in enumerate(PARAMETER_NAMES):
            value, error = float(values[sensor, index]), float(errors[sensor, index])
            yield ReadingFigure(f"sensor {sensor + 1}", name, UNITS[index // 3], value, error)


def _of_sensors(side: Side) -> Iterator[ReadingFigure]:
    """Yield the largest reading of each sensor. The diagnosis states steps and ranges that matter, as effects."""
    for sensor, largest in enumerate(np.abs(side.recording.readings_T).max(axis=(0, 2)).tolist(), 1):
        yield ReadingFigure(f"sensor {sensor}", "largest reading", "T", largest, is_of_simulation=False)


def _of_scalar(side: Side) -> Iterator[ReadingFigure]:
    """Yield whether there is a scalar, and the rate of its readings; NaN without one."""
    scalar_T, rate = side.recording.scalar_T, np.nan
    if scalar_T is not None and np.isfinite(scalar_T).sum() > 1:
        rate = 1 / float(np.median(np.diff(side.recording.time_s[np.isfinite(scalar_T)])))
    yield ReadingFigure("scalar", "present", "1", float(scalar_T is not None), 0.0)
    yield ReadingFigure("scalar", "rate", "Hz", rate, np.nan, SAME_RATE * rate)


def _coverage(side: Side) -> ReadingFigure:
    """Return the part of the sphere of directions in which the field was seen."""
    fraction = measure_coverage(field_of(side.recording, side.calibration.errors)).fraction
    return ReadingFigure("path", "part of the sphere", "1", fraction, is_of_simulation=False)
