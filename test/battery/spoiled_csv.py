"""Tables of readings that a person, a spreadsheet or a logger spoils."""

import csv
from collections.abc import Callable
from io import StringIO
from pathlib import Path

from numpy.random import Generator

from battery.recipes import Recipe
from battery.trial import May, Trial, pick

Rows = list[list[str]]

_MISSING = ("nan", "inf", "-inf", "1e999", "1e300", "-1e300", "", " ", "None")
"""What stands for a reading that is missing: samples go on without it, which is told."""
_NO_NUMBERS = (*_MISSING, "abc", "--1", "1..2", "0x1F", "=1+1")
_STRANGE_NUMBERS = ("1e-320", "1_000", "١٢٣", "+7", "007", "1E+2", " 3 ", "9" * 400, "0." + "3" * 5000)


def no_number(rows: Rows, rng: Generator) -> tuple[str, May]:
    """Put something that is no reading in a cell of a sensor or of the time."""
    row, column = _cell(rows, rng)
    token = pick(rng, _NO_NUMBERS) if rng.random() < 0.7 else _text(rng)
    rows[row][column] = token
    may = May.WARN if token in _MISSING and column else May.REFUSE
    return f"{token!r} in row {row} column {rows[0][column]}", may


def strange_number(rows: Rows, rng: Generator) -> tuple[str, May]:
    """Put a number in a cell that some readers take and others do not."""
    row, column = _cell(rows, rng)
    rows[row][column] = pick(rng, _STRANGE_NUMBERS)
    return f"{rows[row][column][:20]!r} in row {row} column {rows[0][column]}", May.DO_ANYTHING


def other_header(rows: Rows, rng: Generator) -> tuple[str, May]:
    """Spoil the name of a column of a sensor or of the time."""
    column = int(rng.integers(13))
    name = rows[0][column]
    number = int(10 ** rng.uniform(1, 25))
    choices = (rows[0][(column + 1) % 13], "", name[:-3], f"{name}T", f"b{number}x_nT", f"b-{number}x_nT", name * 999)
    rows[0][column] = pick(rng, choices)
    return f"column {name} is called {rows[0][column][:40]!r}", May.REFUSE if column else May.DO_ANYTHING


def lost_column(rows: Rows, rng: Generator) -> tuple[str, May]:
    """Lose a column of a sensor or the time."""
    column = int(rng.integers(13))
    name = rows[0][column]
    for row in rows:
        del row[column]
    return f"without column {name}", May.REFUSE if column else May.WARN


def ragged(rows: Rows, rng: Generator) -> tuple[str, May]:
    """Lose or add cells of a row."""
    row = int(rng.integers(1, len(rows)))
    if rng.random() < 0.5:
        rows[row] = rows[row][: int(rng.integers(1, len(rows[row])))]
    else:
        rows[row] = rows[row] + ["1"] * int(rng.integers(1, 30))
    return f"{len(rows[row])} cells in row {row}", May.REFUSE


def disorder(rows: Rows, rng: Generator) -> tuple[str, May]:
    """Hold a row twice, or two in the wrong order."""
    row = int(rng.integers(1, len(rows) - 1))
    if rng.random() < 0.5:
        rows.insert(row, list(rows[row]))
        return f"row {row} is there twice", May.WARN
    other = int(rng.integers(row + 1, len(rows)))
    rows[row], rows[other] = rows[other], rows[row]
    return f"time in disorder at row {row}", May.REFUSE


def too_few(rows: Rows, rng: Generator) -> tuple[str, May]:
    """Hold next to no row."""
    del rows[1 + int(rng.integers(3)) :]
    return f"{len(rows) - 1} rows", May.REFUSE if len(rows) == 1 else May.DO_ANYTHING


def lost_rows(rows: Rows, rng: Generator) -> tuple[str, May]:
    """Lose rows between."""
    row = int(rng.integers(1, len(rows)))
    del rows[row : row + int(rng.integers(1, 200))]
    return f"rows are lost at {row}", May.DO_ANYTHING


def odd_text(rows: Rows, rng: Generator) -> tuple[str, May]:
    """Put any text in any cell, also where nothing need be."""
    row, column = int(rng.integers(len(rows))), int(rng.integers(len(rows[0])))
    rows[row][column] = _text(rng)
    return f"{rows[row][column]!r} in row {row} column {column}", May.DO_ANYTHING


def _cell(rows: Rows, rng: Generator) -> tuple[int, int]:
    return int(rng.integers(1, len(rows))), int(rng.integers(13))


def _text(rng: Generator) -> str:
    """Return text that is no number, with anything in it."""
    codes = rng.choice(
        [9, 27, 34, 39, 59, 0x7F, 0x85, 0x2028, 0x202E, 0x1F600, *range(32, 44), *range(58, 127)], size=8
    )
    return "x" + "".join(map(chr, codes))


_SPOILERS: tuple[Callable[[Rows, Generator], tuple[str, May]], ...] = (
    *(no_number, no_number, no_number, strange_number, other_header, other_header),
    *(lost_column, ragged, disorder, too_few, lost_rows, odd_text),
)


def _encoded(text: str, rng: Generator) -> tuple[bytes, str, May]:
    """Return the text as another program would write it."""
    ways = {
        "utf-16": (text.encode("utf-16"), May.DO_THE_SAME),
        "a mark of UTF-8": (b"\xef\xbb\xbf" + text.encode(), May.DO_THE_SAME),
        "lines of Windows": (text.replace("\n", "\r\n").encode(), May.DO_THE_SAME),
        "lines of an old Mac": (text.replace("\n", "\r").encode(), May.DO_THE_SAME),
        "semicolons": (text.replace(",", ";").encode(), May.DO_THE_SAME),
        "decimal commas": (text.replace(",", ";").replace(".", ",").encode(), May.DO_THE_SAME),
        "a zero byte": (text.encode().replace(b",", b"\0", 1), May.REFUSE),
        "empty lines": (text.replace("\n", "\n\n").encode(), May.DO_THE_SAME),
        "blanks": (b" \n\t\n" * int(rng.integers(1, 9)), May.REFUSE),
        "nothing": (b"", May.REFUSE),
        "bytes of no text": (rng.bytes(2000), May.REFUSE),
    }
    way = pick(rng, sorted(ways))
    return (ways[way][0], way, ways[way][1])


def spoil(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Spoil the table that a recipe reads."""
    path = folder / next(name for name in recipe.reads if name.endswith(".csv"))
    text = path.read_text()
    if rng.random() < 0.15:
        data, told, may = _encoded(text, rng)
        path.write_bytes(data)
        return Trial.of(recipe, told, may)
    rows = list(csv.reader(StringIO(text)))
    told, may = pick(rng, _SPOILERS)(rows, rng)
    path.write_bytes("".join(",".join(row) + "\n" for row in rows).encode())
    return Trial.of(recipe, told, may)
