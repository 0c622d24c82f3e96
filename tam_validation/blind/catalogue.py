"""All kinds of causes by their names: the library's effects, made by other physics than the library's, and others."""

from tam_validation.blind.disorder import bias_jump, noise_excess, outliers, periodic_interference
from tam_validation.blind.disturbance import MOVING, SEVERAL, Entry
from tam_validation.blind.instrument_faults import (
    crosstalk,
    gain_switching,
    interpolated_samples,
    nonlinearity,
    quantization,
    ringing,
    saturation,
    scale_step,
    stale_samples,
    time_skew,
    timing_jitter,
)
from tam_validation.blind.material import eddy_current, flexure, hysteresis, temperature_drift
from tam_validation.blind.outside import OUTSIDE
from tam_validation.blind.surroundings import (
    ambient_gradient,
    current_interference,
    geomagnetic_drift,
    scalar_heading_error,
)
from tam_validation.blind.vehicle import platform_field

_ANY = (1, 2, 3, 4, 6)

CATALOGUE = {
    "temperature_drift": Entry(temperature_drift, "slow", channel="temperature", sensor_counts=_ANY, most_nT=5000),
    "hysteresis": Entry(hysteresis, "transfer", sensor_counts=SEVERAL, most_nT=2000),
    "nonlinearity": Entry(nonlinearity, "transfer", sensor_counts=SEVERAL, most_nT=3000),
    "time_skew": Entry(time_skew, "motion", motions=MOVING),
    "eddy_current": Entry(eddy_current, "motion", motions=MOVING, most_nT=2000),
    "ambient_gradient": Entry(ambient_gradient, "room", channel="attitude", sensor_counts=SEVERAL),
    "scalar_heading_error": Entry(
        scalar_heading_error, "scalar", sensor_counts=SEVERAL, scalar_needed=True, most_nT=100, large=(30.0,)
    ),
    "geomagnetic_drift": Entry(
        geomagnetic_drift, "slow", sensor_counts=(2, *SEVERAL), most_nT=300, most_nT_per_s=8.0, large=(30.0,)
    ),
    "bias_jump": Entry(bias_jump, "slow", sensor_counts=_ANY, most_nT=50_000),
    "current_interference": Entry(current_interference, "slow", channel="current"),
    "flexure": Entry(flexure, "bending", channel="attitude", sensor_counts=SEVERAL, most_nT=3000),
    "periodic_interference": Entry(periodic_interference, "disorder"),
    "outliers": Entry(outliers, "disorder", sensor_counts=SEVERAL, most_nT=100_000),
    "noise_excess": Entry(noise_excess, "disorder", sensor_counts=SEVERAL, large=(30.0,)),
    "quantization": Entry(quantization, "disorder", most_nT=1000),
    "saturation": Entry(saturation, "transfer", sensor_counts=_ANY),
    "stale_samples": Entry(stale_samples, "timing", motions=MOVING, sensor_counts=SEVERAL, most_nT=50_000, coarse=True),
    "timing_jitter": Entry(timing_jitter, "timing", motions=MOVING, sensor_counts=SEVERAL),
    "interpolated_samples": Entry(
        interpolated_samples, "timing", motions=MOVING, sensor_counts=SEVERAL, large=(30.0,), coarse=True
    ),
    "gain_switching": Entry(gain_switching, "gain", sensor_counts=SEVERAL),
    "scale_step": Entry(scale_step, "gain", sensor_counts=SEVERAL),
    "crosstalk": Entry(crosstalk, "gain", sensor_counts=SEVERAL),
    "ringing": Entry(ringing, "motion", motions=("turntable",), sensor_counts=SEVERAL),
    "platform_field": Entry(
        platform_field, "motion", motions=MOVING, sensor_counts=(4, 6), scalar_needed=True, large=(30.0,)
    ),
}
"""The effects of the library. ``most_nT`` has a reason each: 0.3 %/°C of a magnetoresistor's gain over 30 °C; a few
per cent of the field in a core's loops, its transfer function and a plate's currents; a heading error of the
pumped scalars without compensation; an hour of a magnetic storm; a magnet at a sensor; arms that bend by three degrees;
spikes of twice the field; the steps of a phone's converter; elsewhere a fifth of the field, past which nobody
calibrates."""

CAUSES = CATALOGUE | OUTSIDE
"""Every cause that a case may hold."""

CHANNELS = ("temperature", "current", "attitude")
