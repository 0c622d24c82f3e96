"""A reference that does not follow the field."""

import numpy as np
from numpy.testing import assert_allclose

from tam_calibration.effects.courses import GeomagneticDrift
from tam_calibration.model.fitted_effect import SCALAR

SHAPE = {"start_s": 1.7e9, "span_s": 60.0}
EFFECT = GeomagneticDrift()


def test_coefficients_come_back(turning, refitted):
    """Functions of time of all orders are told apart, at the time of day of a real record."""
    keys = [(SCALAR, None, name) for name in ("orders 1 to 2", "orders 5 to 8", "orders 17 to 32")]
    deviation, error = refitted(EFFECT, turning(start_s=1.7e9), SHAPE, *keys)
    assert np.abs(deviation).max() < 4
    assert error.max() < 0.2


def test_a_line_in_time_is_the_first_order(turning):
    """The first function is the time itself, from -1 to 1."""
    covariates = turning(samples=1201)
    lowest = EFFECT.terms(covariates, {"start_s": 0.0, "span_s": 60.0})[0]
    assert_allclose(lowest.features[:, 0], np.linspace(-1, 1, 1201), atol=1e-12)


def test_outside_the_record_it_stays_where_it_was(turning):
    """A drift is not extrapolated."""
    covariates = turning(samples=1200)
    terms = EFFECT.terms(covariates, {"start_s": 20.0, "span_s": 20.0})
    for term in terms:
        assert_allclose(term.features[-1], 1, atol=1e-12)


def test_few_samples_show_nothing(turning):
    """Every record is too short for something."""
    assert "too few" in EFFECT.obstacle(turning(samples=12))
    assert EFFECT.obstacle(turning(samples=300)) is None


def test_eight_samples_in_a_half_period_are_enough(turning):
    """The lowest orders are two half periods: twenty samples hold them, with some to spare."""
    assert EFFECT.obstacle(turning(samples=20)) is None
