"""`tam reproduce`: the papers' simulations run again, number by number."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.progress import Progress

from tam_calibration.cli.terminal import PATH, showing_progress, stdout, write_together
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.validation.papers import PAPERS

if TYPE_CHECKING:
    from tam_calibration.validation.papers.row import PaperNumber
    from tam_calibration.validation.papers.sweep import Sweep

RESULTS = Path("benchmarks/results")
_SWEPT = "wu2025"
"""The paper whose figures are sweeps."""
_COIL = "coil"
"""Its localisation of a coil, with which errors it takes to reach the printed figures."""


@click.command()
@click.argument("paper", type=click.Choice([*PAPERS, "all"]))
@click.option("--experiment", type=click.Choice([_COIL]), help="This experiment of wu2025 only.")
@click.option("--runs", type=click.IntRange(2, 10_000), default=50, show_default=True, help="Of each point of wu2025.")
@click.option("--report", type=PATH, help="Write an HTML page with what is compared, and figures redrawn.")
@click.option("--output-dir", type=PATH, help=f"Of the CSV files.  [default: {RESULTS} if there is one, else here]")
def command(paper: str, experiment: str | None, runs: int, report: Path | None, output_dir: Path | None) -> None:
    """Run the simulations of PAPER again and print their numbers beside ours.

    Each is marked as reproduced, not reproduced, or an error of the paper, with its source and the reason. What of the
    paper is compared with nothing is listed, with why. Exits 1 where a status is another than the one on record. Writes
    reproduce_PAPER.csv, and for wu2025 the curves of its figures as reproduce_wu2025_figures.csv, or for its experiment
    with the coil reproduce_wu2025_coil.csv and reproduce_wu2025_coil_sweeps.csv.
    """
    if experiment is not None:
        _reproduce_coil(paper, report, _folder(output_dir))
        return
    from tam_calibration.validation.papers.not_compared import not_compared
    from tam_calibration.validation.papers.tables import (
        print_not_compared,
        print_rows,
        rows_to_csv,
        summary,
        sweeps_to_csv,
    )

    papers = list(PAPERS) if paper == "all" else [paper]
    folder = _folder(output_dir)
    files = {name: folder / f"reproduce_{name}.csv" for name in papers}
    outputs: dict[str, Path | None] = {**files, "report": report}
    if _SWEPT in papers:
        outputs["figures"] = folder / f"reproduce_{_SWEPT}_figures.csv"
    with write_together(outputs, []) as beside:
        rows, sweeps = _reproduce(papers, runs)
        for name in papers:
            beside[name].write_text(rows_to_csv(rows[name], _command(name, runs)), encoding="utf-8")
        if "figures" in beside:
            beside["figures"].write_text(sweeps_to_csv(sweeps, _command(_SWEPT, runs)), encoding="utf-8")
        if "report" in beside:
            from tam_calibration.validation.papers.cross_figures import redraw
            from tam_calibration.validation.papers.report import write_reproduction_report

            write_reproduction_report(beside["report"], rows, sweeps, figures={name: redraw(name) for name in papers})
    for name in papers:
        print_rows(stdout(), PAPERS[name], rows[name])
        print_not_compared(stdout(), PAPERS[name], not_compared(name))
    for path in filter(None, outputs.values()):
        click.echo(f"written: {path}")
    for name in papers:
        click.echo(summary(name, rows[name]))
    _require_record([row for name in papers for row in rows[name]])


def _reproduce_coil(paper: str, report: Path | None, folder: Path) -> None:
    from tam_calibration.files.scenario import read_scenario
    from tam_calibration.validation.papers import wu2025_coil
    from tam_calibration.validation.papers.tables import coil_sweeps_to_csv, print_rows, rows_to_csv, summary
    from tam_calibration.validation.papers.wu2025_coil_sweeps import sweeps

    if paper != _SWEPT:
        raise InputError(f"the experiment {_COIL!r} is one of {_SWEPT}, not of {paper}")
    call = f"tam reproduce {_SWEPT} --experiment {_COIL}"
    outputs: dict[str, Path | None] = {
        "rows": folder / f"reproduce_{_SWEPT}_{_COIL}.csv",
        "sweeps": folder / f"reproduce_{_SWEPT}_{_COIL}_sweeps.csv",
        "report": report,
    }
    with write_together(outputs, []) as beside:
        with showing_progress() as progress:
            progress.add_task(
                "coil: before and after calibration, then each error that the model leaves out", total=None
            )
            array_and_coil = wu2025_coil.Experiment.of(read_scenario("wu_turntable"))
            rows, grown = wu2025_coil.rows(array_and_coil), sweeps(array_and_coil)
        beside["rows"].write_text(rows_to_csv(rows, call), encoding="utf-8")
        beside["sweeps"].write_text(coil_sweeps_to_csv(grown, call), encoding="utf-8")
        if "report" in beside:
            from tam_calibration.validation.papers.report import write_reproduction_report

            write_reproduction_report(beside["report"], {_SWEPT: rows}, {}, grown)
    print_rows(stdout(), PAPERS[_SWEPT], rows)
    for path in filter(None, outputs.values()):
        click.echo(f"written: {path}")
    for sweep in grown:
        found = f"{sweep.needed:.3g} {sweep.unit}" if sweep.needed == sweep.needed else "not by it alone"
        click.echo(f"printed distance after calibration reached by {sweep.name}: {found}")
    click.echo(summary(_SWEPT, rows))
    _require_record(rows)


def _folder(output_dir: Path | None) -> Path:
    return output_dir or (RESULTS if RESULTS.is_dir() else Path())


def _reproduce(papers: list[str], runs: int) -> tuple[dict[str, list["PaperNumber"]], dict[str, "Sweep"]]:
    rows: dict[str, list[PaperNumber]] = {}
    sweeps: dict[str, Sweep] = {}
    with showing_progress() as progress:
        for name in papers:
            if name == _SWEPT:
                rows[name], sweeps = _sweep(runs, progress)
            else:
                progress.add_task(name, total=None)
                rows[name] = import_module(f"tam_calibration.validation.papers.{name}").results()
    return rows, sweeps


def _sweep(runs: int, progress: Progress) -> tuple[list["PaperNumber"], dict[str, "Sweep"]]:
    from tam_calibration.files.scenario import read_scenario
    from tam_calibration.validation.papers import wu2025

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
