"""Designs that share features say what their columns say; a field of the world gives three channels a sample."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.courses import Flexure, GeomagneticDrift
from tam_calibration.effects.term import Coefficient, Term, at_rows
from tam_calibration.gap.regression import Base
from tam_calibration.gap.regressors import Regressors, World
from tam_calibration.gap.whitened_channels import WhitenedChannels

ROWS, SAMPLES = 13, 30
GENERATOR = np.random.default_rng(15)
SHARED, OWN = GENERATOR.normal(size=(SAMPLES, 2)), GENERATOR.normal(size=(SAMPLES, 3))


def term(features, rows, columns):
    """Return a term with an atom for each of its features."""
    coefficients = tuple(Coefficient(f"c{number}", "T") for number in range(max(columns) + 1))
    return Term(0, None, "term", coefficients, features, np.array(rows), np.array(columns))


SPREAD = term(SHARED, np.where(np.isin(np.arange(ROWS), [4, 7, 12]), GENERATOR.normal(size=(2, ROWS)), 0.0), [0, 1])
TERMS = [term(SHARED, [4, 7], [0, 1]), term(OWN, [1, 4, 12], [0, 0, 1]), term(SHARED, [2, 2], [0, 0])]


def dense(design):
    """Return the regressors (N, R, P) of the columns in the rows."""
    whole = np.zeros((len(design.features), ROWS, design.width))
    parts = design.rows if design.rows.ndim == 2 else np.eye(ROWS)[design.rows]
    for feature, part, column in zip(design.index, parts, design.columns, strict=True):
        whole[:, :, column] += design.features[:, feature, None] * part
    return whole


@pytest.mark.parametrize("terms", [TERMS, [*TERMS, SPREAD]])
def test_terms_stand_side_by_side(terms):
    """Each column adds what its coefficient does, and features of several terms are held once."""
    design = Regressors.of(terms)
    assert design.features.shape == (SAMPLES, 5) and design.width == 5 + 2 * (SPREAD in terms)
    expected = [each.signal(unit, ROWS) for each in terms for unit in np.eye(len(each.coefficients))]
    assert_allclose(dense(design), np.stack(expected, axis=2))


def test_an_atom_may_act_on_several_rows():
    """It adds what an atom for each of them adds."""
    every = [4, 7, 12]
    parts = SPREAD.rows[:, every]
    apart = term((SHARED[:, :, None] * parts).reshape(SAMPLES, -1), [*every, *every], np.repeat([0, 1], 3))
    values = GENERATOR.normal(size=2)
    assert_allclose(SPREAD.signal(values, ROWS), apart.signal(values, ROWS))
    by_row = GENERATOR.normal(size=(ROWS, 3))
    assert_allclose(
        at_rows(by_row, SPREAD.rows),
        (parts.ravel()[:, None] * at_rows(by_row, apart.rows)).reshape(2, 3, 3).sum(axis=1),
    )


@pytest.mark.parametrize("others", [TERMS[1:2], [SPREAD]])
def test_designs_are_joined(others):
    """Joined they have the columns of both, also where the atoms of one alone act on several rows."""
    parts = [Regressors.of(TERMS), Regressors.of(others)]
    assert_allclose(dense(Regressors.joined(parts)), np.concatenate([dense(part) for part in parts], axis=2))


def test_channels_are_white_under_the_model(lone):
    """The residuals of the three axes have unit variance, and no correlation between each other."""
    channels = lone(4000).channels()
    residual = channels.differential
    assert residual.shape == (4000, 3)
    assert channels.count == 12000
    assert channels.energy == pytest.approx(np.sum(residual**2))
    # 5.5 standard deviations of a covariance from so many samples: one in ten million.
    assert_allclose(residual.T @ residual / 4000, np.eye(3), atol=5.5 * np.sqrt(2 / 4000))


def test_the_field_is_the_sensor_s_and_not_what_it_reads(lone):
    """Field and attitude are those of the sensor's own frame, however what records the attitude is mounted."""
    made = lone(100, noise_T=1e-6)
    covariates = made.channels().covariates
    assert_allclose(covariates.field_T, made.field_T, atol=1e-12)
    assert_allclose(made.world.field(covariates.attitude), made.field_T, atol=1e-12)
    assert covariates.take(slice(3)).follows_attitude


def test_the_calibration_is_linearised(lone):
    """A small step of errors and world leaves the energy that the design says, at readings without noise."""
    made = lone(300, noise_T=1e-17)
    array = made.array.with_noise(np.array([1e-9]), 0.0)
    channels = WhitenedChannels.at(made.recording, array, made.errors, made.world.intensity_T, world=made.world)
    design = channels.calibration
    assert design.width == 15
    step = 1e-6 * np.random.default_rng(4).normal(size=15)
    errors, world = made.world.stepped(made.errors, step, float(np.mean(channels.covariates.intensity_T)))
    moved = WhitenedChannels.at(made.recording, array, errors, made.world.intensity_T, world=world)
    assert moved.energy == pytest.approx(step @ channels.cross(design, design) @ step, rel=1e-3)
    assert np.linalg.det(errors.matrix[0]) == pytest.approx(1)


def test_matrix_scale_and_mount_are_parted(lone):
    """Any right-handed matrix on any field is a sensor's triangle of determinant 1, a mount and a longer field."""
    made, generator = lone(20), np.random.default_rng(5)
    matrix = 3 * np.eye(3) + generator.normal(size=(3, 3))
    errors, world = World.of(matrix[None], np.zeros((1, 3)), made.world.field_T, made.world.mount)
    attitude = made.recording.attitude
    expected = made.world.field(attitude) @ made.world.mount.T @ matrix.T
    assert_allclose(world.field(world.attitude(attitude)) @ errors.matrix[0].T, expected, atol=1e-15)
    assert_allclose(errors.misalignment, 0, atol=1e-12)
    assert np.linalg.det(errors.matrix[0]) == pytest.approx(1)


def test_an_intensity_that_drifts_is_seen_by_all_axes(lone):
    """A field 20 nT longer for a time is told from the calibration by its course in time, and taken off again."""
    made = lone()
    drift = 20e-9 * np.sin(made.recording.time_s / 9)
    unit = made.field_T / np.linalg.norm(made.field_T, axis=1, keepdims=True)
    disturbed = made.with_added(drift[:, None] * unit @ made.errors.matrix[0].T)
    channels, effect = disturbed.channels(), GeomagneticDrift()
    (shape,) = effect.shapes(channels.covariates, channels.residuals)
    base, terms = Base(channels, [channels.calibration]), effect.terms(channels.covariates, shape)
    projected = base.project(channels.design(terms))
    values = projected.inverse()[0] @ projected.score
    assert base.energy > 20 * base.channels.count
    added = np.zeros((900, 4))
    starts = np.cumsum([0, *(len(term.coefficients) for term in terms)])
    for term, start in zip(terms, starts, strict=False):
        added += term.signal(values[start : start + len(term.coefficients)], 4)
    left = disturbed.channels(added_T=added)
    assert Base(left, [left.calibration]).energy < 1.1 * left.count


def test_a_sensor_that_bends_can_be_seen(lone):
    """A turn of a single sensor changes no length of a field, but its directions."""
    channels = lone().channels()
    assert Flexure().obstacle(channels.covariates) is None
    projected = Base(channels, [channels.calibration]).project(
        channels.design(Flexure().terms(channels.covariates, {}))
    )
    assert projected.gain()[1] >= 6
