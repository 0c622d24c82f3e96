"""Blocks of text, tables and pictures, of which pages are made and the terminal prints; and numbers for people."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tam_calibration.model.units import FloatArray


@dataclass(frozen=True)
class Text:
    """A paragraph; ``emphasis`` names how it is set: "", "good" or "doubt" for a verdict."""

    text: str
    emphasis: str = ""


@dataclass(frozen=True)
class Points:
    """A list of points."""

    points: Sequence[str]


@dataclass(frozen=True)
class Code:
    """Text to copy into a file or a terminal: one click selects all of it."""

    text: str
    caption: str


@dataclass(frozen=True)
class Table:
    """A table, with a header where it is not empty; the first cell of each row is its head.

    ``numeric`` aligns the other cells right.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    numeric: bool = True


@dataclass(frozen=True)
class Image:
    """A picture as a data URI, with the words that stand for it and those under it."""

    source: str
    alternative: str
    caption: str


@dataclass(frozen=True)
class Gallery:
    """Pictures side by side where the page is wide enough."""

    images: Sequence[Image]


Block = Text | Points | Code | Table | Image | Gallery


@dataclass(frozen=True)
class Section:
    """A titled part of a page."""

    title: str
    blocks: Sequence[Block]


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_UNKNOWN = "–"
_THIN_SPACE = "\u202f"


def number(value: float, digits: int = 3) -> str:
    """Format with the given significant digits, never cutting an integer part: 8172, 5.99, 0.0123, 1.2 × 10⁻⁹.

    Parameters
    ----------
    value : float
        In the unit in which it is shown; NaN gives a dash.
    digits : int
        Number of significant digits.
    """
    if math.isnan(value):
        return _UNKNOWN
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    if int(exponent) < -4:
        return f"{mantissa} × 10{str(int(exponent)).translate(_SUPERSCRIPT)}".replace("-", "−")
    return fixed(value, max(0, digits - 1 - int(exponent)))


def fixed(value: float, decimals: int) -> str:
    """Format with the given number of decimals; from ten thousand on with gaps between thousands.

    Parameters
    ----------
    value : float
        In the unit in which it is shown; NaN and infinity give a dash.
    decimals : int
        Number of digits behind the point.
    """
    if not math.isfinite(value):
        return _UNKNOWN
    text = f"{value:,.{decimals}f}" if abs(value) >= 1e4 else f"{value:.{decimals}f}"
    return text.replace(",", _THIN_SPACE).replace("-", "−")


def with_error(value: float, standard_error: float, decimals: int) -> str:
    """Format value ± standard error, the error with two significant digits.

    Parameters
    ----------
    value : float
        In the unit in which it is shown.
    standard_error : float
        In the same unit; zero marks a value that is fixed, NaN an error that is not known.
    decimals : int
        Digits behind the point of a value whose standard error is not known.
    """
    if math.isnan(standard_error):
        return fixed(value, decimals)
    if standard_error == 0:
        return f"{number(value)} (fixed)"
    exponent = int(f"{standard_error:.1e}".split("e")[1])
    decimals = max(0, 1 - exponent)
    return f"{fixed(value, decimals)} ± {fixed(standard_error, decimals)}"


def with_errors(values: FloatArray, standard_errors: FloatArray, decimals: int) -> list[str]:
    """Format each of some values (n,) as `with_error` does."""
    pairs = zip(values.tolist(), standard_errors.tolist(), strict=True)
    return [with_error(value, error, decimals) for value, error in pairs]


def ratio(value: float) -> str:
    """Format a ratio that is best near one."""
    return fixed(value, 2) if value < 10 else number(value)


def sentence(words: str) -> str:
    """Return words with a capital first letter and a full stop."""
    return f"{words[:1].upper()}{words[1:].rstrip('.')}."


def count(value: int) -> str:
    """Format a whole number."""
    return fixed(value, 0)


def counted(value: int, noun: str) -> str:
    """Return a count with what is counted, in the plural where it is not 1."""
    return f"{count(value)} {noun}" + ("" if value == 1 else "s")


def join(words: list[str]) -> str:
    """Join words to a list in prose: a, b and c."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
