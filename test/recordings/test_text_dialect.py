"""How a text is written is told by its beginning: delimiter, decimal sign, header, encoding."""

import csv
import io

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from inspected import times, turned
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings import read_recording, text_source
from tam_calibration.recordings.channel_map import TextFormat
from tam_calibration.recordings.text_dialect import Dialect, cells_of, detect_dialect, is_number

NAMES = ("time_s", "magx_nT", "magy_nT", "magz_nT", "F_nT")
TRUTH = np.column_stack([times(40, 0) / 1e9, np.round(turned(48_000, 40), 2), 48_000 + np.arange(40) / 4])


def rows_of(table, delimiter=",", decimal="."):
    """Return the lines of a table."""
    return [delimiter.join(f"{value:.2f}".replace(".", decimal) for value in row) for row in table]


def text_of(delimiter=",", decimal=".", preamble=(), names=NAMES, table=TRUTH):
    """Return a text: some lines, a header where there are names, then numbers."""
    return (
        "\n".join([*preamble, *([delimiter.join(names)] if names else []), *rows_of(table, delimiter, decimal)]) + "\n"
    )


@pytest.fixture
def read(tmp_path):
    """Return a function that reads a text, checks that it holds the truth, and returns its dialect."""

    def read(text, encoding="utf-8", stated=None, map=None):
        path = tmp_path / "run.txt"
        path.write_bytes(text.encode(encoding))
        recording = read_recording(path, map=map)
        assert_allclose(recording.readings_T[:, 0], 1e-9 * TRUTH[:, 1:4], rtol=1e-12)
        assert_allclose(recording.time_s, TRUTH[:, 0], atol=1e-9)
        assert_allclose(recording.scalar_T, 1e-9 * TRUTH[:, 4], rtol=1e-12)
        return detect_dialect(path, stated or TextFormat())

    return read


@pytest.mark.parametrize(
    ("delimiter", "decimal"),
    [
        *((each, ".") for each in (",", ", ", ";", "\t", "|", " ", "   ")),
        *((each, ",") for each in (";", "\t", "|", " ")),
    ],
)
@pytest.mark.parametrize("has_names", [True, False])
def test_delimiters_and_decimal_signs(read, delimiter, decimal, has_names):
    """Every pair that can be told apart, with and without a header."""
    text = text_of(delimiter, decimal, names=NAMES if has_names else ())
    map = (
        None
        if has_names
        else {"sensors": [{"columns": [2, 3, 4], "unit": "nT"}], "scalar": {"column": 5, "unit": "nT"}}
    )
    dialect = read(text, map=map)
    assert (dialect.delimiter, dialect.decimal) == (delimiter.strip(" ") or " ", decimal)
    assert dialect.has_header == has_names and dialect.first_line == 1 + has_names
    assert dialect.names == (NAMES if has_names else ("1", "2", "3", "4", "5"))


PREAMBLES = {
    "comments": ["# fluxgate array, firmware 2.1", "# values in nT, 25 Hz", "#"],
    "percent": ["% Exported by MATLAB", "% 40 rows"],
    "slashes": ["// logger", "// v2"],
    "words": ["Survey export", "Station: Hill 3, array A", "Created 14/05/2024, 10:02 by LogView 7", ""],
    "key values": ["Serial;1234", "Gain;0.5;1.5", "", ""],
    "numbers": ["17", "2024;5;14"],
}


@pytest.mark.parametrize("preamble", PREAMBLES)
@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_lines_before_the_header_are_not_read(read, preamble, delimiter):
    """Comments, words and settings, of any number of cells."""
    assert read(text_of(delimiter, preamble=PREAMBLES[preamble])).names == NAMES


def test_comments_among_the_numbers_are_not_read(read):
    """Where the logger wrote what happened; also more of them than of numbers at the beginning."""
    lines = text_of().splitlines()
    for place in (20, 10, 5, 1):
        lines.insert(place, "# the array was put down, 12, 13")
    assert read("\n".join(lines)).comment == "#"
    assert read(text_of(preamble=["# a"] * 100)).comment == "#"


def test_a_header_behind_a_comment_sign_is_read(read):
    """As numpy writes it."""
    assert read("# " + text_of()).names == NAMES


def test_units_in_a_line_of_their_own(read):
    """Below the names."""
    names = ("time", "magx", "magy", "magz", "F")
    text = text_of(";", names=names).replace("\n", "\ns;nT;nT;nT;nT\n", 1)
    assert read(text).names == ("time [s]", "magx [nT]", "magy [nT]", "magz [nT]", "F [nT]")


def test_quotes_are_taken_off(read):
    """Around names alone, or around numbers too (RFC 4180), and the name that R leaves out."""
    quoted = ",".join(f'"{name}"' for name in NAMES)
    assert read(text_of().replace(",".join(NAMES), quoted)).names == NAMES
    assert (
        read("\n".join(",".join(f'"{cell}"' for cell in line.split(",")) for line in text_of().splitlines())).names
        == NAMES
    )
    lines = text_of().splitlines()[1:]
    numbered = [f'"{number}",{line}' for number, line in enumerate(lines, 1)]
    for first in (quoted, f'"",{quoted}'):
        assert read("\n".join([first, *numbered])).names[1:] == NAMES


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_encodings_and_ends_of_lines(read, encoding, end):
    """With and without a byte order mark, Windows' code page with its degrees and micros, the end of line left out."""
    names = ("Zeit [s]", "Bx [nT]", "By [nT]", "Bz [nT]", "Gesamtfeld [nT]")
    text = text_of(";", ",", names=names, preamble=["Prüfstand µ-Metall, 20 °C"]).replace("\n", end)
    map = {
        "time": {"column": names[0], "format": "s"},
        "sensors": [{"columns": list(names[1:4])}],
        "scalar": {"column": names[4]},
    }
    assert read(text, encoding, map=map).names == names
    assert read(text.rstrip(), encoding, map=map).names == names


def test_what_is_stated_is_not_detected(read):
    """The delimiter, the decimal sign, the line of the header and the comment of a map."""
    stated = TextFormat(delimiter=";", decimal=",", header_line=3, comment="//")
    text = text_of(";", ",", preamble=["a;b;c;d;e", "// x"])
    map = {"text": {"delimiter": ";", "decimal": ",", "header_line": 3, "comment": "//"}}
    map |= {"sensors": [{"columns": list(NAMES[1:4])}], "scalar": {"column": "F_nT"}}
    assert read(text, stated=stated, map=map).names == NAMES


def test_a_header_may_be_denied(read):
    """``header_line: 0`` and numbers of columns read a file whose names are there twice."""
    text = text_of(names=("time", "x", "y", "y", "F"))
    columns = {"sensors": [{"columns": [2, 3, 4], "unit": "nT"}], "scalar": {"column": 5, "unit": "nT"}}
    with pytest.raises(InputError, match="column 'y' is there twice: use header_line: 0"):
        read(text, map=columns)
    assert not read(text, stated=TextFormat(header_line=0), map={**columns, "text": {"header_line": 0}}).has_header


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("1,2,3\n" * 9, "header_line is 20, and numbers begin in line"),
        ("a,b\n" + "1,2,3,4,5\n" * 30, "line 1 names 2 columns, and the lines of numbers have 5"),
    ],
)
def test_a_stated_header_that_is_none_is_told(tmp_path, text, sentence):
    """Behind the first number, or of another width."""
    (tmp_path / "run.csv").write_text(text)
    with pytest.raises(InputError, match=f"{sentence}|has a header but no sample|contains no table"):
        detect_dialect(tmp_path / "run.csv", TextFormat(header_line=20 if "20" in sentence else 1))


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from([",", ";", "\t", "|"]),
    st.sampled_from([".", ","]),
    st.lists(st.lists(st.floats(-1e6, 1e6), min_size=4, max_size=4), min_size=4, max_size=30),
    st.booleans(),
)
def test_any_table_is_cut_as_it_was_written(tmp_path, delimiter, decimal, table, is_quoted):
    """Whatever its numbers: the cells of the csv module's writer come back."""
    assume(delimiter != decimal)
    content = io.StringIO(newline="")
    writer = csv.writer(content, delimiter=delimiter, quoting=csv.QUOTE_NONNUMERIC if is_quoted else csv.QUOTE_MINIMAL)
    writer.writerow(["time s", "x, y", "b;c", "d"])
    rows = [[f"{value:.3f}".replace(".", decimal) for value in row] for row in table]
    writer.writerows(rows)
    (tmp_path / "run.csv").write_bytes(content.getvalue().encode())
    dialect = detect_dialect(tmp_path / "run.csv", TextFormat())
    assert (dialect.delimiter, dialect.decimal) == (delimiter, decimal)
    assert dialect.names == ("time s", "x, y", "b;c", "d")
    assert [list(row) for row in dialect.sample] == rows


@pytest.mark.parametrize("cell", ["1", "-1.5", "+1e-3", ".5", "5.", " 7 ", "inf", "-Infinity", "1E5"])
def test_what_is_a_number(cell):
    """In either decimal sign; the other sign makes none."""
    assert is_number(cell, ".") and is_number(cell.replace(".", ","), ",")
    for other in ("1 2", "0x1", "1_0", "", "nan", "12:30", "1.2.3"):
        assert not is_number(other, ".")


def test_columns_are_numbers_or_words():
    """Half of the cells decide, so that one word among numbers is a fault of its line; our own names are numbers."""
    sample = tuple((str(number), "ok", "oops" if number == 3 else "5", "x") for number in range(10))
    dialect = Dialect(",", ".", "", "utf-8", ("t", "status", "value", "b1x_nT"), True, 2, sample)
    assert [dialect.is_numeric(column) for column in range(4)] == [True, False, True, True]


def test_blanks_within_quotes_do_not_cut():
    """In cells that blanks cut."""
    assert cells_of('"a b"  1 2', " ") == ["a b", "1", "2"]
    assert cells_of('1,"a, b",2', ",") == ["1", "a, b", "2"]


@pytest.mark.parametrize(("delimiter", "decimal"), [(",", "."), (";", ","), ("\t", ".")])
def test_large_files_give_the_same_numbers(tmp_path, monkeypatch, delimiter, decimal):
    """The library that reads them and numpy agree to the last bit, with blanks and words for what is missing."""
    pytest.importorskip("pyarrow")
    lines = text_of(delimiter, decimal).splitlines()
    for place, word in enumerate(("", "NaN", "NA", "null", "-"), 3):
        lines[place] = delimiter.join([*lines[place].split(delimiter)[:-1], word])
    (tmp_path / "run.csv").write_text("\n".join(lines))
    small = read_recording(tmp_path / "run.csv")
    by_arrow = text_source._by_arrow
    called = []
    monkeypatch.setattr(text_source, "_LARGE", 0)
    monkeypatch.setattr(text_source, "_by_arrow", lambda *given: called.append(by_arrow(*given)) or called[-1])
    large = read_recording(tmp_path / "run.csv")
    assert called and called[0] is not None
    for name, values in small.values().items():
        assert_array_equal(large.values()[name], values)


def test_pieces_of_a_file_give_the_same_numbers(tmp_path, monkeypatch):
    """Also where comments and blank lines stand between them."""
    lines = text_of(preamble=["# a"]).splitlines()
    lines[9:9] = ["", "# b, c", ""]
    (tmp_path / "run.csv").write_text("\n".join(lines))
    whole = read_recording(tmp_path / "run.csv")
    monkeypatch.setattr(text_source, "PIECE", 100)
    pieces = read_recording(tmp_path / "run.csv")
    for name, values in whole.values().items():
        assert_array_equal(pieces.values()[name], values)
