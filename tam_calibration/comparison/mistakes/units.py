"""A simulator's unit of field or of time that is not the topic's: gauss for tesla, milliseconds for seconds.

That Gazebo Sim publishes gauss in a message that has tesla is its issue 2312; since its pull request 2460 the
magnetometer system has the element ``use_units_gauss``. MuJoCo has no unit of its own, and its default field is 0.5.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.comparison.mistakes.frames import in_microtesla
from tam_calibration.comparison.result import Mistake
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.geomagnetic_field import EARTH_FIELD
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

NEAR = 10.0
"""Times the other's intensity that a sound simulation may read, or a tenth of it: the Earth's field varies by 3.5 over
its places, and a bias may double what a sensor reads."""

SLOWEST_HZ, FASTEST_HZ = 1.0, 30e3
"""Rates of samples between which stamps are plausible: magnetometers and simulators give 5 to 1000 a second."""


@dataclass(frozen=True)
class _Unit:
    """What a field reads in a unit that is not the expected one, times what it should read."""

    times: float
    given: str
    expected: str = "tesla"


_UNITS = (
    _Unit(1e4, "gauss"),
    _Unit(1e3, "millitesla"),
    _Unit(1e6, "microtesla"),
    _Unit(1e9, "nanotesla"),
    _Unit(1e-3, "microtesla", "nanotesla"),
    _Unit(1e-6, "tesla", "microtesla"),
    _Unit(1e-9, "tesla", "nanotesla"),
)
"""Units of simulators and drivers, and those that a table of ours may state, of which another was meant."""

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
    own, other = _intensity(simulation), float(np.median(_intensity(recording)))
    units = [_unit(float(own[k]), other, array, _is_field(simulation.readings_T[:, k])) for k in range(len(own))]
    scalar_T = np.nan if simulation.scalar_T is None else float(np.nanmedian(simulation.scalar_T))
    of_scalar = _unit(scalar_T, other, array, True)
    mistakes = []
    for unit in dict.fromkeys(unit for unit in (*units, of_scalar) if unit is not None):
        sensors = [sensor for sensor, each in enumerate(units, 1) if each is unit]
        where = sensors_in_words([*sensors, *["scalar"] * (of_scalar is unit)], len(units))
        mistakes.append(_mistake(unit, where, float(own[sensors[0] - 1]) if sensors else scalar_T))
    divisors = np.array([1.0 if unit is None else unit.times for unit in units])
    in_tesla = replace(simulation, readings_T=simulation.readings_T / divisors[:, None])
    if in_tesla.scalar_T is not None and of_scalar is not None:
        in_tesla = replace(in_tesla, scalar_T=in_tesla.scalar_T / of_scalar.times)
    return mistakes, in_tesla


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


def _unit(own_T: float, other_T: float, array: Array, is_field: bool) -> _Unit | None:
    """Return the unit of an intensity, None for tesla or where no unit makes it that of a field."""
    if not own_T > 0 or array.field.hold(own_T) or EARTH_FIELD.hold(own_T) or other_T / NEAR < own_T < other_T * NEAR:
        return None
    fits = [
        unit
        for unit in _UNITS
        if (is_field or unit.times > 1)
        and (EARTH_FIELD.hold(own_T / unit.times) or array.field.hold(own_T / unit.times))
    ]
    return min(fits, key=lambda unit: abs(np.log(own_T / unit.times / other_T)), default=None)


def _mistake(unit: _Unit, where: str, own_T: float) -> Mistake:
    subject = "the simulation's field" if where.startswith("all sensors") else f"the simulation's field of {where}"
    return Mistake(
        f"{unit.given}_for_{unit.expected}",
        f"{subject} is in {unit.given}, and {unit.expected} is expected: {own_T:.3g} T is read instead of "
        f"{in_microtesla(own_T / unit.times)}",
        where,
        f"multiply the sensor's output by {1 / unit.times:g}; in MuJoCo write the field of the place in tesla, such as "
        '<option magnetic="0 2.1e-05 -4.3e-05"/>; in Gazebo Sim set <use_units_gauss>false</use_units_gauss> in the '
        "magnetometer system",
    )
