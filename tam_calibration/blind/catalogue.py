"""The sixteen effects by their names: what draws each, and the recording in which it can be seen."""

from dataclasses import dataclass

from tam_calibration.blind.disorder import noise_excess, outliers, periodic_interference
from tam_calibration.blind.disturbance import Draw
from tam_calibration.blind.electronics import nonlinearity, quantization, saturation, time_skew
from tam_calibration.blind.jumps import bias_jump
from tam_calibration.blind.material import eddy_current, flexure, hysteresis, temperature_drift
from tam_calibration.blind.motion import MOTIONS
from tam_calibration.blind.surroundings import (
    ambient_gradient,
    current_interference,
    geomagnetic_drift,
    scalar_heading_error,
)

MOVING = tuple(motion for motion in MOTIONS if motion != "turntable")


@dataclass(frozen=True)
class Entry:
    """One effect.

    Parameters
    ----------
    draw : callable
    channel : str
        The recorded channel that decides for it; nothing when the fields suffice.
    motions : tuple of str
        Those in which it can be seen.
    sensor_counts : tuple of int
        Those with which it can be told from others.
    scalar_needed : bool
    """

    draw: Draw
    channel: str = ""
    motions: tuple[str, ...] = MOTIONS
    sensor_counts: tuple[int, ...] = (2, 3, 4, 6)
    scalar_needed: bool = False


CATALOGUE = {
    "temperature_drift": Entry(temperature_drift, channel="temperature", sensor_counts=(1, 2, 3, 4, 6)),
    "hysteresis": Entry(hysteresis, sensor_counts=(3, 4, 6)),
    "nonlinearity": Entry(nonlinearity, sensor_counts=(3, 4, 6)),
    "time_skew": Entry(time_skew, motions=MOVING),
    "eddy_current": Entry(eddy_current, motions=MOVING),
    "ambient_gradient": Entry(ambient_gradient, channel="attitude", sensor_counts=(3, 4, 6)),
    "scalar_heading_error": Entry(scalar_heading_error, sensor_counts=(3, 4, 6), scalar_needed=True),
    "geomagnetic_drift": Entry(geomagnetic_drift, sensor_counts=(2, 3, 4, 6)),
    "bias_jump": Entry(bias_jump, sensor_counts=(1, 2, 3, 4, 6)),
    "current_interference": Entry(current_interference, channel="current"),
    "flexure": Entry(flexure, channel="attitude", sensor_counts=(3, 4, 6)),
    "periodic_interference": Entry(periodic_interference),
    "outliers": Entry(outliers, sensor_counts=(3, 4, 6)),
    "noise_excess": Entry(noise_excess, sensor_counts=(3, 4, 6)),
    "quantization": Entry(quantization),
    "saturation": Entry(saturation, sensor_counts=(1, 2, 3, 4, 6)),
}
"""The effects of the library, made by other physics than the library's."""

CHANNELS = ("temperature", "current", "attitude")
