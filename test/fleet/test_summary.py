"""The drift is drawn for each sensor, what was held fixed is not; no name in the table is a formula."""

import csv
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tam_calibration.fleet.summary import SUMMARIES, Missions, plot_missions, write_summaries
from tam_calibration.fleet.task import Result
from tam_calibration.model.units import ERROR_KINDS
from tam_calibration.report.page import embed


def missions(count):
    """Return missions of four sensors whose misalignment of sensor 1 is fixed."""
    rng = np.random.default_rng(3)
    values = {group: rng.normal(size=(count, 4, 3)) for group in ERROR_KINDS}
    errors = {group: np.ones((count, 4, 3)) for group in ERROR_KINDS}
    errors[ERROR_KINDS[3]][:, 0] = 0
    return Missions("auv", 1.7e9 + 86400.0 * np.arange(count), 3600.0, values, errors)


def test_each_sensor_has_a_panel_with_three_parameters():
    """Less their means; the fixed ones of sensor 1 are left out."""
    figure = plot_missions(missions(5), ERROR_KINDS[3])
    drawn = [len(axes.containers) for axes in figure.axes]
    assert drawn == [0, 3, 3, 3]
    for axes in figure.axes[1:]:
        for bars in axes.containers:
            assert abs(np.mean(bars.lines[0].get_ydata())) < 1e-12


def test_a_figure_is_the_same_bytes_every_time():
    """So that a batch that is resumed gives the same page; one mission is drawn too."""
    assert embed(plot_missions(missions(1), ERROR_KINDS[2]), "bias").source
    first, second = (embed(plot_missions(missions(4), ERROR_KINDS[2]), "bias").source for _ in range(2))
    assert first == second


def table(folder, *results):
    """Write the summaries and return the rows of the table, as lists of texts."""
    folder.mkdir(exist_ok=True)
    write_summaries(folder, results)
    with (folder / "summary.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def named(platform, recording):
    """Return the result of a recording that could not be read."""
    return Result(recording, platform, f"/{platform}/{recording}", "failed", {"read": "it is none"}, "digest")


@pytest.fixture(scope="class")
def pageless():
    """Leave out what is in the page, which is dear, where the table alone is looked at."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tam_calibration.fleet.summary._write_fleet_page", lambda path, results: path.touch())
        yield


@pytest.mark.parametrize("first", ["=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠"])
def test_no_name_is_a_formula(tmp_path, pageless, first):
    """An apostrophe stands before what OWASP lists; a number below zero is none of it."""
    _, row = table(tmp_path, named(f"{first}1+1", f"{first}SUM(A1)"))
    assert row[:2] == [f"'{first}1+1", f"'{first}SUM(A1)"]
    assert row[2:4] == [f"/{first}1+1/{first}SUM(A1)", "failed"]


def test_names_keep_their_cells(tmp_path, pageless):
    """Commas, quotes and ends of lines, and what others than commas take for the end of a cell."""
    names = ['=HYPERLINK("#a,b")', "a;=1+1;b", "two\rrows", "a-1+1.csv"]
    rows = table(tmp_path, *(named("auv", name) for name in names))
    assert [row[1] for row in rows[1:]] == ['\'=HYPERLINK("#a,b")', "a;'=1+1;b", "two\rrows", "a-1+1.csv"]
    assert len(set(map(len, rows))) == 1


@given(name=st.text(st.sampled_from("=+-@\t\r\n;,\"'aＢ＝")))
def test_no_text_begins_a_formula_wherever_a_cell_may_end(tmp_path_factory, pageless, name):
    """And without the apostrophes each is as it was."""
    rows = table(tmp_path_factory.getbasetemp() / "summaries", named("auv", name))
    assert not re.search("(^|[;\t\r\n])[=+@＝-]", rows[1][1])
    assert rows[1][1].replace("'", "") == name.replace("'", "")


def test_summaries_appear_together(tmp_path, monkeypatch):
    """When the page cannot be drawn the older ones stay, all three."""
    table(tmp_path, named("auv", "one"))
    before = {name: (tmp_path / name).read_bytes() for name in SUMMARIES}
    monkeypatch.setattr("tam_calibration.fleet.summary.to_json", lambda content: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        table(tmp_path, named("auv", "two"))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
