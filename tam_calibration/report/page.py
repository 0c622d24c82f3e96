"""One self-contained HTML page made of sections, each a title and blocks, and the look that all figures share.

A report lists its sections in the order in which they are read; one without blocks is left out.

Jinja2 writes it because it escapes every text by itself, so that no file name can break or inject into a page.
"""

import base64
import re
from collections.abc import Callable, Sequence
from functools import wraps
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from tam_calibration.files.text_files import write_whole
from tam_calibration.report.blocks import Block, Image, Points, Section

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Given = ParamSpec("Given")
Drawn = TypeVar("Drawn")

BEFORE_COLOR = "#c0701a"
AFTER_COLOR = "#1f5f99"
FLOOR_COLOR = "#3c4650"
MISSING_COLOR = "#f0a35e"
QUIET_COLOR = "#5b6773"
COLORS = (BEFORE_COLOR, AFTER_COLOR, FLOOR_COLOR, QUIET_COLOR, MISSING_COLOR)
"""Of lines in one figure, in order."""

WIDTH_INCH = 4.7
"""Of a plain figure."""

PAGE_WIDTH_INCH = 7.4
"""Of a figure that takes the complete width of a page."""

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9,
    "figure.labelsize": 9,
    "date.converter": "concise",
    "axes.linewidth": 0.6,
    "axes.edgecolor": QUIET_COLOR,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "xtick.color": FLOOR_COLOR,
    "ytick.color": FLOOR_COLOR,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "figure.constrained_layout.wspace": 0.08,
}
"""Settings of matplotlib; the font is the one that it brings along."""


def in_style(draw: Callable[Given, Drawn]) -> Callable[Given, Drawn]:
    """Have a function draw in the look of all figures; matplotlib is loaded when it does."""

    @wraps(draw)
    def draw_in_style(*arguments: Given.args, **named: Given.kwargs) -> Drawn:
        import matplotlib

        with matplotlib.rc_context(STYLE):
            return draw(*arguments, **named)

    return draw_in_style


def new_figure(width_inch: float, height_inch: float) -> "Figure":
    """Return an empty figure, whose parts find their places by themselves."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_inch, height_inch), layout="constrained")


def write_page(path: Path, title: str, subtitle: str, sections: Sequence[Section]) -> None:
    """Write a page; nothing is left at the path when writing fails, and an older file stays as it was.

    Parameters
    ----------
    path : Path
        The HTML file.
    title, subtitle : str
        Plain text.
    sections : sequence of Section
        In the order in which they are read; those without blocks are left out.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    page = render(title, subtitle, [section for section in sections if section.blocks])
    with write_whole(path) as part:
        part.write_text(page, encoding="utf-8")


def render(title: str, subtitle: str, sections: Sequence[Section]) -> str:
    """Return the HTML of a page.

    Parameters
    ----------
    title, subtitle : str
        Plain text.
    sections : sequence of Section
        In the order in which they are read.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("tam_calibration.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # Numbers and their units stay together at the ends of lines.
    environment.filters["keep_units"] = lambda text: re.sub(r"(\d) (nT|×|%)", "\\1\N{NO-BREAK SPACE}\\2", text)
    environment.filters["kind"] = lambda block: type(block).__name__.lower()
    return environment.get_template("page.html").render(title=title, subtitle=subtitle, sections=sections)


def figure_blocks(figure: "Figure", title: str, seen: str, otherwise: str) -> Sequence[Block]:
    """Return a figure of a gap, and a list of what to look for on it.

    Parameters
    ----------
    figure : Figure
        Drawn of the gap.
    title : str
        Its caption, and the words that stand for it.
    seen : str
        What is seen on it.
    otherwise : str
        What would be seen without a gap.
    """
    return embed(figure, title, title), Points([f"What you see: {seen}", f"Without a gap: {otherwise}"])


def embed(figure: "Figure", alternative: str, caption: str = "") -> Image:
    """Return a figure as an SVG image within the page; the same figure always gives the same bytes.

    Parameters
    ----------
    figure : Figure
        What it draws rasterized has 200 dots an inch.
    alternative : str
        Words that stand for it where it is not shown.
    caption : str
        Words under it.
    """
    import matplotlib

    if (layout := figure.get_layout_engine()) is not None:
        layout.execute(figure)
        figure.set_layout_engine(None)  # else all is drawn twice, at first for the layout alone
    buffer = BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "tam_calibration"}):
        figure.savefig(buffer, format="svg", dpi=200, metadata={"Date": None})
    return Image(f"data:image/svg+xml;base64,{base64.b64encode(buffer.getvalue()).decode()}", alternative, caption)
