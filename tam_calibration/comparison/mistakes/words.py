"""Sensors and fields in the sentences that tell a simulator's mistakes."""

from collections.abc import Sequence

from tam_calibration.model.units import FloatArray


def sensors_in_words(sensors: Sequence[int], count: int) -> str:
    """Return sensors, numbered from 1, of so many for people."""
    return "all sensors" if len(sensors) == count else numbered(sensors)


def numbered(sensors: Sequence[int]) -> str:
    """Return sensors, by their numbers from 1, for people."""
    *some, last = map(str, sensors)
    return f"sensors {', '.join(some)} and {last}" if some else f"sensor {last}"


def in_microtesla(tesla: float) -> str:
    """Return an intensity for people."""
    return f"{tesla * 1e6:.3g} µT"


def vector_in_microtesla(tesla: FloatArray) -> str:
    """Return a field (3,) east, north, up for people."""
    return f"({', '.join(f'{component * 1e6:.3g}' for component in tesla)}) µT"
