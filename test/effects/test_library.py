"""The effects that are installed, and one that another package brings."""

from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects import library
from tam_calibration.effects.effect import Effect
from tam_calibration.effects.library import GROUP, effect_named, installed_effects
from tam_calibration.model.exceptions import InputError
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
    (information / "entry_points.txt").write_text(f"[{GROUP}]\ntide = sea:Tide\n")
    monkeypatch.syspath_prepend(tmp_path)
    installed_effects.cache_clear()
    yield
    installed_effects.cache_clear()


def test_another_package_adds_an_effect(other_package, tmp_path):
    """Installed beside ours, an effect is listed and simulated by its name; our code knows nothing of it."""
    assert set(installed_effects()) == NAMES | {"tide"}
    (tmp_path / "sea.yaml").write_text(SCENARIO)
    plan = read_scenario(str(tmp_path / "sea.yaml"))
    made, without = (simulate(one).recording.readings_T for one in (plan, replace(plan, effects=())))
    expected = np.zeros((4, 3))
    expected[2, 1] = 70
    assert_allclose(to_nanotesla(np.abs(made - without).max(axis=0)), expected, atol=1e-6)
