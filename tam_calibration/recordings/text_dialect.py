"""Format of a text file, detected from its beginning: delimiter, decimal sign, comments, header, encoding."""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tam_calibration.files.text_files import readable
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.recordings.channel_map import TextFormat
from tam_calibration.recordings.vectors import is_own_column

MISSING = ("", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None", "-", "--", "?")
"""What cells hold that have no value, as loggers, R, pandas and spreadsheets write it."""

LONGEST_LINE = 1 << 16
"""Characters: a line of a hundred sensors has some six thousand."""


_DELIMITERS = ("\t", ";", ",", "|", " ")
"""In the order in which they are preferred where several divide the lines equally; the blank is any white space."""

_COMMENTS = ("#", "%", "//", "!")
"""What lines begin with that are not read, where data lines do not."""


_NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*|\s*[-+]?(inf|infinity)\s*", re.I)


@dataclass(frozen=True)
class Dialect:
    """How a file is written.

    Parameters
    ----------
    delimiter : str
        Between columns; a blank is any white space.
    decimal : str
        Sign within numbers.
    comment : str
        What lines begin with that are not read; empty where there are none.
    encoding : str
        Of the characters.
    names : tuple of str
        Of the columns; numbers from 1 where there is no header.
    has_header : bool
        Whether the names stand in the file.
    first_line : int
        Number, from 1, of the first line of numbers.
    sample : tuple of tuple of str
        Cells of the first lines of numbers.
    """

    delimiter: str
    decimal: str
    comment: str
    encoding: str
    names: tuple[str, ...]
    has_header: bool
    first_line: int
    sample: tuple[tuple[str, ...], ...]

    def is_numeric(self, column: int) -> bool:
        """Whether a column, from 0, contains numbers, or nothing yet."""
        cells = [row[column].strip() for row in self.sample]
        numbers = sum(is_number(cell, self.decimal) or cell in MISSING for cell in cells)
        # A word in a column that is mostly numbers is a fault of the file.
        return numbers >= 0.5 * len(cells) or is_own_column(self.names[column])


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell contains a number."""
    return _NUMBER.fullmatch(cell.replace(decimal, ".") if decimal != "." else cell) is not None


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line, without the quotes around them (RFC 4180)."""
    is_blank = delimiter == " "
    if is_blank and '"' not in line:
        return line.split()
    lines = [line.strip() if is_blank else line]
    try:
        return next(csv.reader(lines, delimiter=delimiter, skipinitialspace=is_blank), [])
    except csv.Error:  # a cell of more than 131 072 characters
        return [line]


def detect_dialect(path: Path, stated: TextFormat) -> Dialect:
    """Return how a text file is written; what is stated is taken as it is.

    Parameters
    ----------
    path : Path
        The file.
    stated : TextFormat
        What is known.

    Raises
    ------
    InputError
        When it is no text, or contains no table of numbers.
    """
    text, encoding = _beginning(path)
    lines = text.splitlines()[:400]
    comment = stated.comment if stated.comment is not None else _comment_in(lines)
    rows = [(number, line) for number, line in enumerate(lines, 1) if line.strip()]
    rows = [(number, line) for number, line in rows if not (comment and line.lstrip().startswith(comment))]
    if not rows:
        raise InputError(f"{path} is empty" if not text.strip() else f"{path} contains comments only")
    delimiter, decimal = _delimiter_in(path, [line for _, line in rows], stated)
    cells = [(number, cells_of(line, delimiter)) for number, line in rows]
    own = next((each for _, each in cells if sum(is_own_column(cell.strip()) for cell in each) > 3), None)
    width = Counter(len(each) for _, each in cells[len(cells) // 2 :]).most_common(1)[0][0] if own is None else len(own)
    start = _start_of_numbers(cells, width, decimal, stated.header_line)
    if start is None and own is not None and len(cells) > 1:
        number, row = cells[1]
        raise InputError(f"{path} line {number} has {len(row)} values, but the table has {width} columns")
    if start is None:
        raise InputError(
            f"{path} has a header but no sample" if len(rows) < 3 else f"{path} contains no table of numbers"
        )
    above = lines[: cells[start][0] - 1]
    if stated.header_line is not None and stated.header_line > len(above):
        raise InputError(f"{path}: header_line is {stated.header_line}, but numbers begin in line {len(above) + 1}")
    names, has_header = _header(path, above, width, delimiter, comment, stated)
    sample = tuple(tuple(each) for _, each in cells[start:] if len(each) == width)
    return Dialect(delimiter, decimal, comment, encoding, names, has_header, cells[start][0], sample)


def _beginning(path: Path) -> tuple[str, str]:
    """Return the text of the first complete lines, and its encoding."""
    with readable(path), path.open("rb") as file:
        content = file.read(2 * LONGEST_LINE)
    is_wide = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    encoding, end = ("utf-16", b"\n\0") if is_wide else ("utf-8-sig", b"\n")
    if b"\0" in content and not is_wide:
        raise InputError(f"{path} is not a text file")
    if len(content) == 2 * LONGEST_LINE:
        content, _, rest = content.rpartition(end)
        if not content or len(rest) > LONGEST_LINE:
            line = content.count(b"\n") + (2 if content else 1)
            raise InputError(f"{path} line {line} is longer than {LONGEST_LINE} characters: is it a recording?")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        encoding, text = "cp1252", content.decode("cp1252", "replace")
    looked = text[:4096]
    is_strange = [letter < " " and letter not in "\t\n\r\f\x1a" for letter in looked]
    if any(is_strange) or sum(letter > _LATIN for letter in looked) > len(looked) / 4:
        raise InputError(f"{path} is not a text file")
    return text, encoding


def _comment_in(lines: Sequence[str]) -> str:
    """Return what begins the lines of comments; the last lines begin otherwise."""
    for comment in _COMMENTS:
        begins = [line.lstrip().startswith(comment) for line in lines if line.strip()]
        if any(begins) and sum(begins[len(begins) // 2 :]) < len(begins) / 4:
            return comment
    return ""


def _delimiter_in(path: Path, lines: Sequence[str], stated: TextFormat) -> tuple[str, str]:
    """Return the delimiter and the decimal sign with which most cells of the later lines are numbers."""
    delimiters = _DELIMITERS if stated.delimiter is None else (stated.delimiter,)
    decimals = (".", ",") if stated.decimal is None else (stated.decimal,)
    later, best, found = lines[len(lines) // 2 :], 0.0, None
    for delimiter in delimiters:
        rows = [cells_of(line, delimiter) for line in later]
        width, count = Counter(map(len, rows)).most_common(1)[0]
        for decimal in decimals:
            if decimal == delimiter:
                continue
            numbers = sum(is_number(cell, decimal) for row in rows if len(row) == width for cell in row)
            # Decimal commas count where there are some: whole numbers are numbers either way.
            score = numbers * count / len(rows) + (0.5 if decimal == "." else 0.0)
            if width > 1 and numbers and score > best * (1 + 1e-9):
                best, found = score, (delimiter, decimal)
    is_header = is_own_column(lines[0].strip()) or any(len(cells_of(lines[0], each)) > 1 for each in delimiters)
    if found is None and len(lines) == 1 and is_header:
        raise InputError(f"{path} has a header but no sample")
    if found is None:
        raise InputError(f"{path} is no table of numbers: no commas, semicolons, tabs or blanks separate columns")
    return found


def _start_of_numbers(
    cells: Sequence[tuple[int, list[str]]], width: int, decimal: str, header_line: int | None
) -> int | None:
    """Return which of the lines is the first of numbers; None where there is none."""
    for place, (number, row) in enumerate(cells):
        numbers = sum(is_number(cell, decimal) for cell in row)
        is_of_numbers = numbers and 2 * numbers >= sum(cell.strip() not in MISSING for cell in row)
        if is_of_numbers and len(row) == width and number > (header_line or 0):
            return place
    return None


def _named(line: str, delimiter: str, comment: str) -> list[str]:
    """Return the cells of a line of names; where blanks cut it, a unit in brackets belongs to the name before it."""
    plain = line.lstrip().removeprefix(comment).strip() if comment else line
    return cells_of(re.sub(r"\s+(?=[\[(])", "", plain) if delimiter == " " else plain, delimiter)


def _header(
    path: Path, above: Sequence[str], width: int, delimiter: str, comment: str, stated: TextFormat
) -> tuple[tuple[str, ...], bool]:
    """Return the names of the columns, and whether they stand in the lines above the numbers."""
    rows = [_named(line, delimiter, comment) for line in above]
    if stated.header_line is not None:
        row = rows[stated.header_line - 1] if stated.header_line else []
        if row and len(row) not in (width, width - 1):
            raise InputError(
                f"{path} line {stated.header_line} names {len(row)} columns, and the lines of numbers have {width}"
            )
    else:
        words = [row for row in rows if not any(is_number(cell, ".") for cell in row)]
        fitting = [row for row in words if len(row) in (width, width - 1)]
        row = fitting[-1] if fitting else []
        units = [cell.strip("[]() ") for cell in row]
        if len(fitting) > 1 and len(row) == len(fitting[-2]) and all(unit in _UNIT_CELLS for unit in units):
            row = [f"{name} [{unit}]" if unit else name for name, unit in zip(fitting[-2], units, strict=True)]
    if not row:
        return tuple(str(number) for number in range(1, width + 1)), False
    if len(row) == width - 1:  # R writes no name above the numbers of its rows
        row = ["row", *row]
    names = tuple(name.strip().strip('"') or str(number) for number, name in enumerate(row, 1))
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise InputError(f"{path}: column {quoted(twice[0])} is there twice: use header_line: 0 and numbers in a map")
    return names, True


_LATIN = "\u03ff"
"""Last letter of Latin and Greek scripts: what is mostly beyond is no table of numbers, or of another encoding."""

_UNIT_NAMES = "s ms us µs ns nT uT µT mT T G mG degC °C C A V - 1 deg rad m"
_UNIT_CELLS = frozenset((*_UNIT_NAMES.split(" "), ""))
"""What a line of units below the names contains."""
