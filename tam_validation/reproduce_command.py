"""`tam reproduce`: the papers' simulations run again with many seeds, number by number."""

from functools import partial
from pathlib import Path

import click
from rich.progress import Progress, TaskID

from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import PATH, say_written, showing_progress, stdout, write_together
from tam_validation.papers import PAPERS

RESULTS = Path("benchmarks/results")
_SWEPT = "wu2025"
"""The paper whose figures are sweeps."""


@click.command()
@click.argument("paper", type=click.Choice([*PAPERS, "all"]))
@click.option("--seeds", type=click.IntRange(2, 1000), default=40, show_default=True, help="Simulations of each paper.")
@click.option(
    "--as-published",
    is_flag=True,
    help="Follow the text to the letter, also where it cannot give the printed numbers: a constant intensity in Wu's "
    "step 1, Li 2018a's artificial vector as reference, Li 2018b's ten samples of one turn, Chi's sign of ψ.",
)
@click.option("-o", "--output", type=PATH, help=f"CSV folder.  [default: {RESULTS} if there is one, else here]")
def command(paper: str, seeds: int, as_published: bool, output: Path | None) -> None:
    """Run the simulations of PAPER again and compare its numbers with ours.

    A number is reproduced if it lies within the 95 % range of the seeds: of 40 from the smallest to the largest. A
    paper is in error where only another number does that theory gives, or that follows from what it prints elsewhere.
    Tables and figures that have no number of ours are listed with the reason. Writes reproduce_PAPER.csv, and for
    wu2025 the curves of its figures as reproduce_wu2025_figures.csv; with --as-published the names end in
    _as_published.
    """
    from tam_validation.papers.printed import not_compared
    from tam_validation.papers.row import rows_of
    from tam_validation.papers.seeds import simulate
    from tam_validation.papers.tables import print_not_compared, print_rows, rows_to_csv, summary, sweeps_to_csv

    papers = list(PAPERS) if paper == "all" else [paper]
    folder = output or (RESULTS if RESULTS.is_dir() else Path())
    end, flag = ("_as_published", " --as-published") if as_published else ("", "")
    outputs = {name: folder / f"reproduce_{name}{end}.csv" for name in papers}
    if _SWEPT in papers:
        outputs["figures"] = folder / f"reproduce_{_SWEPT}_figures{end}.csv"
    words = {name: f"tam reproduce {name} --seeds {seeds}{flag}" for name in papers}
    with write_together(outputs, []) as beside, showing_progress() as progress:
        rows = {}
        for name in papers:
            show = partial(_show, progress, progress.add_task(name, total=seeds), name, seeds)
            draws = simulate(name, seeds, as_published, show)
            rows[name] = rows_of(name, draws)
            beside[name].write_text(rows_to_csv(rows[name], words[name]), encoding="utf-8")
            if name == _SWEPT:
                beside["figures"].write_text(sweeps_to_csv(draws, words[name]), encoding="utf-8")
    for name in papers:
        print_rows(stdout(), PAPERS[name], rows[name])
        print_not_compared(stdout(), PAPERS[name], not_compared(name))
    say_written(outputs.values())
    for name in papers:
        say(summary(name, rows[name]))


def _show(progress: Progress, task: TaskID, name: str, seeds: int, done: int) -> None:
    progress.update(task, completed=done, description=f"{name}: {done} of {seeds} seeds")
