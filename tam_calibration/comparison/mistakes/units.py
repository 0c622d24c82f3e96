"""A simulator's unit of field or of time that is not the topic's: gauss for tesla, milliseconds for seconds.

That Gazebo Sim publishes gauss in a message that has tesla is its issue 2312; since its pull request 2460 the
magnetometer system has the element ``use_units_gauss``. MuJoCo has no unit of its own, and its default field is 0.5.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tam_calibration.comparison.result import Mistake
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.geomagnetic_field import EARTH_FIELD
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT, FloatArray

NEAR = 10.0
"""Times the other's intensity that a sound simulation may read, or a tenth of it: the Earth's field varies by 3.5 over
its places, and a bias may double what a sensor reads."""

SLOWEST_HZ, FASTEST_HZ = 1.0, 30e3
"""Rates of samples between which stamps are plausible: magnetometers and simulators give 5 to 1000 a second."""


_SYMBOLS = {"gauss": "G", "millitesla": "mT", "microtesla": "uT", "nanotesla": "nT", "tesla": "T"}
"""Symbols of the units that simulators and drivers use."""

_UNITS = {
    (given, expected): TESLA_PER_FIELD_UNIT[_SYMBOLS[expected]] / TESLA_PER_FIELD_UNIT[_SYMBOLS[given]]
    for given, expected in [
        *((unit, "tesla") for unit in _SYMBOLS if unit != "tesla"),
        ("microtesla", "nanotesla"),
        ("tesla", "microtesla"),
        ("tesla", "nanotesla"),
    ]
}
"""Units of simulators and drivers that are given, those that are expected, and times what a field then reads."""

_CLOCKS = {1e-9: "nanoseconds", 1e-6: "microseconds", 1e-3: "milliseconds", 1e3: "thousands of seconds"}
"""Unit of stamps, by what the rate of samples is then multiplied with."""


def mistaken_units(simulation: Recording, recording: Recording, array: Array) -> tuple[list[Mistake], Recording]:
    """Return which sensors are in another unit, and the simulation in tesla.

    Parameters
    ----------
    simulation, recording : Recording
        The two, as they were read.
    array : Array
        Of the simulation: what the intensity of its field can be.
    """
    other_T, count = float(np.median(_intensity(recording))), simulation.sensor_count
    scalar_T = np.nan if simulation.scalar_T is None else float(np.nanmedian(simulation.scalar_T))
    own_T = [*_intensity(simulation).tolist(), scalar_T]
    are_fields = [*(_is_field(simulation.readings_T[:, sensor]) for sensor in range(count)), True]
    units = [_unit(one_T, other_T, array, is_field) for one_T, is_field in zip(own_T, are_fields, strict=True)]
    mistakes = []
    for unit in dict.fromkeys(filter(None, units)):
        rows = [row for row, each in enumerate(units) if each == unit]
        where = sensors_in_words(["scalar" if row == count else row + 1 for row in rows], count)
        mistakes.append(_mistake(unit, where, own_T[rows[0]]))
    *divisors, of_scalar = [1.0 if unit is None else _UNITS[unit] for unit in units]
    readings = simulation.readings_T / np.array(divisors)[:, None]
    scalar = None if simulation.scalar_T is None else simulation.scalar_T / of_scalar
    return mistakes, replace(simulation, readings_T=readings, scalar_T=scalar)


def mistaken_stamps(simulation: Recording, recording: Recording) -> Iterator[Mistake]:
    """Yield the unit of the simulation's stamps, as its rate of samples and the recording's show it.

    Parameters
    ----------
    simulation, recording : Recording
        The two.
    """
    if min(simulation.sample_count, recording.sample_count) < 2:
        return
    own_hz, other_hz = (1 / float(np.median(np.diff(each.time_s))) for each in (simulation, recording))
    if SLOWEST_HZ < own_hz < FASTEST_HZ:
        return
    for times, unit in _CLOCKS.items():
        # Rates may differ from a power of 1000 as those of 20 and 100 samples a second do.
        if abs(np.log10(own_hz / other_hz / times)) < 0.8:
            yield Mistake(
                "unit_of_time",
                f"the simulation's stamps are in {unit}, and stamps are in seconds: {own_hz:.3g} samples a second, "
                f"where the recording has {other_hz:.3g}",
                "the stamps",
                f"multiply the simulation's stamps by {times:g} before they are written",
            )
            return
    if own_hz > 1e6:
        yield Mistake(
            "time_stands_still",
            f"the simulation's time stands still: its samples are {1 / own_hz:.1g} s apart, where the recording's are "
            f"{1 / other_hz:.3g} s apart",
            "the stamps",
            "stamp each sample with the simulator's own time, MuJoCo's data.time or Gazebo's /clock (use_sim_time)",
        )


def _intensity(recording: Recording) -> FloatArray:
    """Return (K,) what the sensors mostly read, tesla."""
    return np.asarray(np.median(np.linalg.norm(recording.readings_T, axis=2), axis=0))


def _is_field(readings_T: FloatArray) -> bool:
    """Whether readings (N, 3) are those of a field in which the sensor was turned, and not noise or a bias."""
    length = np.linalg.norm(readings_T, axis=1)
    turned = np.sqrt(np.sum(np.var(readings_T, axis=0)))
    # The intensity of a field is steady; that of noise about zero varies by 42 %.
    return bool(np.std(length) < 0.25 * np.mean(length) < turned)


def _unit(own_T: float, other_T: float, array: Array, is_field: bool) -> tuple[str, str] | None:
    """Return the unit of an intensity, None for tesla or where no unit makes it that of a field."""
    if not own_T > 0 or array.field.hold(own_T) or EARTH_FIELD.hold(own_T) or other_T / NEAR < own_T < other_T * NEAR:
        return None
    fits = [
        unit
        for unit, times in _UNITS.items()
        if (is_field or times > 1) and (EARTH_FIELD.hold(own_T / times) or array.field.hold(own_T / times))
    ]
    return min(fits, key=lambda unit: abs(np.log(own_T / _UNITS[unit] / other_T)), default=None)


def _mistake(unit: tuple[str, str], where: str, own_T: float) -> Mistake:
    (given, expected), times = unit, _UNITS[unit]
    subject = "the simulation's field" if where.startswith("all sensors") else f"the simulation's field of {where}"
    return Mistake(
        f"{given}_for_{expected}",
        f"{subject} is in {given}, and {expected} is expected: {own_T:.3g} T is read instead of "
        f"{own_T / times * 1e6:.3g} µT",
        where,
        f"multiply the sensor's output by {1 / times:g}; in MuJoCo write the field of the place in tesla, such as "
        '<option magnetic="0 2.1e-05 -4.3e-05"/>; in Gazebo Sim set <use_units_gauss>false</use_units_gauss> in the '
        "magnetometer system",
    )
