"""`tam reproduce`: the papers' simulations run again, number by number."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.progress import Progress

from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import PATH, say_written, showing_progress, stdout, write_together
from tam_calibration.model.exceptions import Refused
from tam_validation.papers import PAPERS

if TYPE_CHECKING:
    from tam_validation.papers.row import PaperNumber
    from tam_validation.papers.sweep import Sweep

RESULTS = Path("benchmarks/results")
_SWEPT = "wu2025"
"""The paper whose figures are sweeps."""


@click.command()
@click.argument("paper", type=click.Choice([*PAPERS, "all"]))
@click.option("--runs", type=click.IntRange(2, 10_000), default=50, show_default=True, help="Of each point of wu2025.")
@click.option("--output-dir", type=PATH, help=f"Of the CSV files.  [default: {RESULTS} if there is one, else here]")
def command(paper: str, runs: int, output_dir: Path | None) -> None:
    """Run the simulations of PAPER again and print their numbers beside ours.

    Each is marked as reproduced, not reproduced, or an error of the paper, with its source and the reason. What of the
    paper is compared with nothing is listed, with why. Exits 1 where a status is another than the one on record. Writes
    reproduce_PAPER.csv, and for wu2025 the curves of its figures as reproduce_wu2025_figures.csv.
    """
    from tam_validation.papers.printed import not_compared
    from tam_validation.papers.tables import (
        print_not_compared,
        print_rows,
        rows_to_csv,
        summary,
        sweeps_to_csv,
    )

    papers = list(PAPERS) if paper == "all" else [paper]
    folder = output_dir or (RESULTS if RESULTS.is_dir() else Path())
    outputs = {name: folder / f"reproduce_{name}.csv" for name in papers}
    if _SWEPT in papers:
        outputs["figures"] = folder / f"reproduce_{_SWEPT}_figures.csv"
    with write_together(outputs, []) as beside:
        rows, sweeps = _reproduce(papers, runs)
        for name in papers:
            beside[name].write_text(rows_to_csv(rows[name], _command(name, runs)), encoding="utf-8")
        if "figures" in beside:
            beside["figures"].write_text(sweeps_to_csv(sweeps, _command(_SWEPT, runs)), encoding="utf-8")
    for name in papers:
        print_rows(stdout(), PAPERS[name], rows[name])
        print_not_compared(stdout(), PAPERS[name], not_compared(name))
    say_written(outputs.values())
    for name in papers:
        say(summary(name, rows[name]))
    _require_record([row for name in papers for row in rows[name]])


def _reproduce(papers: list[str], runs: int) -> tuple[dict[str, list["PaperNumber"]], dict[str, "Sweep"]]:
    rows: dict[str, list[PaperNumber]] = {}
    sweeps: dict[str, Sweep] = {}
    with showing_progress() as progress:
        for name in papers:
            if name == _SWEPT:
                rows[name], sweeps = _sweep(runs, progress)
            else:
                progress.add_task(name, total=None)
                rows[name] = import_module(f"tam_validation.papers.{name}").results()
    return rows, sweeps


def _sweep(runs: int, progress: Progress) -> tuple[list["PaperNumber"], dict[str, "Sweep"]]:
    from tam_calibration.results.scenario import read_scenario
    from tam_validation.papers import wu2025

    task = progress.add_task(_SWEPT, total=None)

    def show(done: int, total: int) -> None:
        progress.update(task, completed=done, total=total, description=f"{_SWEPT}: {done} of {total} runs")

    return wu2025.results(read_scenario("wu_table_1"), read_scenario("wu_turntable"), runs, show)


def _command(paper: str, runs: int) -> str:
    return f"tam reproduce {paper} --runs {runs}" if paper == _SWEPT else f"tam reproduce {paper}"


def _require_record(rows: list["PaperNumber"]) -> None:
    other = [row.name for row in rows if not row.is_as_recorded]
    if other:
        numbers = "1 number" if len(other) == 1 else f"{len(other)} numbers"
        raise Refused(f"{numbers} came out with another status than is on record: {'; '.join(other)}")
