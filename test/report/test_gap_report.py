"""The page says what departs from the twin, in which axes, and that nothing does where nothing does."""

import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.correction.parts import Provenance
from tam_calibration.effects.effect import Limit, Sized
from tam_calibration.gap.checks import checks_of
from tam_calibration.gap.result import Residue
from tam_calibration.report.gap_plots import (
    GapView,
    binned,
    plot_dependence,
    plot_evidence,
    plot_histogram,
    plot_map,
    plot_sphere,
    plot_time,
    spectrum,
)
from tam_calibration.report.gap_report import checks_blocks, write_gap_report
from tam_calibration.report.page import embed


def view_of(gap, rows_T):
    """Return a gap whose checks are those of a residual."""
    residue = gap.residue
    checks = checks_of(residue.time_s, residue.direction, rows_T, residue.floor_T)
    return GapView(replace(gap, checks=checks))


def test_without_checks_there_is_no_section(gap):
    """As without a verdict."""
    assert checks_blocks(GapView(gap)) == []


def test_what_looks_like_the_twin_is_said_to(gap):
    """In a sentence."""
    noise = np.random.default_rng(1).normal(size=gap.residue.before.shape) * gap.residue.floor_T
    (words,) = checks_blocks(view_of(gap, noise))
    assert "and so it does" in words.text


def test_what_departs_is_told(gap):
    """In the sentences that the terminal and the JSON have too."""
    words, points = checks_blocks(view_of(gap, gap.residue.before))
    assert "It does not" in words.text
    assert any("correlated from sample to sample" in point for point in points.points)


@pytest.fixture
def write(tmp_path, read_page):
    """Return a function that writes a page and reads it back."""

    def write(gap):
        write_gap_report(tmp_path / "gap.html", gap, Provenance("dive<1>.csv", 123, "ab" * 32))
        return read_page(tmp_path / "gap.html")

    return write


def test_the_page_says_what_is_open_and_what_departs(gap, write, undrawn):
    """The unknown part in the verdict, the checks in a section of their own, the prior beside the cause."""
    residue = gap.residue
    checks = checks_of(residue.time_s, residue.direction, residue.before, residue.floor_T)
    cause = replace(gap.causes[0], sizes=(Sized("offset", 2e-9, Limit(1e-6, "a book", "T")),))
    page = write(replace(gap, causes=(cause,), checks=checks, remainder="It drifts.", set_95=("unknown",)))
    assert page.headings[4] == "Against the simulated twin"
    for words in (
        "What no cause explains: It drifts.",
        "the truth is among: unknown.",
        "largest known is 1000",
        "noise alone",
    ):
        assert words in page.text
    assert all(sentence in page.text.replace("\N{NO-BREAK SPACE}", " ") for sentence in checks.sentences)


def of_size(gap, sample_count, sensor_count=4):
    """Return a gap whose residue has another number of samples and sensors."""
    rng = np.random.default_rng(3)
    rows = 3 * sensor_count + 1
    direction = rng.normal(size=(sample_count, 3))
    residue = Residue(
        1.7e9 + np.arange(sample_count) / 100,
        direction / np.linalg.norm(direction, axis=1, keepdims=True),
        *rng.normal(size=(3, sample_count, rows)),
        np.ones(rows),
    )
    return replace(gap, residue=residue)


def test_the_questions_are_answered_in_order(gap, write, undrawn):
    """Is there a gap, where, which cause, how far does it shrink, what explained nothing, what next."""
    page = write(gap)
    assert page.headings == [
        "Verdict",
        "Where it lies",
        "Causes, ranked",
        "How far it shrinks",
        "What explained nothing",
        "What to record next",
    ]
    assert page.text.count("What you see:") == page.text.count("Without a gap:") == len(page.references) == 7
    for words in ("Explained: The readings of sensor 2 drift", "99.8 % of the gap's energy", "at 0 to 0.500 Hz"):
        assert words in page.text
    for words in ("2.000 ± 0.020", "nT/°C", "60.0 ± 5.0", "bias_jump", "needs the attitude", "not supported"):
        assert words in page.text
    assert "dive<1>.csv" in page.text


@pytest.mark.parametrize(
    ("verdict", "name", "images"),
    [("no_gap", "No gap", 7), ("unexplained", "Unexplained", 7), ("not_identifiable", "Not identifiable", 0)],
)
def test_every_verdict_has_a_page(gap, write, undrawn, verdict, name, images):
    """Without causes nothing is taken away; without a verdict there is nothing to draw."""
    page = write(replace(gap, verdict=verdict, causes=(), where=replace(gap.where, sensors=(), axes=())))
    assert page.text.count(f"{name}: ") == 1
    assert len(page.references) == images
    assert "nan" not in page.text.lower().split()


def of_sensor_1(gap, sample_count, sensor_count=1):
    """Return a gap in sensor 1, of no known cause and without a scalar."""
    other = of_size(replace(gap, causes=(), where=replace(gap.where, sensors=(1,))), sample_count, sensor_count)
    other.residue.before[:, -1] = other.residue.twin[:, -1] = np.nan
    return other


def test_thirty_sensors_are_mapped(gap):
    """Their names find place beside the map."""
    assert embed(plot_map(GapView(of_sensor_1(gap, 200, 30))), "map").source


def test_a_long_recording_has_a_small_page(gap, write, tmp_path):
    """Time and size of the page stay bounded for an hour at 100 Hz; one sensor without a scalar is drawn."""
    start = time.process_time()
    assert "sensor 1" in write(of_sensor_1(gap, 360_000)).text
    assert time.process_time() - start < 30
    assert 100_000 < (tmp_path / "gap.html").stat().st_size < 3_000_000


def test_the_same_gap_gives_the_same_page(gap, tmp_path, undrawn):
    """A page is the same file whenever it is made; so is a figure (test_plots.py)."""
    for name in ("a.html", "b.html"):
        write_gap_report(tmp_path / name, gap)
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_the_map_shows_sizes_in_noise_floors(gap):
    """Sensor 2 stands out in the recording, and nothing does without the cause or in the twin."""
    figure = plot_map(GapView(gap))
    recording, without, twin = (axes.images[0].get_array() for axes in figure.axes)
    residue = gap.residue
    expected = np.sqrt(np.mean(residue.before[:, 3:6] ** 2, axis=0)) / residue.floor_T[3:6]
    assert_allclose(recording[1], expected)
    for cells in (without, twin):
        assert_allclose(cells[:-1], 1, atol=0.15)


def test_the_rows_drawn_are_those_of_the_gap_and_its_causes(gap):
    """The largest row in the place that was found, and one for each other cause."""
    view = GapView(gap)
    assert [row // 3 for row in view.rows] == [1]
    scalar = replace(gap.causes[0], sensors=("scalar",), axes=())
    assert GapView(replace(gap, causes=(gap.causes[0], scalar))).rows[1] == 12
    assert view.row_name(12) == "scalar" and view.row_name(4) == "sensor 2 y"


def test_every_figure_shows_the_twin(gap):
    """Recording, recording without causes and twin stand side by side."""
    view = GapView(gap)
    row = view.rows[0]
    for figure in (plot_map(view), plot_time(view, row), plot_sphere(view.states, row)):
        titles = {axes.get_title("left") or axes.get_title() for axes in figure.axes}
        assert {"recording", "without its causes", "simulated twin"} <= titles
    for figure in (plot_dependence(view, row), plot_histogram(view.states, row)):
        labels = figure.axes[0].get_legend_handles_labels()[1]
        assert {"recording", "without its causes", "simulated twin"} <= set(labels)


def test_white_noise_is_one_at_every_frequency():
    """Whatever the number of samples, and with a hole in the record."""
    rng = np.random.default_rng(4)
    time_s = np.delete(np.arange(40_000) * 0.01, slice(9_000, 14_000))
    frequency, amplitude = spectrum(time_s, rng.normal(size=len(time_s)))
    assert_allclose(amplitude[frequency > 5], 1, atol=0.2)
    tone = 0.2 * np.sin(2 * np.pi * 7 * time_s)
    frequency, amplitude = spectrum(time_s, tone + rng.normal(size=len(time_s)))
    assert frequency[np.argmax(amplitude)] == pytest.approx(7, abs=0.1)


def test_dependence_shows_the_slope(gap):
    """The mean over temperature rises as the drift does."""
    temperature, mean = binned(gap.residue.temperature_C, gap.residue.before[:, 3] * 1e9, np.mean)
    assert np.polyfit(temperature, mean, 1)[0] == pytest.approx(1, abs=0.1)


def test_probabilities_are_drawn(gap):
    """The likeliest cause stands on top."""
    bars = plot_evidence(gap).axes[0].patches
    assert [bar.get_width() for bar in bars] == [0.98, 0.015, 0.005]
