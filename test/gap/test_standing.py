"""Which causes hold: not one in many sensors for what less explains elsewhere, nor a poor stand-in."""

import numpy as np
import pytest
from tam_calibration.gap.standing import AGAINST_RIVAL, beats, energy_explained, holds, open_part

from tam_calibration.effects.library import effect_named
from tam_calibration.gap.hypotheses import evidence_of, examine, rivals
from tam_calibration.gap.search import best_form


@pytest.fixture(scope="module")
def base(run):
    """Return the calibration of a run in which the scalar magnetometer alone follows the attitude."""
    made = run(600)
    field = made.errors.restore(made.recording.readings_T).mean(axis=1)
    along = field @ np.array([0.6, 0.0, 0.8]) / np.linalg.norm(field, axis=1)
    return made.with_row(12, 6e-9 * along**3 * np.abs(along)).model().base()


def test_what_less_explains_elsewhere_does_not_hold(base):
    """All sensors may imitate the scalar magnetometer with many coefficients; the scalar's own effect holds."""
    unknown = rivals(base)
    imitating = evidence_of(base, best_form(base, effect_named("hysteresis")))
    assert imitating.delta_bic > 100
    assert not holds(base, imitating, unknown)
    assert holds(base, examine(base, effect_named("scalar_heading_error")), unknown)


def test_a_cause_beats_what_explains_less(base):
    """Nearly all of the energy of the best function without physics is asked for, and energies add up."""
    unknown = rivals(base)
    true = examine(base, effect_named("scalar_heading_error"))
    poor = examine(base, effect_named("geomagnetic_drift"))
    assert beats(base, true, unknown, AGAINST_RIVAL)
    assert not beats(base, poor, unknown, AGAINST_RIVAL)
    assert 0 < energy_explained(poor, base) < energy_explained(true, base) < base.energy


def test_all_is_open_in_front_of_causes(base):
    """What functions without physics explain of the calibration's own residual."""
    unknown = rivals(base)
    assert open_part(base, base, unknown) == pytest.approx(1)
    assert open_part(base, base, ()) == 0
