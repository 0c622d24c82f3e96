"""Write ``docs/reference/causes.md`` from the table of causes.

Run ``python docs/list_causes.py`` after the table was changed; a test compares the two.
"""

from pathlib import Path

from tam_calibration.gap.laws.law import CAUSES, PossibleCause

PAGE = Path(__file__).parent / "reference" / "causes.md"

_HEAD = """\
# Causes by their signature

This page lists the causes that `tam diagnose` can name, with a test and a remedy for each. The diagnosis finds the
*law* of a gap first: what the disturbance does to a reading, where, and its course in time. A cause is named if it can
have that law. `docs/list_causes.py` writes this page; [effects](effects.md) lists those that the library can fit and
simulate. The physics and source of each cause are in `causes.toml` and on the page of `tam diagnose --report`.

| law | what the disturbance does |
|---|---|
| `offset` | adds a vector to the readings |
| `gain` | multiplies the field by a matrix: scale, tilt, leakage between axes or sensors |
| `rate` | follows the field's rate of change |
| `own_field` | is a function of the axis' own reading |
| `attitude` | is a function of direction or position in the world |
| `noise` | adds variance |
| `samples` | makes single or held readings |

The residual of one axis while the array tumbles, for each law with each course (`docs/draw_signatures.py`):

![Residuals by law and course; a grey field has no cause in the table](../images/signatures.png)

| cause | law | course | what it is | how to test it | what to do |
|---|---|---|---|---|---|
"""


def page() -> str:
    """Return the page in Markdown."""
    return _HEAD + "".join(map(_row, CAUSES))


def _row(cause: PossibleCause) -> str:
    title = cause.title[:1].upper() + cause.title[1:]
    size = f"; in nature {cause.size}" if cause.size else ""
    law, course = (", ".join(f"`{one}`" for one in words) for words in (cause.law, cause.course))
    return f"| `{cause.name}` | {law} | {course} | {title}{size} | {cause.proof} | {cause.remedy} |\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
