import numpy as np
import pytest

from tam_calibration.fit.coverage import measure_coverage
from tam_calibration.report.page import embed
from tam_calibration.report.recording_plots import (
    Panel,
    plot_coverage,
    plot_distributions,
    plot_over_time,
    thinning_note,
)


def panels(samples: int) -> list[Panel]:
    """Return two residuals of unit noise, some samples unknown."""
    values = np.random.default_rng(5).normal(size=(2, samples))
    values[1, ::7] = np.nan
    return [Panel("sensor 1", values[0], 1.0), Panel("sensor 2", values[1], 1.0)]


def test_rows_are_titled_with_their_root_mean_square():
    """The figures beside the rows are those of the known samples."""
    figure = plot_over_time(np.arange(4.0), [Panel("xx", np.array([3.0, np.nan, -3.0, 3.0]), 1.0)], "nT/m")
    assert figure.axes[0].get_title("right") == "RMS 3.00 nT/m"
    assert figure.axes[0].get_xlabel() == "time from the first sample (s)"


def test_thinned_strokes_keep_the_extremes():
    """Not one outlier is lost by thinning, and it is said that samples were thinned."""
    values = np.zeros(1_000_000)
    values[123_456] = 40.0
    figure = plot_over_time(np.arange(1e6) * 0.01, [Panel("xx", values, 1.0)], "nT/m")
    strokes = figure.axes[0].collections[0].get_segments()
    assert len(strokes) == 1000
    assert max(stroke[:, 1].max() for stroke in strokes) == 40.0
    assert "1000 consecutive samples" in thinning_note(1_000_000)
    assert thinning_note(360) == ""


@pytest.mark.parametrize(("span_s", "unit"), [(60, "s"), (3600, "min"), (86400, "h")])
def test_time_axis_is_readable(span_s, unit):
    """Long recordings are drawn in minutes or hours."""
    figure = plot_over_time(np.linspace(1.7e9, 1.7e9 + span_s, 50), panels(50), "nT")
    assert figure.axes[-1].get_xlabel().endswith(f"({unit})")
    assert figure.axes[-1].get_xlim()[1] < 1.1 * span_s


def test_histogram_counts_what_lies_outside():
    """Outliers beyond the axis are counted in its last bin, and the bars hold all samples that are known."""
    values = np.append(np.random.default_rng(5).normal(size=9990), [*np.full(10, 1000.0), np.nan])
    axes = plot_distributions([Panel("xx", 2 * values, 2.0)], "residual").axes[0]
    density, edges, _ = axes.patches[0].get_data()
    share = density * (edges[1] - edges[0])
    assert share.sum() == pytest.approx(1) and share[-1] == pytest.approx(0.001)
    assert edges[-1] == 30


def test_missing_cells_are_drawn():
    """Each cell of the sphere is either shaded or marked as missing."""
    coverage = measure_coverage(np.array([[1.0, 0, 0], [0, 0.1, -1.0]]))
    visited, missing = (np.ma.count(mesh.get_array()) for mesh in plot_coverage(coverage).axes[0].collections[:2])
    assert visited + missing == 721 * 361
    assert 0 < visited < missing


def test_forward_is_in_the_middle_and_left_on_the_left():
    """The map shows the directions as they are seen from the array."""
    for direction, x_sign in (([1, 0.5, 0.0], -1), ([1, -0.5, 0.0], 1)):
        mesh = plot_coverage(measure_coverage(np.array([direction], dtype=float))).axes[0].collections[0]
        samples = mesh.get_array().reshape(361, 721)
        longitude = np.linspace(-np.pi, np.pi, 721)[~np.ma.getmaskarray(samples).all(axis=0)]
        assert np.sign(longitude.mean()) == x_sign


def test_same_figure_gives_same_bytes():
    """A report of the same data is the same file."""
    first, second = (embed(plot_distributions(panels(500), "nT"), "Histograms").source for _ in range(2))
    assert first == second
    assert first.startswith("data:image/svg+xml;base64,")
