"""Standard streams that are closed, full, or of an encoding without our letters: at most a sentence, no traceback."""

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper

import click

from tam_calibration.model.exceptions import Refused, printable

_DIGITS = re.compile(r"(\d{12})\d{24,}(\d{12})")
"""A number of more digits than anybody reads, between those that are shown."""

_LONGEST = 2000
"""Letters of a sentence: a name in it, of a file or a column, may have thousands that tell no one more."""


class GradedBad(Refused):
    """A refusal by a command that grades its answer.

    Parameters
    ----------
    reason : str
        Why.
    as_json : bool
        Whether it is printed as JSON.
    further : dict of str to object, optional
        Content of the JSON in addition to the grade.
    """

    def __init__(self, reason: str, as_json: bool, further: dict[str, object]) -> None:
        super().__init__(reason)
        self._as_json, self._further = as_json, further

    def say(self, reason: str) -> None:
        """Write the grade and a reason to standard output, as the answer."""
        from tam_calibration.correction.parts import quality_for
        from tam_calibration.files.text_files import to_json
        from tam_calibration.results.calibration_yaml import quality_to_mapping

        quality = quality_for("bad", [reason])
        in_words = f"{on_one_line(str(quality))}."
        say(to_json({"quality": quality_to_mapping(quality)} | self._further) if self._as_json else in_words)


@contextmanager
def usable_streams() -> Iterator[None]:
    r"""Run a command with standard streams that it can write to.

    Where standard output is closed or can take nothing, the command does not begin; where it is full in the end, that
    is told. Other streams that are closed are as if led to ``/dev/null``. Letters that an encoding lacks are written by
    their numbers.

    Raises
    ------
    SystemExit
        With code 2, when standard output cannot be written.
    """
    has_output = sys.stdout is not None
    _open_what_is_closed()
    if not has_output:
        tell("standard output is closed: lead it to a file, or to /dev/null")
        sys.exit(2)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        os.write(1, b"")  # a device that is full says so
        yield
        sys.stdout.flush()
    except SystemExit as end:
        try:
            sys.stdout.flush()
        except OSError as problem:
            _end(problem, end.code)
        raise
    except OSError as problem:
        _end(problem)


def say(text: str, err: bool = False) -> None:
    """Write lines to standard output or error, unprintable characters escaped."""
    click.echo(printable(text, keep="\n\t"), err=err)


def tell(sentence: str) -> None:
    """Write a sentence to standard error, where that can be written: one line, whatever the names in it are."""
    with suppress(OSError):
        print(f"tam: {on_one_line(sentence)}", file=sys.stderr, flush=True)


def on_one_line(sentence: str) -> str:
    """Return a sentence without the middle of long numbers, and its own where it is long; printable."""
    sentence = _DIGITS.sub(r"\1…\2", sentence)
    if len(sentence) > _LONGEST:
        half = _LONGEST // 2
        sentence = f"{sentence[:half]} … {sentence[-half:]}"
    return printable(sentence)


def _end(problem: OSError, code: str | int | None = 0) -> None:
    """End the process because of standard output, unless it ends with another code already."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else the interpreter tries it again at its end
    if code:
        sys.exit(code)
    if isinstance(problem, BrokenPipeError):
        sys.exit(1)
    tell(f"standard output cannot be written: {problem.strerror}")
    sys.exit(2)


def _open_what_is_closed() -> None:
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_RDWR)  # the lowest that is free, else a file would get its number
            if descriptor != number:
                os.dup2(descriptor, number)
            setattr(sys, name, open(number, "r" if number == 0 else "w", encoding="utf-8"))  # noqa: SIM115
