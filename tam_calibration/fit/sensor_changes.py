"""What may change in the sensors of an array, in one piece."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.correction.update import ALL_BIASES, COMMON_SCALE, KINDS, SEVERAL, in_words
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

FAR_RATIO = 1e5
"""Ratio from which each is fitted by itself: a bias of some fifty times the noise, over which lengths begin to bend."""

_NAMES = {
    "scale factor": ("x", "y", "z"),
    "non-orthogonality": ("θ", "φ", "ψ"),
    "bias": ("x", "y", "z"),
    "misalignment": ("α", "β", "γ"),
}


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What may have changed.

    Parameters
    ----------
    name : str
        For people: "bias of sensor 2".
    parameters : str
        Kind of the errors: one of `KINDS`, or what changes together.
    sensor : int
        Number of the sensor from 1; 0 where it is not one alone.
    directions : (12 K, M) array
        Changes of the errors by its M unknowns.
    components : tuple of str
        Names of the unknowns.
    unit : str
        Of the unknowns, SI.
    """

    name: str
    parameters: str
    sensor: int
    directions: FloatArray
    components: tuple[str, ...]
    unit: str


def changes_of_sensors(errors: SensorErrors) -> tuple[Hypothesis, ...]:
    """Return what may have changed in the sensors of an array.

    One kind of errors of one sensor, as when it is knocked; all errors of a sensor; the biases of all, as when a
    battery is swapped; the scalar magnetometer against all.

    Parameters
    ----------
    errors : SensorErrors
        Of the K sensors.
    """
    count = errors.sensor_count
    every = np.eye(12 * count).reshape(12 * count, count, 12)
    found = []
    for sensor in range(count):
        for place, kind in enumerate(KINDS):
            if kind == "misalignment" and count == 1:
                continue
            unit = {"scale factor": "1", "bias": "T"}.get(kind, "rad")
            found.append(_of(kind, sensor + 1, every[:, sensor, 3 * place : 3 * place + 3], _NAMES[kind], unit))
        found.append(_of(SEVERAL, sensor + 1, every[:, sensor]))
    if count == 1:
        return tuple(found)
    found.append(_of(ALL_BIASES, 0, every[:, :, 6:9].reshape(12 * count, -1), unit="T"))
    scale = (every[:, :, :3] * errors.scale_factor).sum(axis=(1, 2))[:, None]
    return (*found, _of(COMMON_SCALE, 0, scale, ("",), "1"))


def _of(kind: str, sensor: int, directions: FloatArray, components: tuple[str, ...] = (), unit: str = "") -> Hypothesis:
    return Hypothesis(in_words(kind, sensor), kind, sensor, directions, components, unit)
