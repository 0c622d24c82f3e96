"""How commands answer: in words, or as JSON; and the files that appear with the answer."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

import click

from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import PATH, Detail, answer_options, print_answer, write_together
from tam_calibration.files.text_files import to_json
from tam_calibration.model.exceptions import InputError
from tam_calibration.report.blocks import Block

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
