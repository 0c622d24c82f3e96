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
    family : str
        Effects of one family at one sensor are hard to tell apart; no pair is made of them.
    channel : str
        The recorded channel that decides for it; nothing when the fields suffice.
    motions : tuple of str
        Those in which it can be seen.
    sensor_counts : tuple of int
        Those with which it can be told from others.
    scalar_needed : bool
    """

    draw: Draw
    family: str
    channel: str = ""
    motions: tuple[str, ...] = MOTIONS
    sensor_counts: tuple[int, ...] = (2, 3, 4, 6)
    scalar_needed: bool = False


CATALOGUE = {
    "temperature_drift": Entry(temperature_drift, "slow", channel="temperature", sensor_counts=(1, 2, 3, 4, 6)),
    "hysteresis": Entry(hysteresis, "transfer", sensor_counts=(3, 4, 6)),
    "nonlinearity": Entry(nonlinearity, "transfer", sensor_counts=(3, 4, 6)),
    "time_skew": Entry(time_skew, "motion", motions=MOVING),
    "eddy_current": Entry(eddy_current, "motion", motions=MOVING),
    "ambient_gradient": Entry(ambient_gradient, "room", channel="attitude", sensor_counts=(3, 4, 6)),
    "scalar_heading_error": Entry(scalar_heading_error, "scalar", sensor_counts=(3, 4, 6), scalar_needed=True),
    "geomagnetic_drift": Entry(geomagnetic_drift, "slow", sensor_counts=(2, 3, 4, 6)),
    "bias_jump": Entry(bias_jump, "slow", sensor_counts=(1, 2, 3, 4, 6)),
    "current_interference": Entry(current_interference, "slow", channel="current"),
    "flexure": Entry(flexure, "bending", channel="attitude", sensor_counts=(3, 4, 6)),
    "periodic_interference": Entry(periodic_interference, "disorder"),
    "outliers": Entry(outliers, "disorder", sensor_counts=(3, 4, 6)),
    "noise_excess": Entry(noise_excess, "disorder", sensor_counts=(3, 4, 6)),
    "quantization": Entry(quantization, "disorder"),
    "saturation": Entry(saturation, "transfer", sensor_counts=(1, 2, 3, 4, 6)),
}
"""The effects of the library, made by other physics than the library's."""

CHANNELS = ("temperature", "current", "attitude")
