"""What the subcommands share: options, progress on stderr, answers in words or JSON, files that appear together."""

import math
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any, Literal

import click
import numpy as np
from click.core import ParameterSource
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table as RichTable
from rich.text import Text as RichText

from tam_calibration.cli.streams import GradedBad, say
from tam_calibration.effects.library import effect_named, installed_effects
from tam_calibration.files.text_files import to_json, write_set
from tam_calibration.integrity.fault import ACCEPTABLE, names_in
from tam_calibration.messages.samples import Progress as ProgressCallback
from tam_calibration.model.exceptions import InputError, Refused, printable
from tam_calibration.model.libraries import require
from tam_calibration.model.units import FloatArray
from tam_calibration.recordings.channel_map import AS_IT_IS, Reading, Window, read_map
from tam_calibration.report.blocks import Block, Points, Table, Text
from tam_calibration.results.overwriting import require_separate

_PIPE_WIDTH = 120

_NUMBER = re.compile(r"([−–∞\d].*)?")
"""A cell of a column that is aligned right: a number, a dash or nothing."""


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


def path_option(name: str, help_text: str, required: bool = False) -> Callable[..., Any]:
    """Return an option that takes a path, which the command gets as ``NAME_path``."""
    parameter = f"{name.removeprefix('--').replace('-', '_')}_path"
    return click.option(name, parameter, type=PATH, required=required, help=help_text)


array_option = path_option("--array", "Array YAML: positions and noise of the sensors.", required=True)


def completed(names: Callable[[], Iterable[str]]) -> Callable[[click.Context, click.Parameter, str], list[str]]:
    """Return how a shell completes an option that takes names, or several that commas separate.

    Parameters
    ----------
    names : callable
        Returns the names; called when a shell asks.
    """

    def complete(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        return [f"{before}{comma}{name}" for name in names() if name.startswith(last)]

    return complete


def _effects_in(_: click.Context, __: click.Parameter, text: str | None) -> tuple[str, ...]:
    names = () if text is None else tuple(names_in(text))
    if not names and text is not None:
        raise InputError("--effects names none: give names such as temperature_drift, or auto")
    for name in set(names) - {"auto"}:
        effect_named(name)
    return names


effects_option = click.option(
    "--effects",
    callback=_effects_in,
    shell_complete=completed(lambda: ("auto", *installed_effects())),
    help="Also fit effects and keep them in the calibration: names such as temperature_drift,current_interference, or "
    "auto for those that tam diagnose finds.",
)


accept_option = click.option(
    "--accept",
    multiple=True,
    metavar="NAME",
    shell_complete=completed(lambda: ACCEPTABLE),
    help=f"Overrule a finding; may be repeated: {', '.join(ACCEPTABLE)}.",
)


JOBS = click.IntRange(1, 256)
"""Processes at once: more than any machine has cores for."""


class Number(click.FloatRange):
    """A finite number within a range."""

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
            When it is not a finite number, or out of range.
        """
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


class NumberOrEstimate(Number):
    """A finite number within a range, or ``estimate``, which is infinity: nothing is known of it."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number, as of ``Number``, or infinity."""
        return math.inf if value == "estimate" else super().convert(value, param, ctx)


def numbers_in(option: str, form: str, words: str, counts: tuple[int, ...]) -> FloatArray:
    """Return the numbers of an option, which commas separate.

    Parameters
    ----------
    option, form : str
        Name of the option, and what it should be, for the error.
    words : str
        What the user typed.
    counts : tuple of int
        How many numbers there may be.

    Raises
    ------
    InputError
        When these are no finite numbers, or not so many.
    """
    try:
        values = np.array([float(word) for word in words.split(",")])
    except ValueError:
        values = np.zeros(0)
    if len(values) not in counts or not np.isfinite(values).all():
        raise InputError(f"{option} must be {form}, not {words!r}")
    return values


MAP_HELP = "Map YAML: which topics or columns are sensors and channels (`tam inspect --write-map` writes one)."

_READING_OPTIONS = (
    path_option("--map", MAP_HELP),
    click.option("--from", "start", metavar="TIME", help="Start reading here: seconds from the start, or ISO 8601."),
    click.option("--until", metavar="TIME", help="Stop reading here: seconds from the start, or ISO 8601."),
    click.option("--unwrap", is_flag=True, help="Continue sensor counters that overflow."),
    path_option("--base-station", "IAGA-2002 file with the intensity, if the recording has none."),
    click.option(
        "--tolerance-s",
        type=Number(0, 60),
        default=AS_IT_IS.tolerance_s,
        show_default=True,
        help="Largest difference of stamps within a sample, in s; beyond it, readings are interpolated.",
    ),
)


def reading_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of how a recording is read to a command, which gets them as one argument ``how``.

    Parameters
    ----------
    function : callable
        The command's function.
    """

    @wraps(function)
    def with_reading(
        *,
        map_path: Path | None,
        start: str | None,
        until: str | None,
        unwrap: bool,
        base_station_path: Path | None,
        tolerance_s: float,
        **extra: Any,
    ) -> Any:
        window = Window.of(start, until)
        channel_map = None if map_path is None else read_map(map_path)
        files = tuple(path for path in (map_path, base_station_path) if path is not None)
        how = Reading(channel_map, window, unwrap, base_station_path, tolerance_s, files)
        return function(how=how, **extra)

    command: Callable[..., Any] = with_reading
    for option in reversed(_READING_OPTIONS):
        command = option(command)
    return command


def next_command(*words: object, is_of_part: bool = False) -> str:
    """Return a command for a shell that reads a recording as the running command was asked to.

    Parameters
    ----------
    *words : object
        What is typed after `tam`.
    is_of_part : bool
        Whether it reads the same part of the recording.
    """
    context = click.get_current_context()
    kept = {"--map", "--unwrap", "--base-station", "--tolerance-s", *(("--from", "--until") if is_of_part else ())}
    given = list[object]()
    for option in context.command.params:
        name, value = option.opts[0], context.params.get(option.name or "")
        if name in kept and context.get_parameter_source(option.name or "") is ParameterSource.COMMANDLINE:
            given += [name] if value is True else [name, value]
    return shlex.join(map(str, ("tam", *words, *given)))


FEW = 5
"""Points, laws or samples of a kind that a summary names."""

MOST_LINES = 20
"""Lines of an answer that is not asked for in full: they fit a terminal with the command."""

Detail = Literal["tables", "answer"] | None
"""How much of an answer is printed: all tables, its first line alone, or a summary."""


def answer_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of how much is printed to a command, which gets them as one argument ``detail``."""
    quiet = click.option("-q", "--quiet", "detail", flag_value="answer", help="Print the first line only.")
    verbose = click.option("-v", "--verbose", "detail", flag_value="tables", default=None, help="Print all tables.")
    command: Callable[..., Any] = verbose(quiet(function))
    return command


def print_answer(
    answer: str,
    summary: Iterable[Block],
    tables: Iterable[Block] | None,
    detail: Detail,
    written: Iterable[Path | None] = (),
    advice: str = "",
) -> None:
    """Print an answer: one line, then a summary of at most ``MOST_LINES`` lines in all, or all tables.

    Parameters
    ----------
    answer : str
        The first line.
    summary, tables : iterable of Block
        What is printed behind it: by default, and where all is asked for; None where the summary is all there is.
    detail : Detail
        How much to print.
    written : iterable of Path or None
        Files that were written, which are named behind it.
    advice : str
        What to do next, the last line.
    """
    console = stdout()
    console.print(answer, style="bold", soft_wrap=True)
    if detail == "answer":
        return
    paths = list(filter(None, written))
    if tables is None:
        print_blocks(summary)
    elif detail == "tables":
        print_blocks(tables, MOST_ROWS)
    else:
        with console.capture() as captured:
            print_blocks(summary, console=console)
        lines = captured.get().splitlines()
        most = MOST_LINES - 1 - len(paths) - bool(advice)
        shown = lines if len(lines) <= most else [*lines[: most - 1], "… --verbose prints all."]
        for line in shown:
            say(line)
    say_written(paths)
    if advice:
        say(f"next: {advice}")


@contextmanager
def graded(
    as_json: bool, further: Callable[[str], dict[str, object]] = lambda reason: {}, output: Path | None = None
) -> Iterator[None]:
    """Answer a refusal by the grade "bad" with its reason: in words, or as JSON, which may hold further keys.

    The reason tells of an output that exists that it is still the earlier one.
    """
    try:
        yield
    except Refused as problem:
        earlier = f"; nothing written: {output} is still the earlier one" if output and output.exists() else ""
        raise GradedBad(f"{problem}{earlier}", as_json, further(str(problem))) from problem


class _Console(Console):
    """A console that escapes unprintable characters of what it prints."""

    def render_str(self, text: str, **options: Any) -> RichText:
        return super().render_str(printable(text, keep="\n\t"), **options)


def stdout() -> Console:
    """Return the console for results; wide enough for tables where it is a file or a pipe."""
    return _Console(width=None if sys.stdout.isatty() else _PIPE_WIDTH, highlight=False, markup=False)


MOST_ROWS = 30
"""Rows of a table that are printed: parameters of an effect may be many more."""


def print_blocks(blocks: Iterable[Block], most: int = sys.maxsize, console: Console | None = None) -> None:
    """Print the paragraphs, points and tables of a page; important parts are bold.

    Parameters
    ----------
    blocks : iterable of Block
        No pictures.
    most : int, optional
        Rows of a table that are printed.
    console : Console, optional
        Where to print; standard output by default.
    """
    console = console or stdout()
    for block in blocks:
        if isinstance(block, Text):
            console.print(block.text, style="bold" if block.emphasis else None, soft_wrap=True)
        elif isinstance(block, Points):
            for point in block.points:
                console.print(f"  {point}", soft_wrap=True)
        elif isinstance(block, Table):
            if block.caption:
                console.print(f"{block.caption.rstrip('.')}:", soft_wrap=True)
            console.print(_in_columns(block, most))
            if len(block.rows) > most:
                console.print(f"… and {len(block.rows) - most} more: --json and --report have all.")


def _in_columns(table: Table, most: int) -> RichTable:
    shown = RichTable(table.header[0])
    for column, name in enumerate(table.header[1:], start=1):
        is_numeric = all(_NUMBER.fullmatch(row[column]) for row in table.rows)
        shown.add_column(name, justify="right" if is_numeric else "left")
    for row in table.rows[:most]:
        shown.add_row(*row)
    return shown


def say_written(paths: Iterable[Path | None]) -> None:
    """Name the files that were written; None is one that was not wanted."""
    for path in filter(None, paths):
        say(f"written: {path}")


@contextmanager
def showing_progress() -> Iterator[Progress]:
    """Show tasks on stderr while they run, where that is a terminal."""
    console = Console(stderr=True)
    console.quiet = not console.is_terminal  # Rich 13.7 ends a display that is disabled with an empty line
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
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
        What is being done, shown with the bar.
    """
    task = progress.add_task(printable(description), total=None)
    return lambda done, total: progress.update(task, completed=done, total=total)


def progress_of(progress: Progress, description: str) -> Callable[[str, float], None]:
    """Return a callback that shows the stage of long work, and how much of it is done.

    Parameters
    ----------
    progress : Progress
        Display to which the task is added.
    description : str
        Shown until the first stage is known.
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


STDOUT = Path("-")
"""Path that ``--json`` has where it prints the JSON instead of the words."""

json_option = click.option(
    "--json",
    "json_path",
    metavar="[PATH]",
    type=PATH,
    is_flag=False,
    flag_value=str(STDOUT),
    help="Write the answer as JSON; without PATH, print it instead of the words.",
)


class Answer:
    """The answer of a command, in the form that ``--json``, ``-v`` and ``-q`` ask for.

    Parameters
    ----------
    json_path : Path or None
        Where the JSON goes: a file, or ``-`` for standard output instead of words; None for words alone.
    detail : Detail
        How many words.
    """

    def __init__(self, json_path: Path | None, detail: Detail) -> None:
        self.is_json = json_path == STDOUT
        self._json_path = None if self.is_json else json_path
        self._detail = detail
        self._print: Callable[[list[Path]], None] = lambda written: None
        self._json = ""

    @contextmanager
    def files(self, inputs: Sequence[Path | None], **outputs: Path | None) -> Iterator[dict[str, Path]]:
        """Give a place to write each output to; print the answer when all of them are where they belong.

        Parameters
        ----------
        inputs : sequence of Path or None
            Files that are read, which no output may replace.
        **outputs : Path or None
            Files that are written, by name; None is one that was not wanted.
        """
        wanted = outputs | {"json": self._json_path}
        with write_together(wanted, [path for path in inputs if path is not None]) as places:
            yield places
            if "json" in places:
                places["json"].write_text(self._json, encoding="utf-8")
        self._print([path for name, path in wanted.items() if path is not None and name in places])

    def give(
        self,
        content: Any,
        first: str,
        summary: Iterable[Block] = (),
        tables: Iterable[Block] | None = None,
        advice: str = "",
    ) -> None:
        """Give the answer: it is printed once `files` ends.

        Parameters
        ----------
        content : Any
            What the JSON contains.
        first : str
            The first line of the words.
        summary, tables : iterable of Block
            What follows it: by default, and with ``--verbose``; with no tables, the complete summary in both.
        advice : str
            The command that uses the answer.
        """
        self._json = to_json(content)
        if self.is_json:
            self._print = lambda written: say(self._json)
        else:
            self._print = lambda written: print_answer(first, summary, tables, self._detail, written, advice)


def answering(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--json``, ``--verbose`` and ``--quiet`` to a command, which gets them as one argument ``answer``.

    Parameters
    ----------
    function : callable
        The command's function.
    """

    @wraps(function)
    def with_answer(*, json_path: Path | None, detail: Detail, **extra: Any) -> Any:
        if json_path is not None and json_path.suffix != ".json" and json_path.is_file():
            raise InputError(f"{json_path} would be overwritten: put --json last, or name a .json file")
        return function(answer=Answer(json_path, detail), **extra)

    command: Callable[..., Any] = json_option(answer_options(with_answer))
    return command
