"""A map of the field over survey lines."""

import numpy as np
import pytest

from tam_calibration.localization.targets import SurveyLine, field_map, require_area
from tam_calibration.model.exceptions import InputError


def line(y_m):
    """Return a line along x in a field that grows linearly along both axes."""
    x = np.arange(0.0, 40.0, 0.4)
    center = np.column_stack([x, np.full(len(x), y_m), np.zeros(len(x))])
    return SurveyLine([], center, x, 48e-6 + 1e-9 * (x - 19.8) + 2e-9 * y_m, 1e-9 * (3 + y_m + x), np.ones(len(x)))


def test_a_linear_field_is_exact_between_lines():
    """The anomaly counts from the median over all lines."""
    found = field_map([line(-8.0), line(0.0), line(8.0)])
    x, y = np.meshgrid(found.x_m, found.y_m)
    is_known = np.isfinite(found.anomaly_T)
    assert is_known.mean() > 0.9
    assert found.anomaly_T[is_known] == pytest.approx((1e-9 * (x - 19.8) + 2e-9 * y)[is_known], abs=1e-12)
    assert found.contraction_T_per_m[is_known] == pytest.approx(1e-9 * (3 + x + y)[is_known], abs=1e-15)


def test_cells_far_from_every_sample_stay_empty():
    """In the middle between lines 50 m apart."""
    found = field_map([line(0.0), line(50.0)])
    middle = np.abs(found.y_m - 25) < 10
    assert np.isnan(found.anomaly_T[middle]).all() and not np.isnan(found.anomaly_T).all()


def test_one_straight_line_has_no_area():
    """A lawn-mower pattern in one recording has."""
    with pytest.raises(InputError, match="beside each other"):
        require_area([line(0.0).center_m])
    require_area([np.concatenate([line(0.0).center_m, line(8.0).center_m])])
