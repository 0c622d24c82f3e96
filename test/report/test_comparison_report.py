"""The page of a comparison: two columns, one look, what differs on top, the mend to copy."""

import html
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.comparison.mend import gazebo_sdf, python_plugin
from tam_calibration.correction.parts import Provenance
from tam_calibration.files.yaml_document import dump_mapping
from tam_calibration.model.units import to_nanotesla
from tam_calibration.report import comparison_report
from tam_calibration.report.blocks import Image
from tam_calibration.report.comparison_report import (
    SIDE_COLORS,
    plot_noise,
    row_to_draw,
    states_of,
    write_comparison_report,
)
from tam_calibration.report.comparison_rows import next_words
from tam_calibration.report.gap_plots import cell_means, plot_histogram, plot_sphere
from tam_calibration.report.recording_plots import cells_on_map
from tam_calibration.results.comparison_json import mend_to_mapping

SOURCES = (Provenance("sim<1>.mcap", 12, "ab" * 32), Provenance("dive.csv", 34, "cd" * 32))


@pytest.fixture(scope="module")
def write(tmp_path_factory):
    """Return a function that writes the page of a comparison without figures: its HTML, its headings and its words."""

    def embed(figure, alternative, caption):
        return Image("data:image/svg+xml;base64,", alternative, caption)

    @cache
    def write(comparison):
        path = tmp_path_factory.mktemp("page") / "compare.html"
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(comparison_report, "embed", embed)
            for plot in ("plot_noise", "plot_sphere", "plot_histogram"):
                patch.setattr(comparison_report, plot, lambda *arguments: None)
            write_comparison_report(path, comparison, *SOURCES)
        page = path.read_text(encoding="utf-8")
        assert not re.search(r"url\(|@import|https?://|<script|<link|<iframe", page)
        assert all(source.startswith("data:image/svg+xml;base64,") for source in re.findall(r'src="([^"]*)"', page))
        bare = re.sub(r"<[^>]*>", " ", page[page.index("<body>") :])
        words = re.sub(r"\s+", " ", html.unescape(bare))
        return page, re.findall(r"<h2>(.*?)</h2>", page), words

    return write


def test_what_differs_comes_first_and_the_mend_last(comparison, write):
    """Verdict, what differs, then drawn, then every figure, then what to copy."""
    page, headings, words = write(comparison)
    assert headings == [
        "Verdict",
        "What differs",
        "Noise",
        "Residuals",
        "How far the mend closes the gap",
        "Side by side",
        "The mend, to copy",
    ]
    assert words.index("Different: The simulation lacks temperature_drift") < words.index("What differs")
    assert page.count("<img") == 3
    assert "sim<1>.mcap" in words and "dive.csv" in words
    assert "nan" not in words.lower().split()


def test_effects_stand_in_the_column_of_the_side_that_has_them(comparison, write):
    """Missing, surplus and otherwise; with place, probability and parameters ± standard errors of each side."""
    _, _, words = write(comparison)
    for row in (
        "temperature drift lacks it has it sensor 2 98 % 1.90",
        "an unknown effect has it could not show it the scalar",
        "temperature drift has it otherwise has it sensor 2",
        "sensor 2 x offset – 1.000 ± 0.020 nT/°C",
        "sensor 2 x offset 1.000 ± 0.020 2.000 ± 0.020 nT/°C",
        "sensor 2 y 1.000 ± 0.020 2.000 ± 0.040 white band 10 to 14 Hz differs",
        "rate 100.000 ± 0.010 50.000 ± 0.020 Hz −2236 differs",
        "source error foretold wrongly by (m) 0.250 0.0200",
        "each further term of the mend gap after it (noise floors)",
        "mended simulation 0.330 0.280 to 0.380",
        "99 % of the gap's energy is closed (95 % confidence: 97 % to 100 %).",
        "What stays open: A tenth of the drift of sensor 2 stays.",
    ):
        assert row in words.replace("\N{NO-BREAK SPACE}", " "), row


def test_what_is_to_be_copied_is_text(comparison, write):
    """What HTML would take for its own is shown as it is, to the last character."""
    page, _, _ = write(comparison)
    blocks = [html.unescape(text) for text in re.findall(r'<pre class="code">(.*?)</pre>', page, re.DOTALL)]
    mend = comparison.mend
    assert blocks[:2] == [gazebo_sdf(mend), python_plugin(mend)]
    assert blocks[2] == dump_mapping(mend_to_mapping(mend))
    assert "tam simulate --from-comparison mend.yaml" in blocks[3]


def test_a_mistake_is_told_with_its_mend_and_nothing_else(mistaken, write):
    """In the words of simulators, set apart; there is nothing to draw."""
    page, headings, words = write(mistaken)
    assert headings == ["Verdict"] and "<img" not in page
    assert re.search(r'class="doubt">[^<]*gauss was written where the topic has tesla', page)
    assert "Where: all sensors. Mend: Divide the readings by 10 000." in words
    assert "compare again: nothing else was compared" in words


def test_the_same_is_said_and_has_no_mend(comparison, write):
    """Two runs that differ in nothing."""
    same = replace(
        comparison, verdict="same", statement="Nothing differs.", missing=(), surplus=(), other_parameters=()
    )
    page, headings, words = write(same)
    assert '<p class="good">The same: Nothing differs.</p>' in page
    assert "No effect is in one of the two" in words and "The mend, to copy" not in headings


def test_what_only_the_simulation_has_is_to_be_taken_out(comparison):
    """Beside what is to be written, where there is any; of an unknown effect neither can be said."""
    assert next_words(comparison).startswith("Write the mend into the simulator")
    removed = replace(comparison, mend=replace(comparison.mend, removed=("temperature_drift", "hysteresis")))
    assert next_words(removed).startswith("Take temperature drift and hysteresis out of the simulator. Write the mend")
    quiet = tuple(replace(one, differs=False) for one in comparison.noise)
    alone = replace(removed, noise=quiet, mend=replace(removed.mend, added=()))
    assert next_words(alone).endswith("out of the simulator, record the simulation again, and compare again.")
    unknown = replace(alone, mend=replace(alone.mend, removed=()))
    assert next_words(unknown).startswith("What differs is no effect of the library")


def test_errors_of_the_sensors_are_said_to_be_no_difference(comparison, write):
    """A calibration removes them, however many standard errors they are apart."""
    assert "are what a calibration removes" in write(comparison)[2]


def test_without_attitude_no_source_is_told(comparison, write):
    """The error of a source is left out where it cannot be known."""
    closing = replace(comparison.closing, simulation_source=None, recording_source=None, mended_source=None)
    page, _, words = write(replace(comparison, closing=closing))
    assert page.count("<img") == 3 and "source error" not in words


def test_figures_are_within_the_page(comparison, tmp_path):
    """All three are drawn, and nothing is fetched."""
    write_comparison_report(tmp_path / "drawn.html", comparison, *SOURCES)
    page = (tmp_path / "drawn.html").read_text(encoding="utf-8")
    assert len(re.findall(r'src="data:image/svg\+xml;base64,\w', page)) == page.count("<img") == 3


def test_the_same_comparison_gives_the_same_page(comparison, write):
    """A page is the same file whenever it is made; so is a figure (test_plots.py)."""
    assert write(replace(comparison))[0] == write(comparison)[0]


def test_every_axis_is_drawn_with_both_spectra(comparison):
    """Sensor 2 y: the recording's density is four times that of the simulation far from the band, 2 × in nT/√Hz."""
    panels = {axes.get_title("left"): axes for axes in plot_noise(comparison.noise).axes}
    assert len(panels) == 13 and [title for title in panels if "differs" in title] == ["sensor 2 y: differs"]
    simulation, recording = panels["sensor 2 y: differs"].lines
    assert (simulation.get_color(), recording.get_color()) == (SIDE_COLORS["simulation"], SIDE_COLORS["recording"])
    assert_allclose(simulation.get_ydata(), np.sqrt(2 / 100))  # nT/√Hz of 1 nT at 100 Hz
    assert recording.get_ydata()[-1] == pytest.approx(2 * np.sqrt(2 / 100))


def test_a_simulator_without_noise_is_drawn(comparison):
    """It has no density on a logarithmic axis; the recording's is shown."""
    silent = replace(
        comparison.noise[0].simulation,
        level_T=0.0,
        density_T2_per_hz=np.zeros(129),
        density_low_T2_per_hz=np.zeros(129),
        density_high_T2_per_hz=np.zeros(129),
    )
    low, high = plot_noise([replace(comparison.noise[0], simulation=silent, differs=True)]).axes[0].get_ylim()
    assert 0 < low < np.sqrt(2 / 100) < high


def test_residuals_of_both_are_drawn_of_the_row_that_differs_most(comparison):
    """An axis of sensor 2: two maps of the sphere on one scale, and by size over each other."""
    states = states_of(comparison)
    row = row_to_draw(states)
    assert row // 3 == 1
    maps = [axes for axes in plot_sphere(states, row).axes if axes.get_title()]
    assert [axes.get_title() for axes in maps] == ["simulation", "recording"]
    meshes = [axes.collections[0] for axes in maps]
    assert meshes[0].get_clim() == meshes[1].get_clim()
    longitude, latitude, cell = cells_on_map()
    for state, mesh in zip(states, meshes, strict=True):
        means = cell_means(to_nanotesla(state.rows_T[:, row]), state.residue.direction)
        drawn = mesh.get_array()
        assert drawn.shape == (len(latitude), len(longitude))
        assert_array_equal(drawn.filled(np.nan), means[cell])
    labels = plot_histogram(states, row).axes[0].get_legend_handles_labels()[1]
    assert labels == ["simulation", "recording", "noise floor alone"]
