"""The command `tam reproduce`."""

import csv
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from tam_calibration.cli.main import main
from tam_validation.papers import li2018a, wu2025


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Return a function that runs `tam reproduce` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *words: CliRunner().invoke(main, ["reproduce", *words])


def read(path):
    """Return the first line of a CSV file and its rows."""
    first, *lines = Path(path).read_text(encoding="utf-8").splitlines()
    return first, list(csv.DictReader(lines))


@pytest.mark.parametrize(
    ("paper", "words"),
    [
        ("li2018a", "li2018a: 103 numbers, 94 reproduced, 6 not reproduced, 3 paper in error"),
        ("li2018b", "li2018b: 95 numbers, 44 reproduced, 4 not reproduced, 47 paper in error"),
        ("chi2017", "chi2017: 101 numbers, 82 reproduced, 15 not reproduced, 4 paper in error"),
    ],
)
def test_numbers_are_printed_counted_and_written(run, paper, words):
    """Every number stands in the table and in the file, which names its command; all are as recorded."""
    result = run(paper)
    assert result.exit_code == 0, result.stderr
    assert result.stdout.splitlines()[-1] == words
    assert [path.name for path in Path().iterdir()] == [f"reproduce_{paper}.csv"]
    first, rows = read(f"reproduce_{paper}.csv")
    assert first == f"# tam reproduce {paper}"
    assert len(rows) == int(words.split()[1])
    assert all(row["status"] == row["recorded"] for row in rows)
    assert all(row["reason"] for row in rows if row["status"] != "reproduced")


def test_reasons_stand_under_the_table(run):
    """A number that the paper has wrong is marked, with why."""
    out = " ".join(run("li2018a").stdout.split())
    assert "paper in error" in out
    assert "the artificial vector lies along the orthogonal frame of the mean reading" in out


def test_what_is_compared_with_nothing_is_listed(run):
    """The measured tables stand under the rows, with why."""
    out = run("chi2017").stdout
    assert "not compared" in out and "Fig. 8, tensor components in the experiment" in " ".join(out.split())


def test_results_go_where_the_repository_keeps_them(run):
    """benchmarks/results is the default where it is, another folder on demand."""
    Path("benchmarks/results").mkdir(parents=True)
    Path("other").mkdir()
    assert "written: benchmarks/results/reproduce_li2018a.csv" in run("li2018a").stdout
    assert "written: other/reproduce_li2018a.csv" in run("li2018a", "--output-dir", "other").stdout


def test_another_status_than_on_record_exits_1(run, monkeypatch):
    """A regression shows, and what came out is written all the same."""
    rows = li2018a.results()
    worse = [replace(rows[0], status="not reproduced"), *rows[1:]]
    monkeypatch.setattr(li2018a, "results", lambda: worse)
    result = run("li2018a")
    assert result.exit_code == 1
    assert result.stderr == (
        "tam: 1 number came out with another status than is on record: Table 1, TMI, before, sensor 1\n"
    )
    assert Path("reproduce_li2018a.csv").exists()


def test_a_folder_that_is_not_there_exits_2(run):
    """One sentence, before anything is simulated."""
    result = run("wu2025", "--output-dir", "nowhere")
    assert result.exit_code == 2
    assert result.stderr.startswith("tam: nowhere/reproduce_wu2025.csv cannot be written")
    assert list(Path().iterdir()) == []


def test_all_papers_with_the_curves_of_figures(run, monkeypatch, wu2025_sweeps):
    """One command writes every number and the curves of Wu's figures; the runs are passed on."""
    asked = []

    def results(table_1, turntable, runs, progress):
        asked.append(runs)
        progress(1, 1)
        return wu2025.simulated_rows(wu2025_sweeps), wu2025_sweeps

    monkeypatch.setattr(wu2025, "results", results)
    result = run("all", "--runs", "2")
    assert result.exit_code == 0, result.stderr
    assert asked == [2]
    assert [line.split(":")[0] for line in result.stdout.splitlines()[-4:]] == [
        "wu2025",
        "li2018a",
        "li2018b",
        "chi2017",
    ]
    first, rows = read("reproduce_wu2025_figures.csv")
    assert first == "# tam reproduce wu2025 --runs 2"
    assert len(rows) == 6 * (4 * 7 + 2)
    floor = [row for row in rows if row["source"] == "noise floor" and row["setting"] == "N"]
    assert float(floor[-1]["e_T_nT_per_m held out"]) == pytest.approx(5.99, rel=0.02)
