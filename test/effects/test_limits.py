"""The sizes that effects have in nature."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tam_calibration.effects.effect import Limit, LinearEffect, Sized
from tam_calibration.effects.library import effect_named, installed_effects
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect

with_unit = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "list_effects.py"))["with_unit"]

NATURAL = {
    "temperature_drift": ({"time_constant_s": 0.0, "reference_C": 20.0}, (0, 0, "offset", {"offset": 730e-9})),
    "hysteresis": ({"full_scale_T": 50e-6}, (1, 0, "loop", {"play 0.15": 2e-2, "play 0.4": 1e-2})),
    "nonlinearity": ({"full_scale_T": 50e-6}, (1, 0, "cubic", {"P3": 200e-9})),
    "time_skew": ({}, (2, None, "delay", {"delay": 0.02})),
    "eddy_current": ({"time_constant_s": 0.2}, (1, None, "first mode", {"first mode, x of the field on y": 0.03})),
    "ambient_gradient": ({}, (ALL, None, "degree 2", {"gradient xy": 20e-6})),
    "scalar_heading_error": ({}, (SCALAR, None, "degree 3", {"degree 3, order 0": 15e-9})),
    "geomagnetic_drift": (
        {"start_s": 0.0, "span_s": 60.0},
        (SCALAR, None, "orders 1 to 2", {"order 1": 100e-9, "order 2": 20e-9}),
    ),
    "bias_jump": ({"time_s": 20.0}, (0, 2, "offset", {"offset": 27e-6})),
    "current_interference": ({"reference_A": 1.0}, (0, 0, "field", {"field": 500e-9})),
    "flexure": ({}, (0, None, "turn", {"turn about x by weight along y": 2e-3})),
    "periodic_interference": ({"frequency_hz": 3.0, "start_s": 0.0}, (0, 0, "line", {"cosine 1": 2e-6})),
    "outliers": ({}, (0, 0, "spikes", {"rate": 0.01, "size": 100e-6, "burst": 1.0})),
    "noise_excess": ({}, (0, 0, "noise", {"standard deviation": 500e-9})),
    "quantization": ({}, (ALL, None, "lattice", {"step": 600e-9})),
    "saturation": ({}, (0, 0, "limit", {"upper limit": 800e-6})),
    "scale_step": ({"time_s": 20.0}, (0, None, "turn", {"turn about x": 0.05})),
    "crosstalk": ({}, (0, 0, "previous 2 y", {"bleed": 1e-3})),
    "ringing": ({"frequency_hz": 2.0, "damping": 0.2}, (0, None, "response", {"amplitude": 1.0, "delay": 0.03})),
    "gain_switching": ({"on_1_s": 20.0, "off_1_s": 21.0}, (0, 0, "gain", {"gain": -0.5})),
    "timing_jitter": ({}, (0, None, "jitter", {"standard deviation": 2e-3})),
    "platform_field": ({}, (SCALAR, None, "permanent", {"permanent x": 2e-6})),
}
"""Shape and values that have been seen."""

ABSURD = [
    ("eddy_current", {"time_constant_s": 0.02}, (1, None, "slower mode", {"slower mode, x of the field on x": -51.0}),
     "its slower mode, x of the field on x of -51 is more than the 1 known (", "Jackson"),
    ("eddy_current", {"time_constant_s": 0.02}, (1, None, "first mode", {"first mode, x of the field on x": 2.0}),
     "its first mode, x of the field on x of 2", "Jackson"),
    ("geomagnetic_drift", {"start_s": 0.0, "span_s": 60.0}, (SCALAR, None, "orders 1 to 2", {"order 1": 1e-6}),
     "its rate of change of 33.3 nT/s is more than the 8.33 nT/s known", "Kappenman"),
    ("temperature_drift", {"time_constant_s": 0.0, "reference_C": 20.0}, (0, 0, "offset", {"offset": -4e-6}),
     "its offset of -4000 nT/K is more than the 2000 nT/K known", "FXOS8700CQ"),
    ("temperature_drift", {"time_constant_s": 0.0, "reference_C": 20.0}, (0, 0, "scale", {"scale": 0.01}),
     "its scale of 0.01 1/K", "HMC1001"),
    ("temperature_drift", {"time_constant_s": 0.0, "reference_C": 20.0},
     (0, 0, "quadratic offset", {"quadratic offset": 2e-7}), "its quadratic offset of 200 nT/K²", "10 K"),
    ("temperature_drift", {"time_constant_s": 9.0, "reference_C": 20.0, "start_s": 0.0},
     (0, 0, "start", {"start": 1e-4}), "its start of 100000 nT", "25 K"),
    ("hysteresis", {"full_scale_T": 50e-6}, (1, 0, "loop", {"play 0.15": 1.6}),
     "its part of the field of 0.217", "iron"),
    ("nonlinearity", {"full_scale_T": 50e-6}, (1, 0, "quadratic", {"P2": 15e-6}),
     "its part of the field of", "HMC1001"),
    ("time_skew", {}, (2, None, "delay", {"delay": -2.0}), "its delay of -2 s is more than the 1 s known", "Furgale"),
    ("ambient_gradient", {}, (ALL, None, "degree 2", {"gradient xy": 2e-4}),
     "its gradient xy of 200000 nT/m", "Haverinen"),
    ("ambient_gradient", {}, (ALL, None, "degree 3", {"gradient xxy": 2e-3}),
     "its gradient xxy of 2000000 nT/m²", "indoor"),
    ("scalar_heading_error", {}, (SCALAR, None, "degree 3", {"degree 3, order 0": 8e-6}), "its size of", "Oelsner"),
    ("bias_jump", {"time_s": 20.0}, (0, 2, "offset", {"offset": 2e-2}), "its offset of 20000000 nT", "neodymium"),
    ("current_interference", {"reference_A": 1.0}, (0, 0, "field", {"field": 4e-4}),
     "its field of 400000 nT/A", "Biot"),
    ("current_interference", {"reference_A": 1.0}, (0, 0, "quadratic", {"quadratic": 4e-4}), "nT/A²", "iron"),
    ("flexure", {}, (0, None, "turn", {"turn about x by weight along y": 0.2}),
     "weight along y of 0.2 rad", "Timoshenko"),
    ("periodic_interference", {"frequency_hz": 3.0, "start_s": 0.0}, (0, 0, "line", {"cosine 1": 2e-3}),
     "its cosine 1 of 2000000 nT", "ICNIRP"),
    ("outliers", {}, (0, 0, "spikes", {"rate": 0.01, "size": 0.1, "burst": 1.0}),
     "its size of 100000000 nT", "Melexis"),
    ("noise_excess", {}, (0, 0, "noise", {"standard deviation": 2e-5}), "its standard deviation of 20000 nT", "Ripka"),
    ("quantization", {}, (ALL, None, "lattice", {"step": 2e-5}), "its step of 20000 nT", "Hall"),
    ("saturation", {}, (0, 0, "limit", {"upper limit": 0.1}), "its upper limit of 100000000 nT", "Melexis"),
    ("scale_step", {"time_s": 20.0}, (0, None, "turn", {"turn about x": 1.0}), "its turn about x of 1 rad", "Isermann"),
    ("scale_step", {"time_s": 20.0}, (0, 0, "scale", {"scale": 2.0}),
     "its scale of 2 is more than the 1.05 known", "Isermann"),
    ("gain_switching", {"on_1_s": 20.0, "off_1_s": 21.0}, (0, 0, "gain", {"gain": 2.0}), "its gain of 2", "Horowitz"),
    ("crosstalk", {}, (0, 0, "previous 2 y", {"bleed": -2.0}), "its bleed of -2", "Kester"),
    ("ringing", {"frequency_hz": 2.0, "damping": 0.2}, (0, None, "response", {"amplitude": 2.0}),
     "its amplitude of 2", "Oppenheim"),
    ("ringing", {"frequency_hz": 2.0, "damping": 0.2}, (0, None, "response", {"delay": 2.0}),
     "its delay of 2 s", "buses"),
    ("timing_jitter", {}, (0, None, "jitter", {"standard deviation": 0.5}),
     "its standard deviation of 0.5 s is more than the 0.1 s known", "ticks"),
    ("platform_field", {}, (SCALAR, None, "permanent", {"permanent x": 2e-4}), "its permanent x of 200000 nT", "hull"),
    ("platform_field", {}, (SCALAR, None, "induced", {"induced xy": 4.0}), "its induced xy of 4", "sphere"),
    ("platform_field", {"time_constant_s": 0.2}, (SCALAR, None, "first mode", {"first mode, x of the field on x": 2.0}),
     "its first mode, x of the field on x of 2 is more than the 1 known", "Jackson"),
    ("platform_field", {"time_constant_s": 0.2},
     (ALL, None, "slower mode, gradient", {"slower mode, gradient xy, x of the field": 60.0}), "60 1/m", "decimetre"),
    ("platform_field", {"time_constant_s": 0.2},
     (ALL, None, "first mode, curvature", {"first mode, curvature xxy, x of the field": 2400.0}), "1/m²", "decimetre"),
]  # fmt: skip
"""Values that were claimed, or twice what the limits allow, and parts of a clause on each."""


COUNTED = {"stale_samples", "interpolated_samples"}
"""Effects whose values are numbers of samples and parts of them, which their search bounds."""


def oversize(covariates, name, shape, contribution):
    """Return in one clause which value of an effect is larger than any in nature; None where none is."""
    effect, fitted = effect_named(name), FittedEffect(name, shape, (Contribution(*contribution),))
    sized = next((sized for sized in effect.sizes(covariates, fitted) if not sized.is_natural), None)
    assert effect.is_natural(covariates, fitted) == (sized is None)
    if sized is None:
        return None
    limit = sized.limit
    size, known = with_unit(sized.value, limit.unit), with_unit(limit.largest, limit.unit)
    return f"its {sized.name} of {size} is more than the {known} known ({limit.source})"


@pytest.mark.parametrize("name", NATURAL)
def test_what_nature_has_passes(turning, name):
    """Sizes that have been seen are none too large."""
    assert oversize(turning(), name, *NATURAL[name]) is None


@pytest.mark.parametrize(("name", "shape", "contribution", "told", "source"), ABSURD)
def test_what_is_absurd_is_told(turning, name, shape, contribution, told, source):
    """The value that is too large is found, with its unit, its limit and the source of that."""
    said = oversize(turning(), name, shape, contribution)
    assert told in said and source in said


def test_each_effect_of_ours_has_a_limit_and_a_test():
    """None may be of any size."""
    ours = {
        name: effect
        for name, effect in installed_effects().items()
        if type(effect).__module__.startswith("tam_calibration.")
    }
    assert ours.keys() - COUNTED == NATURAL.keys() == {name for name, *_ in ABSURD}
    for effect in (effect for name, effect in ours.items() if name not in COUNTED):
        assert effect.limits or (isinstance(effect, LinearEffect) and effect.largest_signal)


def test_a_slow_drift_may_be_large(turning):
    """What a storm does in an hour it does not in a minute."""
    fast = turning()
    slow = replace(fast, time_s=60 * fast.time_s)
    whole = (SCALAR, None, "orders 1 to 2", {"order 1": 1e-6})
    assert oversize(fast, "geomagnetic_drift", {"start_s": 0.0, "span_s": 60.0}, whole)
    assert oversize(slow, "geomagnetic_drift", {"start_s": 0.0, "span_s": 3600.0}, whole) is None


def test_a_size_relative_to_the_field_grows_with_it(turning):
    """A curve of 6 µT is too much in the Earth's field, and not in one of a hundred times that."""
    weak = turning()
    strong = replace(weak, field_T=100 * weak.field_T)
    curve = (1, 0, "quadratic", {"P2": 15e-6})
    assert oversize(weak, "nonlinearity", {"full_scale_T": 50e-6}, curve)
    assert oversize(strong, "nonlinearity", {"full_scale_T": 50e-4}, curve) is None


def test_a_value_is_told_in_its_unit():
    """Teslas are told as nanoteslas; what has no unit has none."""
    assert with_unit(12e-9, "T/K") == "12 nT/K"
    assert with_unit(0.5, "rad") == "0.5 rad"
    assert with_unit(0.5, "1") == "0.5"


def test_the_largest_in_nature_is_natural():
    """The next larger number is not, whatever its sign."""
    limit, larger = Limit(1.0, "a book"), float(np.nextafter(1, 2))
    assert Sized("gain", 1.0, limit).is_natural and Sized("gain", -1.0, limit).is_natural
    assert not (Sized("gain", larger, limit).is_natural or Sized("gain", -larger, limit).is_natural)
