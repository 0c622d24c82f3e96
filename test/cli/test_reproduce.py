"""The command `tam reproduce`."""

import csv
from pathlib import Path

import pytest
from click.testing import CliRunner

from tam_calibration.cli.main import main
from tam_validation.papers import wu2025_sweeps


@pytest.fixture
def run_in_processes(tmp_path, monkeypatch):
    """Return a function that runs `tam reproduce` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *words: CliRunner().invoke(main, ["reproduce", *words])


@pytest.fixture
def run(run_in_processes, monkeypatch):
    """Return that function, which simulates in this process: settings may be changed, and no other is started."""
    monkeypatch.setattr("tam_validation.papers.seeds.processes", in_this_process)
    return run_in_processes


def read(path):
    """Return the first line of a CSV file and its rows."""
    first, *lines = Path(path).read_text(encoding="utf-8").splitlines()
    return first, list(csv.DictReader(lines))


def test_numbers_are_printed_counted_and_written(run_in_processes):
    """Every number is in the table and in the file, which names its command; forty seeds are the default."""
    result = run_in_processes("li2018b")
    assert result.exit_code == 0, result.stderr
    assert result.stdout.splitlines()[-1] == (
        "li2018b: 167 numbers, 111 reproduced, 45 not reproduced, 11 paper in error"
    )
    assert [path.name for path in Path().iterdir()] == ["reproduce_li2018b.csv"]
    first, rows = read("reproduce_li2018b.csv")
    assert first == "# tam reproduce li2018b --seeds 40"
    assert len(rows) == 167
    for row in rows:
        within = float(row["low"]) <= float(row["paper"]) <= float(row["high"])
        assert within == (row["status"] == "reproduced")


def test_seeds_make_the_range(run):
    """With more seeds the range is another, and two make the least."""
    assert run("li2018b", "--seeds", "2").exit_code == 0
    _, two = read("reproduce_li2018b.csv")
    assert run("li2018b", "--seeds", "4").exit_code == 0
    _, four = read("reproduce_li2018b.csv")
    assert all(float(more["low"]) <= float(less["low"]) for less, more in zip(two, four, strict=True))
    assert run("li2018b", "--seeds", "1").exit_code == 2


def test_as_published_follows_the_text_to_the_letter(run):
    """Its results are other files, and numbers that a mended step gives are lost."""
    result = run("li2018b", "--as-published", "--seeds", "2")
    assert result.exit_code == 0, result.stderr
    first, rows = read("reproduce_li2018b_as_published.csv")
    assert first == "# tam reproduce li2018b --seeds 2 --as-published"
    assert {row["ours"] for row in rows if row["number"].startswith("Table 1, φ")} == {"nan"}
    assert "--as-published" in run("--help").stdout


def test_notes_and_what_is_not_compared_are_listed(run):
    """Both are under the table, with the reason."""
    out = " ".join(run("li2018a", "--seeds", "2").stdout.split())
    assert "the artificial vector lies along the orthogonal frame of the mean reading" in out
    assert "not compared" in out and "Table 6, error parameters of the experiment" in out


def test_results_go_where_the_repository_keeps_them(run):
    """benchmarks/results is the default where it is, another folder on demand."""
    Path("benchmarks/results").mkdir(parents=True)
    Path("other").mkdir()
    words = ["li2018a", "--seeds", "2"]
    assert "written: benchmarks/results/reproduce_li2018a.csv" in run(*words).stdout
    assert "written: other/reproduce_li2018a.csv" in run(*words, "-o", "other").stdout


def test_a_folder_that_is_not_there_exits_2(run):
    """One sentence, before anything is simulated."""
    result = run("wu2025", "--output-dir", "nowhere")
    assert result.exit_code == 2
    assert result.stderr.startswith("tam: nowhere/reproduce_wu2025.csv cannot be written")
    assert list(Path().iterdir()) == []


def test_all_papers_with_the_curves_of_figures(run, monkeypatch):
    """One command writes every number and the curves of Wu's figures."""
    monkeypatch.setattr(wu2025_sweeps, "RUNS", 2)
    result = run("all", "--seeds", "2")
    assert result.exit_code == 0, result.stderr
    assert [line.split(":")[0] for line in result.stdout.splitlines()[-4:]] == [
        "wu2025",
        "li2018a",
        "li2018b",
        "chi2017",
    ]
    first, rows = read("reproduce_wu2025_figures.csv")
    assert first == "# tam reproduce wu2025 --seeds 2"
    assert len(rows) == 4 * 7 + 2 + 3
    assert float(rows[27]["e_T_nT_per_m after"]) == pytest.approx(5.99, rel=0.02)


def in_this_process(jobs, context):
    """Return a pool that works here, where settings are changed."""
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(1)
