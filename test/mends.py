"""A run of every channel, and a mend of it with any effects and noise: what tests of mends start from."""

from tam_calibration.comparison.mend import Mend
from tam_calibration.fit import calibrate
from tam_calibration.model.array import Array
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.simulation import Scenario, simulate
from tam_calibration.simulation.conditions import (
    AttitudeChannel,
    Current,
    ScalarReference,
    Temperature,
    Tumble,
    field_from_elements,
)

RATE_HZ = 20.0


def plain_scenario(samples, **changes):
    """Return a scenario of a cross that tumbles, without any effect, with all channels."""
    stated = {
        "array": Array.cross(0.5, 1e-9, 0.1e-9),
        "errors": SensorErrors.none(4),
        "site_field_T": field_from_elements(50e-6, 1.0, 0.1),
        "motion": Tumble(),
        "sample_count": samples,
        "rate_hz": RATE_HZ,
        "seed": 3,
        "scalar": ScalarReference(),
        "temperature": Temperature(15.0, 25.0),
        "current": Current(0.0, 2.0, 5.0),
        "attitude": AttitudeChannel(),
    }
    return Scenario(**(stated | changes))


def run_of(samples, **changes):
    """Return the recording of that scenario."""
    return simulate(plain_scenario(samples, **changes)).recording


def mend_of(run, added=(), noise=(), removed=()):
    """Return a mend whose recording is the run itself."""
    return Mend(tuple(added), tuple(removed), tuple(noise), calibrate(run, Array.cross(0.5, 1e-9, 0.1e-9)), RATE_HZ)


def fitted(name, shape, *contribution):
    """Return an effect of one contribution."""
    return FittedEffect(name, shape, (Contribution(*contribution),))


EFFECTS = {
    effect.effect: effect
    for effect in (
        fitted("ambient_gradient", {}, ALL, None, "degree 2", {"gradient xy": 2e-7}),
        fitted("bias_jump", {"time_s": 9.0}, 0, 2, "offset", {"offset": 27e-9}),
        fitted("crosstalk", {"late_y_s": 0.05}, 0, 0, "from y", {"bleed": 5e-3}),
        fitted("current_interference", {"reference_A": 1.0, "time_constant_s": 0.5}, 0, 0, "field", {"field": 20e-9}),
        fitted(
            "eddy_current", {"time_constant_s": 0.2}, 1, None, "first mode", {"first mode, x of the field on y": 0.03}
        ),
        fitted("flexure", {}, 0, None, "turn", {"turn about x by weight along y": 1e-3}),
        fitted("gain_switching", {"upper_T": 30e-6, "lower_T": 20e-6}, 0, 0, "gain", {"gain": -0.002}),
        fitted(
            "geomagnetic_drift", {"start_s": 0.0, "span_s": 60.0}, SCALAR, None, "orders 1 to 2", {"order 1": 50e-9}
        ),
        fitted("hysteresis", {"full_scale_T": 50e-6}, 1, 0, "loop", {"play 0.15": 3e-3, "play 0.4": 2e-3}),
        fitted("interpolated_samples", {}, 1, None, "interpolated", {"rate": 0.1, "burst": 3.0}),
        fitted("noise_excess", {}, 0, 0, "noise", {"standard deviation": 20e-9}),
        fitted("nonlinearity", {"full_scale_T": 50e-6}, 1, 0, "cubic", {"P3": 200e-9}),
        fitted("outliers", {}, 0, 0, "spikes", {"rate": 0.02, "size": 1e-6, "burst": 2.0}),
        fitted("periodic_interference", {"frequency_hz": 3.0, "start_s": 0.0}, 0, 0, "line", {"cosine 1": 2e-8}),
        fitted(
            "platform_field",
            {"time_constant_s": 0.2},
            SCALAR,
            None,
            "first mode",
            {"first mode, x of the field on y": 1e-4},
        ),
        fitted("quantization", {}, ALL, None, "lattice", {"step": 60e-9, "offset": 0.0}),
        fitted("ringing", {"frequency_hz": 2.0, "damping": 0.2}, 0, None, "response", {"amplitude": 0.05}),
        fitted("saturation", {}, 0, 0, "limit", {"upper limit": 40e-6}),
        fitted("scalar_heading_error", {}, SCALAR, None, "degree 3", {"degree 3, order 0": 15e-9}),
        fitted("scale_step", {"time_s": 9.0}, 0, None, "turn", {"turn about x": 0.002}),
        fitted("stale_samples", {}, 1, None, "repeats", {"rate": 0.05, "burst": 2.0, "samples late": 1.0}),
        fitted("temperature_drift", {"time_constant_s": 0.0, "reference_C": 20.0}, 0, 0, "offset", {"offset": 7e-9}),
        fitted("time_skew", {}, 2, None, "delay", {"delay": 2e-3}),
        fitted("timing_jitter", {}, 0, None, "jitter", {"standard deviation": 2e-3}),
    )
}
"""Each effect of ours, of a size that a recording of some hundred samples shows."""
