"""What the subcommands share: progress on stderr, results that appear together or not at all."""

import math
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from tam_calibration.files.overwriting import require_separate
from tam_calibration.files.recording_file import TOLERANCE_S
from tam_calibration.files.whole_files import write_set
from tam_calibration.messages.samples import Progress as ProgressCallback
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.extras import require

_PIPE_WIDTH = 120


class NamedPath(click.Path):
    """A path, which an empty word, unlike click's, is not: it would be the working folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path.

        Raises
        ------
        InputError
            When it is an empty word.
        """
        if value == "":
            raise InputError("an empty word names no file or folder: give its name")
        return super().convert(value, param, ctx)


PATH = NamedPath(path_type=Path, readable=False)
"""A path that is checked where it is used, in one sentence."""


JOBS = click.IntRange(1, 256)
"""Processes at once: more than any machine has cores for."""


class Number(click.FloatRange):
    """A number within a range, which NaN, unlike click's, is not."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number, or fail with a sentence.

        Parameters
        ----------
        value : Any
            What the user typed, or a default.
        param : Parameter or None
            Named in the error.
        ctx : Context or None
            Of the command, for the error.

        Returns
        -------
        float
            Within the range.

        Raises
        ------
        BadParameter
            When it is no number, NaN, or out of range.
        """
        number = float(super().convert(value, param, ctx))
        if math.isnan(number):
            self.fail(f"{value} is not a number.", param, ctx)
        return number


tolerance_option = click.option(
    "--tolerance-s",
    type=Number(0, 60),
    default=TOLERANCE_S,
    show_default=True,
    help="Difference of stamps in a bag up to which readings count as of one moment; beyond, they are interpolated.",
)


def stdout() -> Console:
    """Return the console for results; wide enough for tables where it is a file or a pipe."""
    return Console(width=None if sys.stdout.isatty() else _PIPE_WIDTH, highlight=False, markup=False)


def table_of(header: Sequence[str], rows: Sequence[Sequence[str]], words: Collection[str] = ()) -> Table:
    """Return a table, its first column and those of words left, those of numbers right.

    Parameters
    ----------
    header : sequence of str
        Names of the columns.
    rows : sequence of sequence of str
        Cells.
    words : collection of str
        Names of the columns that hold words.
    """
    table = Table(header[0])
    for name in header[1:]:
        table.add_column(name, justify="left" if name in words else "right")
    for row in rows:
        table.add_row(*row)
    return table


@contextmanager
def showing_progress() -> Iterator[Progress]:
    """Show tasks on stderr while they run, where that is a terminal."""
    console = Console(stderr=True)
    console.quiet = not console.is_terminal  # Rich 13.7 ends a display that is disabled with an empty line
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=console.quiet) as progress:
        yield progress


def reading(progress: Progress) -> ProgressCallback:
    """Return a callback that shows how much of the recording was read."""
    return working(progress, "reading the recording")


def working(progress: Progress, description: str) -> ProgressCallback:
    """Return a callback that shows how many bytes are done.

    Parameters
    ----------
    progress : Progress
        Display to which the task is added.
    description : str
        What is being done, shown beside the bar.
    """
    task = progress.add_task(description, total=None)
    return lambda done, total: progress.update(task, completed=done, total=total)


def progress_of(progress: Progress, description: str) -> Callable[[str, float], None]:
    """Return a callback that shows the stage of long work, and how much of it is done.

    Parameters
    ----------
    progress : Progress
        Display to which the task is added.
    description : str
        Shown until the first stage is told.
    """
    task = progress.add_task(description, total=1.0)
    return lambda stage, done: progress.update(task, description=stage, completed=done)


@contextmanager
def write_together(outputs: Mapping[str, Path | None], inputs: Sequence[Path]) -> Iterator[dict[str, Path]]:
    """Give a place to write each output to; all appear, or none, when that went well, and no input is overwritten.

    Parameters
    ----------
    outputs : mapping
        Path of each output, None where it is not wanted; ``report`` is an HTML page.
    inputs : sequence of Path
        What was read.

    Raises
    ------
    InputError
        When an output cannot be written, would cost an input, a bag or another output, or what makes pages is not
        installed.
    """
    wanted = {name: path for name, path in outputs.items() if path is not None}
    if "report" in wanted:
        require("report", "--report")
    require_separate(wanted.values(), inputs)
    with write_set(wanted.values()) as places:
        yield dict(zip(wanted, places, strict=True))
