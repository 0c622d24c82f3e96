"""What no sensor of an array is: a calibration beyond these limits is of another unit, or went wrong."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray, from_degrees, to_degrees, to_nanotesla

LIMITS = {
    "bias": "a reading in zero field beyond the range of sensors of the Earth's field",
    "non_orthogonality": "axes far from being orthogonal",
    "residual": "intensities far from those of the field",
    "scale_factor": "an axis in another unit, or of another gain, than the others",
}
"""Names by which what is beyond a limit is told and accepted, and what each is."""

_SCALE_FACTORS = (0.5, 2.0)
"""Least and largest: chips are within 30 % of their data sheets, and the nearest other unit is ten times away."""

_LARGEST_NON_ORTHOGONALITY = from_degrees(15.0)
"""Of two axes, radians: ten times that of the worst chips; axes that are glued by hand are within it."""

_LARGEST_BIAS_T = 2e-3
"""Tesla: beyond the range of sensors that read the field of the Earth; beside the magnets of a phone it is 0.6 mT."""

_LARGEST_RESIDUAL = 0.05
"""Part of the intensity, some 2.5 µT, that the fit may leave: twice what a phone's chip leaves beside its currents."""


def beyond_limits(calibration: Calibration) -> dict[str, str]:
    """Return what is beyond the limits: by the name of each, a sentence on the sensor that is worst."""
    errors = calibration.errors
    found = {
        "scale_factor": _scale_factor(errors.scale_factor),
        "non_orthogonality": _non_orthogonality(errors.non_orthogonality),
        "bias": _bias(errors.bias_T),
        "residual": _residual(calibration.in_sample.sensor_intensity_T, calibration.intensity_T),
    }
    return {name: sentence for name, sentence in found.items() if sentence}


def within_limits(calibration: Calibration, accept: Collection[str]) -> Calibration:
    """Return a calibration that is within the limits, or beyond those alone that are accepted: this is a warning.

    Parameters
    ----------
    calibration : Calibration
        As it was fitted.
    accept : collection of str
        Names of `LIMITS`.

    Raises
    ------
    Refused
        When it is beyond another limit; the sentence has its name.
    """
    beyond = beyond_limits(calibration)
    for name, sentence in beyond.items():
        if name not in accept:
            raise Refused(f"{sentence}; where that is so, accept {name}")
    return replace(calibration, accepted=tuple(beyond), warnings=(*beyond.values(), *calibration.warnings))


def _scale_factor(factor: FloatArray) -> str:
    sensor, axis, value = _worst(factor, np.abs(np.log(factor)))
    least, most = _SCALE_FACTORS
    if least <= value <= most:
        return ""
    return (
        f"the scale factor of sensor {sensor} {axis} is {value:.3g}, not between {least} and {most}: that axis has "
        "another unit or gain than the others"
    )


def _non_orthogonality(angle: FloatArray) -> str:
    sensor, _, value = _worst(angle, np.abs(angle))
    if abs(value) <= _LARGEST_NON_ORTHOGONALITY:
        return ""
    return (
        f"the axes of sensor {sensor} are {abs(to_degrees(value)):.3g}° from being orthogonal, more than "
        f"{to_degrees(_LARGEST_NON_ORTHOGONALITY):.0f}°: the readings do not cover the sphere, or two axes are one"
    )


def _bias(bias_T: FloatArray) -> str:
    sensor, axis, value = _worst(bias_T, np.abs(bias_T))
    if abs(value) <= _LARGEST_BIAS_T:
        return ""
    return (
        f"the bias of sensor {sensor} {axis} is {to_nanotesla(value):.4g} nT, more than "
        f"{to_nanotesla(_LARGEST_BIAS_T):.0f} nT: no sensor of the field of the Earth reads so far"
    )


def _residual(residual_T: FloatArray, intensity_T: float) -> str:
    sensor, value = int(np.argmax(residual_T)), float(np.max(residual_T))
    if value <= _LARGEST_RESIDUAL * intensity_T:
        return ""
    return (
        f"the fit leaves {to_nanotesla(value):.4g} nT of sensor {sensor + 1}, more than {_LARGEST_RESIDUAL:.0%} of the "
        "field: its readings are not those of one sensor turned in one field"
    )


def _worst(values: FloatArray, size: FloatArray) -> tuple[int, str, float]:
    """Return sensor, counted from 1, axis and value where a size (K, 3) is largest."""
    sensor, axis = divmod(int(np.argmax(size)), 3)
    return sensor + 1, "xyz"[axis], float(values[sensor, axis])
