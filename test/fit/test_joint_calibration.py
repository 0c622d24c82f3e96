"""`calibrate` beside a prior: narrow turns are accepted, what cannot be is refused in a sentence."""

from dataclasses import replace

import numpy as np
import pytest
from moved_sensors import joined, moved
from narrow_turns import FINE, WIDE, array_of, drawn, turned
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.core.noise import WHITE
from tam_calibration.correction.parts import EffectSize, KnownSource
from tam_calibration.effects.removal import added_to
from tam_calibration.fit import calibrate, joint_calibration
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import DAY_S, ChangeRates
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.fitted_effect import SCALAR, Contribution, FittedEffect
from tam_calibration.model.units import from_degrees
from tam_calibration.results import calibration_from_yaml, calibration_to_yaml
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import AttitudeChannel, Manoeuvre

PIER_S = 1.7e9


def dated(recording, time_s, temperature_C):
    """Return the recording at a date and temperature."""
    temperature = np.full(recording.sample_count, temperature_C)
    return replace(recording, time_s=time_s + recording.time_s, temperature_C=temperature)


@pytest.fixture(scope="module")
def pier(wu_run, wu_scenario):
    """Return the calibration ashore."""
    return maximum_likelihood(dated(wu_run.recording, PIER_S, 21.0), wu_scenario.array)


@pytest.fixture(scope="module")
def narrow(wu_scenario):
    """Return full circles at three degrees of pitch and roll, half a day later in colder water."""
    limit = from_degrees(3.0)
    motion = Manoeuvre(limit, limit, 60.0)
    made = simulate(replace(wu_scenario, motion=motion, sample_count=300, rate_hz=5.0, seed=11)).recording
    return dated(made, PIER_S + DAY_S / 2, 9.0)


@pytest.fixture(scope="module")
def updated(wu_scenario, pier, narrow):
    """Return the calibration by those circles beside the one ashore."""
    return calibrate(narrow, wu_scenario.array, prior=pier)


def test_a_narrow_turn_is_accepted_beside_a_prior(wu_scenario, narrow, updated):
    """Refused alone; with it all is told: age, temperature, and the share of the data in each parameter."""
    with pytest.raises(InputError, match="do not determine"):
        calibrate(narrow, wu_scenario.array)
    found, update = updated, updated.update
    assert found.method == "maximum_a_posteriori" and not update.moved
    assert update.elapsed_s == pytest.approx(DAY_S / 2, rel=0.01) and update.warming_K == pytest.approx(-12.0)
    share = update.data_share
    assert np.isnan(share[0, 9:]).all() and (share[1:, 9:] > 0.4).all()
    assert ((share[:, :9] >= 0) & (share[:, :9] <= 1)).all()
    ratio = found.standard_errors[1:] / update.prior_standard_errors[1:]
    assert_allclose(1 - ratio**2, share[1:], atol=1e-9)
    assert found.held_out is not None
    assert found.held_out.tensor_rmse_T_per_m < 1.1 * found.floor.tensor_rmse_T_per_m


def test_the_rates_of_the_array_count(wu_scenario, pier, narrow):
    """Sensors that do not change leave the prior as it is."""
    steady = ChangeRates(0, 0, 0, 0, 0, 0, 0, 0)
    found = calibrate(narrow, replace(wu_scenario.array, change_rates=steady), prior=pier)
    assert_allclose(found.update.prior_standard_errors, pier.standard_errors)


def test_attitude_at_rest_closes_nothing_and_is_not_refused(wu_scenario, pier):
    """However the mounting is known: no error is less certain than without attitude, and none is far from it."""
    resting = replace(wu_scenario, motion=Manoeuvre(0.0, 0.0, 1e9), sample_count=60, attitude=AttitudeChannel(), seed=5)
    recording = dated(simulate(resting).recording, PIER_S + DAY_S / 2, 21.0)
    without = calibrate(replace(recording, attitude=None), wu_scenario.array, prior=pier)
    for mounting_error in (None, 0.0):
        array = replace(wu_scenario.array, attitude_noise=from_degrees(0.05), mounting_error=mounting_error)
        found = calibrate(recording, array, prior=pier)
        assert (found.standard_errors <= without.standard_errors * (1 + 1e-6)).all()
        change = np.abs(found.errors.to_vector() - without.errors.to_vector())
        assert (change <= 0.5 * without.standard_errors + 1e-12).all()


def test_a_refusal_tells_what_moved(wu_scenario, pier):
    """Of sensors at rest the prior told all, until a bias moved that one attitude does not determine."""
    resting = replace(wu_scenario, motion=Manoeuvre(0.0, 0.0, 1e9), sample_count=60, seed=5)
    errors = moved(wu_scenario.errors, "scale factor", 1, 100)
    recording = dated(simulate(replace(resting, errors=errors)).recording, PIER_S + DAY_S / 2, 21.0)
    with pytest.raises(
        InputError, match=r"^the \S+( factor)? of sensor \d.* moved since the prior, and the readings do not"
    ):
        calibrate(recording, wu_scenario.array, prior=pier)


def test_the_same_samples_do_not_count_twice(wu_scenario, narrow, updated):
    """A prior of the time of the recording is refused."""
    with pytest.raises(InputError, match="would count twice"):
        calibrate(narrow, wu_scenario.array, prior=updated)


def test_the_same_samples_do_not_count_twice_without_a_date(wu_scenario, wu_run):
    """A prior from the file of the same recording is refused; one from another run of the same times is not."""
    text = calibration_to_yaml(maximum_likelihood(wu_run.recording, wu_scenario.array))
    prior = calibration_from_yaml(text, "pier.yaml")
    with pytest.raises(InputError, match="would count twice: take the calibration before it"):
        calibrate(wu_run.recording, wu_scenario.array, prior=prior)
    other = simulate(replace(wu_scenario, seed=7)).recording
    assert other.time_span_s == prior.time_span_s
    assert calibrate(other, wu_scenario.array, prior=prior).quality.grade == "good"


def test_what_is_no_prior_is_refused(wu_scenario, pier, narrow):
    """That of another array, and fits that know of none."""
    with pytest.raises(InputError, match="another array"):
        calibrate(narrow, Array.cross(0.3, 1e-9, 1e-10), prior=pier)
    with pytest.raises(InputError, match="not with lossless"):
        calibrate(narrow, wu_scenario.array, "lossless", prior=pier)


def test_readings_are_weighed_until_their_residuals_show_no_more(wu_scenario, pier, narrow, monkeypatch):
    """Than a tenth of the variance beyond that by which they were weighed; five times at most."""

    def rounds(growth):
        weights = []

        def measured(calibration, _):
            weights.append(calibration.variance_factors)
            return weights[-1].times(growth)

        monkeypatch.setattr(joint_calibration, "variance_factors", measured)
        calibrate(narrow, wu_scenario.array, prior=pier)
        return len(weights)

    assert (rounds(1.09), rounds(1.11)) == (1, 5)


def test_tolerances_that_are_contradicted_tell_nothing():
    """A bias of a hundred tolerances: a narrow turn is refused, a full one counts alone and says so."""
    rng = np.random.default_rng(4)
    errors = replace(drawn(FINE, 1, rng), bias_T=np.array([[5e-6, 0, 0]]))
    with pytest.raises(Refused, match=r"the tolerances of the array file, χ² .* of 9 errors, and tell too little"):
        calibrate(turned(errors, 5, rng), array_of(FINE, 1))
    recording, array = turned(errors, 80, rng), array_of(FINE, 1)
    found, plain = calibrate(recording, array), calibrate(recording, replace(array, tolerances=None))
    assert any("contradict the tolerances" in warning and "count alone" in warning for warning in found.warnings)
    assert_allclose(found.errors.to_vector(), plain.errors.to_vector(), rtol=1e-9, atol=1e-15)
    assert np.nanmin(found.update.data_share) == np.nanmax(found.update.data_share) == 1


def test_a_turn_that_contradicts_a_narrow_one_counts_alone():
    """A bias that the first was certain of moved by 1 µT since then; a second that tells too little is refused."""
    rng = np.random.default_rng(14)
    errors, array = drawn(WIDE, 1, rng), array_of(WIDE, 1)
    first = calibrate(turned(errors, 5, rng, count=150), array)
    knocked = replace(errors, bias_T=errors.bias_T + np.array([1e-6, 0, 0]))
    with pytest.raises(Refused, match=r"contradict the prior, .* alone: state the noise .*, faster change_rates"):
        calibrate(turned(knocked, 5, rng, 100.0, 150), array, prior=first)
    full = turned(knocked, 80, rng, 100.0, 150)
    found, plain = calibrate(full, array, prior=first), calibrate(full, replace(array, tolerances=None))
    assert any("contradict the prior" in warning and "count alone" in warning for warning in found.warnings)
    assert_allclose(found.errors.to_vector(), plain.errors.to_vector(), rtol=1e-9, atol=1e-15)


def test_a_noise_beyond_the_prior_is_told(wu_scenario, pier, narrow, updated):
    """From three times that of the prior, where none is stated: it may hold a change that was not found."""
    array = Array(wu_scenario.array.positions_m)
    noise_T = calibrate(narrow, array, prior=pier).array.vector_noise_T
    for times, is_told in ((2.9, False), (3.1, True)):
        less = replace(pier.array, vector_noise_T=noise_T / times)
        found = calibrate(narrow, array, prior=replace(pier, array=less))
        assert any("times as much as those of the prior" in warning for warning in found.warnings) == is_told
    assert not any("of the prior" in each for each in updated.warnings)


def test_where_all_has_changed_it_may_be_the_field(wu_scenario, pier):
    """A quarter of a circle in 100 nT/m looks like other sensors; a warning says that it need not be that."""
    limit, gradient = from_degrees(5.0), 1e-7 * np.diag([1.0, 0.5, -1.5])
    site = replace(wu_scenario, motion=Manoeuvre(limit, limit, 240.0), site_gradient_T_per_m=gradient)
    made = simulate(replace(site, sample_count=600, rate_hz=10.0, seed=3)).recording
    found = calibrate(dated(made, PIER_S + DAY_S / 2, 21.0), wu_scenario.array, prior=pier)
    assert {each.together for each in found.update.moved} == {("several errors", 0)}
    assert any("a field that is not uniform, as near a source" in warning for warning in found.warnings)


CURRENT = FittedEffect(
    "current_interference",
    {"reference_A": 0.0},
    (
        Contribution(1, 0, "field", {"field": 40e-9}),
        Contribution(3, 2, "field", {"field": -70e-9}),
        Contribution(SCALAR, None, "field", {"field x": 5e-9, "field y": 0.0, "field z": -8e-9}),
    ),
)
SIZE = EffectSize(np.full(9, 3e-9), np.full(9, 1e-10))


def test_effects_of_the_prior_are_taken_off_and_kept(wu_scenario, pier, narrow, updated):
    """Those that go with the array: the update is that of a recording without them, also of the scalar's."""
    with_current = replace(narrow, current_A=2 + np.sign(np.sin(np.arange(narrow.sample_count) / 9.0)))
    added = added_to(with_current, [CURRENT], pier.errors, pier.array)
    readings_T = narrow.readings_T + added[:, :-1].reshape(narrow.readings_T.shape)
    affected = replace(with_current, readings_T=readings_T, scalar_T=narrow.scalar_T + added[:, -1])
    site = FittedEffect("ambient_gradient", {}, ())
    prior = replace(pier, effects=(site, CURRENT), effect_sizes=(SIZE, SIZE))
    found, without = calibrate(affected, wu_scenario.array, prior=prior), updated
    assert not found.update.moved and found.effects == (CURRENT,) and found.effect_sizes == (SIZE,)
    # What an effect adds follows from the field, which is known but for the noise.
    difference = np.abs(found.errors.to_vector() - without.errors.to_vector())
    assert (difference <= 0.05 * without.standard_errors + 1e-15).all()
    assert found.held_out.tensor_rmse_T_per_m == pytest.approx(without.held_out.tensor_rmse_T_per_m, rel=1e-3)
    with pytest.raises(InputError, match="current_interference is to be taken off, which needs the current"):
        calibrate(replace(affected, current_A=None), wu_scenario.array, prior=prior)


def test_what_a_known_source_showed_stays(wu_scenario, pier, narrow):
    """Baselines and places of the axes of the prior, by which the tensor is told: the array file states others."""
    shown = replace(pier.array, positions_m=0.97 * pier.array.positions_m, axis_offsets_m=np.full((4, 3, 3), 1e-3))
    source = KnownSource(0.97, 1e-4, np.zeros(3), np.full(3, 1e-4), np.full((4, 3, 3), 1e-4), 1.0)
    found = calibrate(narrow, wu_scenario.array, prior=replace(pier, array=shown, known_source=source))
    assert found.known_source == source
    assert_array_equal(found.array.positions_m, shown.positions_m)
    assert_array_equal(found.array.axis_offsets_m, shown.axis_offsets_m)
    assert_allclose(found.held_out.tensor_rmse_T_per_m, found.floor.tensor_rmse_T_per_m, rtol=0.1)


def test_what_lasts_after_a_change_may_be_another(wu_scenario, pier):
    """A bias that moves by 200 nT and back: told as two, and nothing is left that lasts."""
    limit = from_degrees(30.0)
    motion = Manoeuvre(limit, limit, 240.0)
    before, after = (
        simulate(replace(wu_scenario, errors=errors, motion=motion, sample_count=180, rate_hz=3.0, seed=9)).recording
        for errors in (wu_scenario.errors, moved(wu_scenario.errors, "bias", 3, 10))
    )
    recording = dated(joined(joined(before, after, 60), before, 120), PIER_S + DAY_S / 2, 21.0)
    found = calibrate(recording, wu_scenario.array, prior=pier)
    assert [(each.kind, each.sensor) for each in found.update.moved] == [("bias", 4), ("bias", 4)]
    assert [each.since_s for each in found.update.moved] == recording.time_s[[60, 120]].tolist()
    assert found.variance_factors == WHITE and not found.warnings
    assert found.update.moved[1].change == pytest.approx(-found.update.moved[0].change, abs=3e-9)
