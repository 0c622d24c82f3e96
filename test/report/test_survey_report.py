"""The page on a source: whole in itself; its map shows the source and its ellipses where they are."""

import numpy as np
import pytest

from tam_calibration.localization.solutions import WORLD_FRAME, EulerSolutions, Line, Overall, Status, Survey
from tam_calibration.report.survey_report import (
    MOST_ROWS,
    plot_source_spectrum,
    plot_survey_map,
    sample_blocks,
    statements,
    write_survey_report,
)
from tam_calibration.results.targets_file import survey_to_mapping
from tam_calibration.sources.demodulation import Spectrum


def solutions(count):
    """Return sources of samples, the first of them refused."""
    rng = np.random.default_rng(5)
    spread = np.diag([0.01, 0.04, 0.09])
    position = np.array([3.0, -1.0, -2.0]) + 0.1 * rng.normal(size=(count, 3))
    status = np.zeros(count, dtype=int)
    status[0] = Status.NO_FIELD
    position[0] = np.nan
    moment = np.tile([10.0, 0.0, 0.0], (count, 1))
    return EulerSolutions(position, np.tile(spread, (count, 1, 1)), moment, np.tile(np.eye(3), (count, 1, 1)), status)


@pytest.fixture
def survey():
    """Return the survey of 100 samples."""
    overall = Overall(
        np.array([3.0, -1, -2]), np.diag([1e-4, 4e-4, 1e-4]), np.array([10.0, 0, 0]), np.eye(3), 295.0, 294
    )
    return Survey(WORLD_FRAME, np.arange(100.0), solutions(100), overall, np.array([0, 2e-5, -4e-5]))


def test_page_is_whole_and_tells_the_source(survey, tmp_path, read_page):
    """Position and errors stand on it, the refused are counted with their reason, and nothing is fetched."""
    write_survey_report(tmp_path / "page.html", survey, "dive<1>.csv")
    words = read_page(tmp_path / "page.html").text
    assert "dive<1>.csv" in words
    assert "3.000 ± 0.010" in words and "−1.000 ± 0.020" in words
    assert "1 refused: the field of the source is zero" in words
    assert "Spectrum" not in words


def test_page_of_an_alternating_source_has_a_spectrum(tmp_path):
    """Its frequency and the line in the spectrum."""
    frequency = np.linspace(1, 50, 500)
    power = np.where(np.abs(frequency - 10) < 0.1, 1e4, 1.0)
    line = Line(10.0, 1e-4, Spectrum(frequency, power, 6.0, 10.0, 1e-4))
    survey = Survey(WORLD_FRAME, np.arange(12.0), solutions(12), line=line)
    write_survey_report(tmp_path / "page.html", survey, "coil.csv")
    html = (tmp_path / "page.html").read_text()
    assert "<h2>Spectrum</h2>" in html and html.count("data:image/svg+xml") == 2
    assert "Frequency: 10.00000 ± 0.00010 Hz, found; amplitudes are peak values." in statements(survey)


def test_map_shows_the_source_in_each_view(survey):
    """Plan and profiles hold the source of all; the ellipse of the plan has half axes of √5.99 standard deviations."""
    drawn = plot_survey_map(survey).axes
    panels, magnified = drawn[:3], drawn[3:]
    assert [axes.get_title(loc="left").split(",")[0] for axes in panels] == ["plan", "profile", "profile"]
    for axes, pair in zip(panels, ((0, 1), (0, 2), (1, 2)), strict=True):
        low, high = np.sort([axes.get_xlim(), axes.get_ylim()], axis=1).T
        assert (low < survey.overall.position_m[list(pair)]).all()
        assert (high > survey.overall.position_m[list(pair)]).all()
    ellipse = panels[0].patches[-1]
    assert sorted([ellipse.width, ellipse.height]) == pytest.approx(2 * np.sqrt(5.991464547) * np.array([0.01, 0.02]))
    ellipse = magnified[0].patches[-1]
    assert sorted([ellipse.width, ellipse.height]) == pytest.approx(2 * np.sqrt(5.991464547) * np.array([10.0, 20.0]))
    assert ellipse.get_center() == pytest.approx([0, 0])


def test_spectrum_has_its_line():
    """The line of the power is that of the spectrum, and the threshold is drawn."""
    spectrum = Spectrum(np.linspace(1, 50, 500), np.ones(500), 6.0, 10.0, 1e-4)
    [axes] = plot_source_spectrum(spectrum, 10.0).axes
    assert axes.lines[0].get_ydata() == pytest.approx(spectrum.power)
    assert set(axes.lines[1].get_ydata()) == {6.0}


def test_long_tables_are_thinned(survey):
    """Of many samples some are shown, from the first that was located to the last."""
    rows = sample_blocks(survey)[0].rows
    assert len(rows) == MOST_ROWS
    assert (rows[0][0], rows[-1][0]) == ("1.000", "99.00")


def test_a_survey_as_json_has_its_source_as_a_target(survey):
    """The source of all samples, in the form of the targets of a line."""
    content = survey_to_mapping(survey)
    assert content["schema"] == "tam_calibration/source/1"
    [target] = content["targets"]
    assert target["position_m"] == content["overall"]["position_m"] == [3.0, -1.0, -2.0]
    assert any("near 1 where one dipole explains the readings" in each for each in statements(survey))
