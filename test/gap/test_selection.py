"""The terms that the data ask for are selected, and no others."""

from math import log

import numpy as np
import pytest

from tam_calibration.effects.term import Coefficient, Term
from tam_calibration.gap.regression import Choice, Projected, bundles_of, columns_of, evidence
from tam_calibration.model.fitted_effect import ALL, SCALAR

COUNT = 2000
GRID = [(sensor, axis, name) for name in ("offset", "scale") for sensor in range(3) for axis in range(3)]


def terms_of(keys, width=1):
    """Return terms of which only the names count."""
    names = tuple(Coefficient(str(number), "T") for number in range(width))
    return [Term(*key, names, np.empty((0, width)), np.zeros(width, int), np.arange(width)) for key in keys]


def projected_of(matrix, observed):
    """Return the normal equations of columns without a base."""
    information = matrix.T @ matrix
    return Projected(information, matrix.T @ observed, np.diag(information).copy())


def chosen_from(matrix, observed, terms):
    """Return the selection, and the energy."""
    energy = float(observed @ observed)
    return Choice(projected_of(matrix, observed), terms, energy, len(observed)).select(), energy


@pytest.fixture
def noise():
    """Return columns without correlation beyond chance, and white noise."""
    generator = np.random.default_rng(3)
    return generator.normal(size=(COUNT, len(GRID))), generator.normal(size=COUNT)


def test_a_planted_term_is_found_and_no_other(noise):
    """One column in eighteen; its gain is that of least squares, and its evidence is BIC less the choice."""
    matrix, observed = noise
    observed = observed + 0.3 * matrix[:, 7]
    found, energy = chosen_from(matrix, observed, terms_of(GRID))
    gain = (matrix[:, 7] @ observed) ** 2 / (matrix[:, 7] @ matrix[:, 7])
    assert found.terms == (7,) and found.rank == 1
    assert found.gain == pytest.approx(gain)
    choice = 2 * log(len(bundles_of(terms_of(GRID))))
    assert found.delta_bic == pytest.approx(COUNT * log(energy / (energy - gain)) - log(COUNT) - choice)


def test_terms_of_several_sensors_are_all_found(noise):
    """What is planted in three places without a common name is found in these three."""
    matrix, observed = noise
    observed = observed + 0.3 * matrix[:, 0] - 0.4 * matrix[:, 4] + 0.3 * matrix[:, 17]
    found, _ = chosen_from(matrix, observed, terms_of(GRID))
    assert found.terms == (0, 4, 17)


@pytest.mark.parametrize("seed", range(8))
def test_what_one_sensor_shares_with_the_others_is_not_left_out(seed):
    """Columns that add up to nothing, as turns of all sensors alike do: each of them may go, and none does."""
    generator = np.random.default_rng(seed)
    matrix = generator.normal(size=(COUNT, 4))
    matrix -= matrix.mean(axis=1, keepdims=True)
    observed = matrix @ generator.uniform(0.5, 2, 4) + generator.normal(size=COUNT)
    found, _ = chosen_from(matrix, observed, terms_of([(sensor, None, "turn") for sensor in range(4)]))
    assert found.terms == (0, 1, 2, 3) and found.rank == 3


@pytest.mark.parametrize("seed", range(8))
def test_of_equal_terms_the_first_is_taken(seed):
    """A harmonic with the alias of its line explains as much, but for rounding."""
    generator = np.random.default_rng(seed)
    wave = generator.normal(size=COUNT)
    matrix = np.column_stack([wave, wave * (1 + 1e-13)])
    found, _ = chosen_from(matrix, wave + generator.normal(size=COUNT), terms_of([(0, 0, "line"), (0, 0, "harmonics")]))
    assert found.terms == (0,)


def test_noise_asks_for_nothing():
    """In a hundred draws of noise no selection has positive evidence but by the rarest chance."""
    positive = 0
    for seed in range(100):
        generator = np.random.default_rng(seed)
        matrix, observed = generator.normal(size=(300, 18)), generator.normal(size=300)
        positive += chosen_from(matrix, observed, terms_of(GRID))[0].delta_bic > 0
    assert positive <= 1


@pytest.mark.parametrize(("factor", "taken"), [(0.9, False), (1.1, True)])
def test_a_further_term_must_pay_its_price(factor, taken):
    """A second term comes in where its likelihood ratio is above ln n and the price of choosing, not below."""
    keys = [(0, 0, "a"), (1, 1, "b")]
    price = log(COUNT) + 2 * log(len(bundles_of(terms_of(keys))))
    rest = 1000.0
    second = rest * (np.exp(factor * price / COUNT) - 1)
    first = 500.0
    projected = Projected(np.eye(2), np.sqrt([first, second]), np.ones(2))
    found = Choice(projected, terms_of(keys), first + second + rest, COUNT).select()
    assert found.terms == ((0, 1) if taken else (0,))


def test_a_stand_in_is_dropped_once_the_causes_are_in():
    """A column near the sum of two causes comes in first and goes out when both are in."""
    generator = np.random.default_rng(5)
    causes = generator.normal(size=(COUNT, 2))
    matrix = np.column_stack([causes, causes.sum(axis=1) + 0.3 * generator.normal(size=COUNT)])
    observed = causes @ [1.0, 1.0] + 0.5 * generator.normal(size=COUNT)
    alone = projected_of(matrix, observed).gains([np.array([index]) for index in range(3)])[0]
    assert alone.argmax() == 2
    found, _ = chosen_from(matrix, observed, terms_of([(0, 0, "a"), (1, 1, "b"), (2, 2, "c")]))
    assert found.terms == (0, 1) and found.rank == 2


def test_what_is_spread_over_all_axes_is_found_as_a_bundle():
    """Terms of one name, each above the price of its direction but not of a choice of its own, are taken together."""
    terms = terms_of(GRID)
    own = log(COUNT) + log(len(bundles_of(terms)))
    score = np.where([name == "offset" for _, _, name in GRID], np.sqrt(own), 0.0)
    found = Choice(Projected(np.eye(18), score, np.ones(18)), terms, float(COUNT), COUNT).select()
    assert found.terms == tuple(range(9)) and found.delta_bic > 0
    score = score * (np.arange(18) == 4)
    alone = Choice(Projected(np.eye(18), score, np.ones(18)), terms, float(COUNT), COUNT).select()
    assert alone.delta_bic <= 0


def test_bundles_are_terms_sensors_and_names():
    """Each term alone, those of a name in a sensor, those of a name in all sensors; the scalar's stand alone."""
    terms = terms_of([(0, 0, "a"), (0, 1, "a"), (1, 0, "a"), (0, 0, "b"), (SCALAR, None, "a"), (ALL, None, "c")])
    assert set(bundles_of(terms)) == {(0,), (1,), (2,), (3,), (4,), (5,), (0, 1), (0, 1, 2)}


def test_the_first_step_is_the_best_bundle(noise):
    """Its evidence has no price of choosing, and is minus infinity where nothing is visible."""
    matrix, observed = noise
    observed = observed + 0.3 * matrix[:, 7]
    energy, terms = float(observed @ observed), terms_of(GRID)
    gain = projected_of(matrix, observed).gains([np.array([7])])[0][0]
    projected = projected_of(matrix, observed)
    assert Choice(projected, terms, energy, COUNT).first_step == pytest.approx(evidence(energy, gain, COUNT, 1))
    nothing = Projected(np.zeros((18, 18)), np.zeros(18), np.ones(18))
    assert Choice(nothing, terms, energy, COUNT).first_step == -np.inf
    assert Choice(nothing, terms, energy, COUNT).select().terms == ()


def test_columns_stand_in_the_order_of_the_terms():
    """A term with three coefficients has three columns."""
    terms = terms_of([(0, 0, "a")]) + terms_of([(0, 1, "a")], 3) + terms_of([(0, 2, "a")])
    assert [columns.tolist() for columns in columns_of(terms)] == [[0], [1, 2, 3], [4]]


def test_terms_of_several_coefficients_stand_or_fall_together():
    """A term of three columns of which one is planted spends three directions."""
    generator = np.random.default_rng(6)
    matrix, observed = generator.normal(size=(COUNT, 9)), generator.normal(size=COUNT)
    found, _ = chosen_from(matrix, observed + 0.4 * matrix[:, 4], terms_of([(0, axis, "a") for axis in range(3)], 3))
    assert found.terms == (1,) and found.rank == 3


def test_a_term_that_cannot_be_seen_is_not_chosen(noise):
    """Nor does it keep others from being chosen."""
    matrix, observed = noise
    observed = observed + 0.3 * matrix[:, 7]
    matrix = matrix * (np.arange(len(GRID)) != 3)
    assert chosen_from(matrix, observed, terms_of(GRID))[0].terms == (7,)
