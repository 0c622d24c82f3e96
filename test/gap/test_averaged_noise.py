"""What averages the noise of the readings gains nothing where a better scalar tells the field."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.effects.library import effect_named
from tam_calibration.gap import diagnose
from tam_calibration.gap.hypothesis import best_form

SAMPLES = 2000


@pytest.fixture(scope="module")
def slow(run):
    """Return a run of one noisy sensor that turns by half a degree a sample, with a far better scalar."""
    made = run(SAMPLES, sensors=1)
    attitude = Rotation.from_euler("XYZ", np.outer(np.arange(SAMPLES), [0.009, 0.0055, 0.0035]))
    field = attitude.inv().apply([12e-6, 18e-6, -45e-6])[:, None]
    noise = 4e-9 * np.random.default_rng(1).normal(size=(SAMPLES, 1, 3))
    recording = replace(made.recording, readings_T=made.errors.distort(field[:, 0]) + noise, attitude=None)
    return replace(made, recording=recording, array=replace(made.array, vector_noise_T=np.array([4e-9])))


@pytest.mark.parametrize("stride", [1, 2])
def test_what_averages_noise_gains_nothing(slow, stride):
    """Eddy currents could average neighbours of a slow turn; the field is that of the better scalar, so they do not."""
    base = slow.model(stride=stride).base()
    form = best_form(base, effect_named("eddy_current"))
    assert form.selection.gain < 0.02 * base.energy
    assert form.selection.delta_bic < 0


def test_what_averages_noise_is_no_gap(slow):
    """The diagnosis of such a turn names nothing."""
    assert diagnose(slow.recording, slow.array).verdict == "no_gap"
