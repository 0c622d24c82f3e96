"""Blocks of text, tables and pictures, of which pages are made; the terminal prints those of words and numbers."""

from collections.abc import Sequence
from dataclasses import dataclass


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
