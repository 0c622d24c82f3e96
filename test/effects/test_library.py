"""The effects that are installed, and one that another package brings."""

import re
from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration import calibrate_with_effects, correct, diagnose, read_calibration, write_calibration
from tam_calibration.effects import library
from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import Effect
from tam_calibration.effects.library import GROUP, effect_named, installed_effects
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.units import to_nanotesla
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate

NAMES = {
    "temperature_drift",
    "hysteresis",
    "nonlinearity",
    "time_skew",
    "eddy_current",
    "ambient_gradient",
    "scalar_heading_error",
    "geomagnetic_drift",
    "bias_jump",
    "current_interference",
    "flexure",
    "periodic_interference",
    "outliers",
    "noise_excess",
    "quantization",
    "saturation",
    "stale_samples",
    "timing_jitter",
    "interpolated_samples",
    "scale_step",
    "gain_switching",
    "crosstalk",
    "ringing",
    "platform_field",
}

THIRD_PARTY = """
import numpy as np
from tam_calibration.effects.effect import Coefficient, LinearEffect, Term

class Tide(LinearEffect):
    name = "tide"
    title = "readings that follow the tide"
    physics = "Sea water that moves in the geomagnetic field carries currents (Longuet-Higgins 1949)."
    excitation = "a record of hours"
    shape_units = {"period_s": "s"}

    def shapes(self, covariates, residuals):
        return ({"period_s": 40.0},)

    def terms(self, covariates, shape):
        tide = np.sin(2 * np.pi * covariates.time_s / shape["period_s"])
        return [
            Term.of_row(covariates, row, "tide", [Coefficient("height", "T")], tide[:, None])
            for row in range(covariates.scalar_row)
        ]


class Supply(LinearEffect):
    name = "supply_square"
    title = "offset that follows the square of the supply voltage"
    physics = "The reference of the electronics follows its supply, to second order."
    channels = ("actuator_supply",)
    excitation = "let the supply change several times"

    def terms(self, covariates, shape):
        square = covariates.channel("actuator_supply")[:, None] ** 2
        quadratic = [Coefficient("quadratic", "T/V²")]
        return [Term.of_row(covariates, row, "square", quadratic, square) for row in range(covariates.scalar_row)]
"""

SCENARIO = """\
array: {baseline_m: 0.5, vector_noise_nT: 1.0, scalar_noise_nT: 0.1}
site: {intensity_nT: 50000, inclination_deg: 60}
motion: {kind: tumble}
samples: 801
rate_hz: 10
scalar: {}
effects:
  - effect: tide
    shape: {period_s: 40}
    terms: [{sensor: 3, axis: y, term: tide, values: {height: 70 nT}}]
"""


def test_our_effects_are_installed():
    """Each has its name, and tells people what it is, why it is and what shows it."""
    effects = installed_effects()
    assert set(effects) >= NAMES
    for name in NAMES:
        effect = effect_named(name)
        assert isinstance(effect, Effect) and effect.name == name
        assert effect.title and effect.physics and effect.excitation


def test_an_unknown_effect_is_told():
    """The choice is named."""
    with pytest.raises(InputError, match="there is no effect 'magic': choose one of ambient_gradient, bias_jump"):
        effect_named("magic")


@pytest.mark.parametrize(
    ("point", "sentence"),
    [
        ("no_such_package.tide:Tide", "the effect tide of no_such_package.tide:Tide cannot be loaded"),
        ("collections:OrderedDict", "the entry point tide = collections:OrderedDict is no effect of that name"),
        ("tam_calibration.effects.single_samples:Outliers", "is no effect of that name"),
    ],
)
def test_a_broken_package_is_named(monkeypatch, point, sentence):
    """An entry point that cannot be imported, or is something else, is told with its name."""
    monkeypatch.setattr(library, "entry_points", lambda group: [EntryPoint("tide", point, group)])
    installed_effects.cache_clear()
    try:
        with pytest.raises(InputError, match=sentence):
            installed_effects()
    finally:
        installed_effects.cache_clear()


@pytest.fixture
def other_package(tmp_path, monkeypatch):
    """Install another package with an effect."""
    (tmp_path / "sea.py").write_text(THIRD_PARTY)
    information = tmp_path / "sea-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: sea\nVersion: 1.0\n")
    points = "tide = sea:Tide\nsupply_square = sea:Supply\n"
    (information / "entry_points.txt").write_text(f"[{GROUP}]\n{points}")
    monkeypatch.syspath_prepend(tmp_path)
    installed_effects.cache_clear()
    yield
    installed_effects.cache_clear()


def test_another_package_adds_an_effect(other_package, tmp_path):
    """Installed beside ours, an effect is listed and simulated by its name; our code knows nothing of it."""
    assert set(installed_effects()) == NAMES | {"tide", "supply_square"}
    (tmp_path / "sea.yaml").write_text(SCENARIO)
    plan = read_scenario(str(tmp_path / "sea.yaml"))
    made, without = (simulate(one).recording.readings_T for one in (plan, replace(plan, effects=())))
    expected = np.zeros((4, 3))
    expected[2, 1] = 70
    assert_allclose(to_nanotesla(np.abs(made - without).max(axis=0)), expected, atol=1e-6)


FOLLOWS = """\
array: {baseline_m: 0.5, vector_noise_nT: 1.0, scalar_noise_nT: 0.1}
site: {intensity_nT: 50000, inclination_deg: 60}
motion: {kind: tumble}
samples: 601
rate_hz: 10
scalar: {}
further_channels:
  actuator_supply: {low: -1, high: 1, period_s: 7}
"""


@pytest.fixture
def supplied(other_package, tmp_path):
    """Return a simulation with the supply of that effect, and without the effect itself."""
    (tmp_path / "supply.yaml").write_text(FOLLOWS)
    return simulate(read_scenario(str(tmp_path / "supply.yaml")))


def test_an_effect_follows_a_further_channel(supplied, tmp_path):
    """It is found by its channel, fitted, written with its unit, read again and taken off by it."""
    recording, array = supplied.recording, supplied.scenario.array
    supply = np.sin(0.7 * recording.time_s) + np.sin(2.3 * recording.time_s)
    readings_T = recording.readings_T + 5e-9 * np.outer(supply**2, np.eye(12)[7]).reshape(-1, 4, 3)
    recording = replace(recording, readings_T=readings_T, further={"actuator_supply": supply})
    gap = diagnose(recording, array)
    assert [cause.fitted.effect for cause in gap.causes] == ["supply_square"]
    made = calibrate_with_effects(recording, array, ["supply_square"])
    write_calibration(tmp_path / "c.yaml", made)
    assert re.search(r"quadratic: (5\.0|4\.9)\d* nT/V²", (tmp_path / "c.yaml").read_text())
    again = read_calibration(tmp_path / "c.yaml")
    assert again.effects == made.effects
    assert_allclose(correct(recording, again).outputs, correct(recording, made).outputs)


def test_a_further_channel_that_is_missing_is_told(supplied):
    """The diagnosis says which one it needs, and a fit asks for it."""
    recording, array = replace(supplied.recording, further={}), supplied.scenario.array
    considered = {one.effect: one for one in diagnose(recording, array).considered}
    assert considered["supply_square"].why == "needs the actuator_supply channel, which is not recorded"
    with pytest.raises(InputError, match="supply_square cannot be fitted: it needs the actuator_supply channel"):
        calibrate_with_effects(recording, array, ["supply_square"])
    with pytest.raises(InputError, match="supply_square follows actuator_supply: add it to further_channels"):
        simulate(replace(supplied.scenario, further={}, effects=(FittedEffect("supply_square", {}, ()),)))


def test_a_channel_that_an_effect_does_not_name_is_a_sentence(supplied):
    """Its author learns which attribute lacks it, whichever way the effect asks."""
    covariates = Covariates.of(supplied.recording, supplied.center_field_T, supplied.errors, supplied.scenario.array)
    for ask in (covariates.channel, covariates.further.__getitem__):
        with pytest.raises(InputError, match="no channel 'actuator_pump': an effect that follows it must name it"):
            ask("actuator_pump")
