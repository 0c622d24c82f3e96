"""The rows on the topics: their columns, and recordings made of them."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tam_calibration.messages.point_cloud import FIELD_GRADIENT_COLUMNS, SampleLayout, center_covariance, field_offsets
from tam_calibration.model.exceptions import InputError

FULL = SampleLayout(2, ("scalar", "temperature", "current", "attitude"))


def test_columns_are_in_the_order_of_the_design():
    """Time, readings, then the channels."""
    assert FULL.columns == (
        *("time_s", "b1x_T", "b1y_T", "b1z_T", "b2x_T", "b2y_T", "b2z_T"),
        *("scalar_T", "temperature_C", "current_A", "qx", "qy", "qz", "qw"),
    )
    assert SampleLayout(1).columns == ("time_s", "b1x_T", "b1y_T", "b1z_T")
    assert field_offsets(("a", "b")) == [("a", 0), ("b", 8)]
    assert len(FIELD_GRADIENT_COLUMNS) == 18


@pytest.mark.parametrize(
    "layout",
    [
        FULL,
        SampleLayout(1),
        SampleLayout(4, ("scalar",)),
        SampleLayout(11, ("attitude",)),
        SampleLayout(2, ("current", "attitude", "current_2_A", "actuator_rudder")),
        SampleLayout(3, ("actuator_rudder",)),
    ],
)
def test_a_layout_is_known_by_its_columns(layout):
    """Columns give the layout back, and rows the recording."""
    assert SampleLayout.from_columns(layout.columns) == layout
    rows = np.random.default_rng(6).normal(size=(5, len(layout.columns)))
    rows[:, 0] = np.arange(5)
    recording = layout.recording(rows)
    assert SampleLayout.of(recording) == layout
    assert_array_equal(layout.rows(recording), rows)


@pytest.mark.parametrize("columns", [(), ("time_s",), ("time_s", "b1x_T", "b1z_T", "b1y_T"), ("time_s", "b2x_T")])
def test_other_columns_are_refused(columns):
    """What is no sample is named."""
    with pytest.raises(InputError, match="samples must have the columns time_s"):
        SampleLayout.from_columns(columns)


def test_a_channel_without_values_is_left_out():
    """A channel that never had a value is None; one with gaps keeps them."""
    rows = np.ones((3, len(FULL.columns)))
    rows[:, 0] = np.arange(3)
    rows[:, 7] = np.nan
    rows[0, 8] = np.nan
    recording = FULL.recording(rows)
    assert recording.scalar_T is None
    assert_array_equal(recording.temperature_C, [np.nan, 1, 1])


def test_the_covariance_of_the_center_is_row_major():
    """Variances stand on the diagonal of nine numbers."""
    assert center_covariance(np.arange(1.0, 10.0)).tolist() == [1, 0, 0, 0, 4, 0, 0, 0, 9]


def test_a_sample_that_lacks_sensors_is_told_from_one_that_is_none():
    """All axes of a sensor are NaN, not one; another sensor is there; nothing is infinite."""
    layout = SampleLayout(2, ("temperature",))
    rows = np.ones((6, len(layout.columns)))
    rows[1, 1:4] = rows[2, 1:7] = rows[3, 2] = rows[4, 4:7] = rows[5, 1:4] = np.nan
    rows[4, 7], rows[5, 4] = np.nan, np.inf
    assert layout.are_partial(rows).tolist() == [False, True, False, False, True, False]
    assert layout.are_samples(rows).tolist() == [True, False, False, False, False, False]
    assert layout.are_partial(rows[:0]).tolist() == []
