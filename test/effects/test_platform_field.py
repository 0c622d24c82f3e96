"""The vehicle's own field: the eighteen terms at the scalar, currents in distant conductors, and what moves."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.linalg import norm
from numpy.testing import assert_allclose

from tam_calibration.effects.lags import followed
from tam_calibration.effects.removal import EffectStream, require_channels
from tam_calibration.effects.surroundings import PlatformField
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.model.recording import Recording

EFFECT = PlatformField()
SHAPE = {"time_constant_s": 0.4}


@pytest.fixture
def moving(turning):
    """Return covariates of a vehicle that turns and moves its rudder, with a second current."""
    covariates = turning()
    time = covariates.time_s
    further = {"current_2_A": np.sign(np.sin(1.1 * time)), "actuator_rudder": 0.2 * np.sin(0.7 * time)}
    return replace(covariates, further=further)


def terms_of(covariates, shape=SHAPE):
    """Return the terms by their keys."""
    return {term.key: term for term in EFFECT.terms(covariates, shape)}


def test_the_scalar_has_eighteen_terms(turning):
    """Three permanent, six induced, nine of eddy currents of the first mode; no current is needed."""
    covariates = replace(turning(), current_A=None)
    counts = {
        name: len(term.coefficients) for (sensor, _, name), term in terms_of(covariates).items() if sensor == SCALAR
    }
    assert counts == {"permanent": 3, "induced": 6, "first mode": 9, "slower mode": 9}


def test_they_are_the_length_of_the_field_with_the_vehicles_own(turning):
    """To first order: against the length of the vector sum of a small field of each kind."""
    covariates = turning()
    rng = np.random.default_rng(3)
    permanent, induced, eddy = rng.normal(0, 1e-9, 3), rng.normal(0, 1e-5, (3, 3)), rng.normal(0, 1e-5, (3, 3))
    field = covariates.field_T
    change = field - followed(covariates, SHAPE["time_constant_s"])
    true = norm(field + permanent + field @ induced.T + change @ eddy.T, axis=1) - norm(field, axis=1)
    terms = terms_of(covariates)
    symmetric = induced + induced.T
    of_induced = [symmetric[i, j] / (2 if i == j else 1) for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
    found = sum(
        terms[SCALAR, None, name].signal(np.ravel(values), covariates.scalar_row + 1)[:, -1]
        for name, values in (("permanent", permanent), ("induced", of_induced), ("first mode", eddy))
    )
    assert_allclose(found, true, atol=2e-3 * np.abs(true).max())


def test_coefficients_come_back(moving, refitted):
    """Those at the scalar, of the gradient between the sensors and of two channels are told apart."""
    keys = (ALL, None, "first mode, gradient"), (1, None, "current_2_A"), (2, None, "actuator_rudder, induced")
    deviation, error = refitted(EFFECT, moving, SHAPE, *keys)
    assert np.abs(deviation).max() < 4.5
    assert error.max() < 1


def test_the_gradient_is_that_of_sources_at_a_distance(turning):
    """The field of a dipole that follows the change of the field, but for what is common to all sensors."""
    covariates = turning()
    far = np.array([3.0, -5.0, 4.0])
    away = covariates.array.positions_m - far
    distance = norm(away, axis=1)[:, None]
    change = covariates.field_T - followed(covariates, SHAPE["time_constant_s"])
    along = np.einsum("nj,kj->nk", change, away / distance)
    dipole = (3 * along[:, :, None] * (away / distance) - change[:, None]) / distance**3
    between = dipole - dipole.mean(axis=1, keepdims=True)
    rows = np.einsum("kij,nkj->nki", covariates.errors.matrix, between).reshape(len(change), -1)
    left, design = [], np.zeros((rows.size, 0))
    for name in ("gradient", "curvature"):
        term = terms_of(covariates)[ALL, None, f"first mode, {name}"]
        own = [term.signal(one, covariates.scalar_row + 1)[:, :-1].ravel() for one in np.eye(len(term.coefficients))]
        design = np.column_stack([design, *own])
        left.append(norm(rows.ravel() - design @ np.linalg.lstsq(design, rows.ravel(), rcond=None)[0]) / norm(rows))
    assert left[0] < 0.1
    assert left[1] < 0.1 * left[0]


def part_beyond_gradient(covariates, matrices):
    """Return it for changes of the field (3, 3) at each sensor, of which the effect holds what it can."""
    change = covariates.field_T - followed(covariates, SHAPE["time_constant_s"])
    rows = np.einsum("kij,kjl,nl->nki", covariates.errors.matrix, matrices, change).ravel()
    terms = [one for one in terms_of(covariates).values() if one.sensor == ALL and one.name.startswith("first mode")]
    signals = [
        one.signal(unit, covariates.scalar_row + 1)[:, :-1].ravel()
        for one in terms
        for unit in np.eye(len(one.coefficients))
    ]
    values = iter(np.linalg.lstsq(np.column_stack(signals), rows, rcond=None)[0])
    law = [Contribution(ALL, None, one.name, {part.name: next(values) for part in one.coefficients}) for one in terms]
    sizes = EFFECT.sizes(covariates, FittedEffect("platform_field", SHAPE, tuple(law)))
    return next(one for one in sizes if one.name == "part beyond the gradient")


@pytest.mark.parametrize(("arms", "is_natural"), [(8.0, True), (4.0, True), (2.5, False)])
def test_beyond_the_gradient_is_what_a_dipole_makes(turning, arms, is_natural):
    """Against differences of its field from that at the centre: little at a distance, of a near one too much."""
    covariates = turning()
    position = covariates.array.positions_m
    far = np.array([arms * norm(position[0]), 0, 0])

    def dipole(at):
        distance = norm(at - far, axis=1)[:, None, None]
        unit = (at - far)[:, :, None] / distance
        return (3 * unit * unit.swapaxes(1, 2) - np.eye(3)) / distance**3

    step = 1e-3 * arms * np.eye(3)
    between = dipole(position) - dipole(position).mean(axis=0)
    beyond = between - np.tensordot(position, (dipole(step) - dipole(-step)) / (2e-3 * arms), 1)
    expected = np.sum((beyond - beyond.mean(axis=0)) ** 2) / np.sum(between**2)
    sized = part_beyond_gradient(covariates, dipole(position))
    assert sized.value == pytest.approx(expected, rel=0.4)
    assert sized.is_natural == is_natural


def test_conductors_at_one_sensor_are_beyond_the_gradient(turning):
    """Potentials of degree 2 and 3 imitate most of it, which is no field of a vehicle."""
    rng = np.random.default_rng(5)
    for sensor in range(4):
        near = np.zeros((4, 3, 3))
        near[sensor] = rng.normal(size=(3, 3))
        assert not part_beyond_gradient(turning(), near).is_natural


def test_few_sensors_show_no_gradient(turning):
    """Between three it is that of currents near one of them."""
    assert (ALL, None, "first mode, gradient") not in terms_of(turning(sensors=3))


def test_poses_show_channels_alone(turning):
    """Without motion there are no eddy currents; without a further channel then nothing."""
    poses = turning(samples=300, attitude=np.random.default_rng(1).normal(size=(300, 4)))
    assert "jumps" in EFFECT.obstacle(poses)
    moved = replace(poses, further={"actuator_rudder": np.arange(300.0)})
    assert EFFECT.obstacle(moved) is None
    assert EFFECT.shapes(moved, None) == ({},)
    assert {name for _, _, name in terms_of(moved, {})} == {
        *("permanent", "induced", "current_A", "actuator_rudder", "actuator_rudder, induced")
    }


def fitted(*contributions):
    """Return the effect with some values."""
    return FittedEffect("platform_field", SHAPE, tuple(Contribution(*one) for one in contributions))


RUDDER = fitted((0, None, "actuator_rudder", {"actuator_rudder x": 1e-8}))
HULL = fitted(
    (SCALAR, None, "first mode", {"first mode, x of the field on y": 1e-3}),
    (ALL, None, "first mode, gradient", {"first mode, gradient xy, x of the field": 1e-3}),
)


def test_it_needs_the_channels_of_its_terms():
    """And a recording that lacks one is refused with its name."""
    assert EFFECT.needs(HULL) == ()
    assert EFFECT.needs(RUDDER) == ("actuator_rudder",)
    recording = Recording(np.arange(3.0), np.full((3, 4, 3), 3e-5))
    with pytest.raises(InputError, match="needs the actuator_rudder, and the recording has no such"):
        require_channels(recording, [RUDDER])


def test_a_silent_actuator_leaves_it_in(moving):
    """Samples without a value of it are told from those with one."""
    rudder = moving.further["actuator_rudder"].copy()
    rudder[::2] = np.nan
    readings = moving.sensed_T.reshape(moving.sample_count, -1, 3) + moving.errors.bias_T
    recording = Recording(moving.time_s, readings, further={"actuator_rudder": rudder})
    added = EffectStream([RUDDER], moving.errors, moving.array).added(recording)
    assert added.is_known[:, 0].tolist() == np.isfinite(rudder).tolist()
    assert_allclose(added.rows_T[1::2, 0], 1e-8 * rudder[1::2])


def test_live_it_is_what_the_whole_recording_tells(moving):
    """Samples as they arrive know no later ones, and yet the signal is the same to some per cent."""
    readings = moving.sensed_T.reshape(moving.sample_count, -1, 3) + moving.errors.bias_T
    live = EffectStream([HULL], moving.errors, moving.array).added(Recording(moving.time_s, readings)).rows_T
    whole = EFFECT.signal(moving, HULL)
    assert_allclose(live[100:], whole[100:], atol=0.02 * np.abs(whole).max())
