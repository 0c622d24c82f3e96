"""Designs that share features say what their columns say one by one."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.term import Coefficient, Term, at_rows
from tam_calibration.gap.regressors import Regressors

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
