"""Runs of one array that are simulated with other seeds, effects and noise, and what the judge says of them."""

from dataclasses import replace
from functools import cache
from importlib import import_module

import numpy as np
import pytest

from tam_calibration.comparison import compare
from tam_calibration.comparison.compare import side_of
from tam_calibration.model.fitted_effect import Contribution, FittedEffect

SAMPLES, RATE_HZ = 600, 50.0
"""As many as the properties need, of the twelve seconds in which the array has turned through all directions."""


@pytest.fixture(scope="session")
def run():
    """Return a function that simulates a run.

    Of a seed, a drift of sensor 2 with temperature [nT/K], and noise of so many times that of the sheet.
    """
    from tam_calibration import read_scenario, simulate
    from tam_calibration.simulation.conditions import AttitudeChannel, Temperature

    scenario = replace(
        read_scenario("tumble_100_hz"),
        sample_count=SAMPLES,
        rate_hz=RATE_HZ,
        temperature=Temperature(15.0, 25.0),
        attitude=AttitudeChannel(),
    )

    @cache
    def simulated(seed, drift=0.0, noise=1.0):
        array = replace(scenario.array, vector_noise_T=noise * scenario.array.vector_noise_T)
        effects = (_drift(drift),) if drift else ()
        return simulate(replace(scenario, array=array, seed=seed, effects=effects)).recording

    return simulated


def _drift(size):
    offsets = [
        Contribution(1, axis, "offset", {"offset": 1e-9 * size * part}) for axis, part in enumerate((1.0, -0.5, 0.8))
    ]
    return FittedEffect("temperature_drift", {"time_constant_s": 0.0, "reference_C": 20.0}, tuple(offsets))


@pytest.fixture(scope="session")
def judge(cross):
    """Return the judge of a recording, which looks at each recording once."""
    judged = {}

    def judge(source, array=cross, progress=None):
        if id(source) not in judged:
            judged[id(source)] = source, side_of(source, array, progress)
        elif progress:
            progress("judged", 0.5)
        return judged[id(source)][1]

    return judge


@pytest.fixture(scope="session")
def side(run, judge):
    """Return a function of the same arguments that judges such a run."""
    return lambda *arguments: judge(run(*arguments))


@pytest.fixture(scope="session")
def cold(run):
    """Return the first run without its temperature."""
    return replace(run(1), temperature_C=None)


@pytest.fixture(scope="session")
def compared(cross, judge):
    """Return a function that compares two recordings of the cross."""

    def compared(simulation, recording, **given):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(import_module("tam_calibration.comparison.compare"), "side_of", judge)
            return compare(simulation, recording, cross, **given)

    return compared


@pytest.fixture(scope="session")
def sheet(cross):
    """Return the noise of the cross, tesla."""
    return float(np.mean(cross.vector_noise_T))
