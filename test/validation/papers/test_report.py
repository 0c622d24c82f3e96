"""The page on reproduced papers."""

import math
import re
from dataclasses import replace
from html import escape

import pytest

from tam_validation.papers.not_compared import not_compared
from tam_validation.papers.plots import plot_relative_errors, plot_residuals
from tam_validation.papers.report import write_reproduction_report
from tam_validation.papers.row import PaperNumber
from tam_validation.papers.tables import cells, notes, tally
from tam_validation.papers.wu2025 import simulated_rows

ROWS = [
    PaperNumber("Table 1, TMI", 6685.23, 6685.1912, "nT", "reproduced"),
    PaperNumber(
        "Table 1, <b>ψ</b>",
        0.025,
        -0.025,
        "rad",
        "paper in error",
        "a sign",
        "paper in error",
        "printed",
        -0.025,
        "theory",
    ),
    PaperNumber("Fig. 4, bias", 1, 0.99961, "exponent", "reproduced", "the noise", source="said in words"),
    PaperNumber("Fig. 9, e_T", -1, -1, "sign", "reproduced", "a sign"),
    PaperNumber("Table 2, θ", 0.5, math.nan, "°", "not reproduced", "measured", "not reproduced"),
    PaperNumber("Fig. 5, e_B", 0, -0.0001, "exponent", "reproduced"),
]


def test_cells_are_for_people():
    """Numbers have the digits they are worth, and a reason that several share is one note."""
    assert notes(ROWS) == ["a sign", "the noise", "measured"]
    assert cells(ROWS) == [
        ["Table 1, TMI", "6685.23", "printed", "6685.191", "nT", "1.0000", "reproduced", "", ""],
        ["Table 1, <b>ψ</b>", "0.025", "printed", "−0.025", "rad", "−1.0000", "paper in error", "−0.025, theory", "1"],
        ["Fig. 4, bias", "1", "said in words", "1.000", "exponent", "0.9996", "reproduced", "", "2"],
        ["Fig. 9, e_T", "−1", "printed", "−1", "sign", "1.0000", "reproduced", "", "1"],
        ["Table 2, θ", "0.5", "printed", "–", "°", "–", "not reproduced", "", "3"],
        ["Fig. 5, e_B", "0", "printed", "0.000", "exponent", "–", "reproduced", "", ""],
    ]
    assert tally(ROWS) == [4, 1, 1]


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a page and returns its HTML, which needs nothing else."""

    def write(rows, sweeps):
        path = tmp_path / "page.html"
        write_reproduction_report(path, rows, sweeps)
        html = path.read_text(encoding="utf-8")
        references = re.findall(r'(?:src|href)="([^"]*)"', html)
        assert all(reference.startswith("data:image/svg+xml;base64,") for reference in references)
        assert not re.search(r"url\(|@import|https?://", html)
        return html

    return write


def test_without_sweeps_there_are_numbers_only(write):
    """The verdict comes first, then each paper, every text escaped."""
    html = write({"li2018a": ROWS, "chi2017": ROWS[:1]}, {})
    assert re.findall("<h2>(.*?)[,<]", html) == ["Verdict", "Li et al. 2018", "Chi et al. 2017"]
    assert "Every number that is compared has the status that is on record for it." in html
    for paper in ("li2018a", "chi2017"):
        assert all(escape(item.item) in html and escape(item.reason) in html for item in not_compared(paper))
    assert "<b>" not in html
    assert "<img" not in html


def test_another_status_than_on_record_is_the_verdict(write):
    """A regression is told first, and at its row."""
    html = write({"li2018a": [*ROWS, replace(ROWS[0], name="Table 7", status="not reproduced")]}, {})
    assert "Other than on record: Table 7." in html
    assert "not reproduced, recorded as reproduced" in html


def test_figures_are_redrawn(write, wu2025_sweeps):
    """Figures 4 to 9 are there, 6 and 7 in both forms of the scalar noise, and what Fig. 9 means is told."""
    html = write({"wu2025": simulated_rows(wu2025_sweeps)}, wu2025_sweeps)
    assert html.count("<img") == 8
    for figure in (
        "Fig. 4",
        "Fig. 5",
        "Fig. 6",
        "Fig. 7",
        "Fig. 6, otherwise",
        "Fig. 7, otherwise",
        "Fig. 8",
        "Fig. 9",
    ):
        assert f"<figcaption>{figure}:" in html
    assert re.search("k = −[78910.]+ for e_B", html)


def test_curves_are_those_of_the_sweep(wu2025_sweeps):
    """Each kind of parameters has its single curves, three methods and the bound; the bound only where it holds."""
    with_bound, without = (plot_relative_errors(wu2025_sweeps["vector"], choice) for choice in (True, False))
    assert [len(axes.lines) for axes in with_bound.axes] == [12 + 4, 12 + 4, 12 + 4, 9 + 4]
    assert [len(axes.lines) for axes in without.axes] == [12 + 3, 12 + 3, 12 + 3, 9 + 3]


def test_the_corrected_step_1_is_drawn_where_it_differs(wu2025_sweeps):
    """In and out of sample and the floor: of two methods where both forms of step 1 agree, else of three."""
    for name, lines in (("samples", 5), ("scalar per sample", 7)):
        _, after, _, tensor = plot_residuals(wu2025_sweeps[name]).axes
        assert len(after.lines) == len(tensor.lines) == lines
