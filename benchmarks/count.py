"""Count what a reader of the project meets: code, names, words, and the journey of ``tam calibrate``."""

import ast
import io
import sys
import tempfile
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from rich.console import Console
from rich.table import Table

PACKAGE = Path(__file__).parents[1] / "tam_calibration"
ROOT = PACKAGE.parent

_NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def code_lines(source: str) -> int:
    """Return the number of code lines of a module."""
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        body = getattr(node, "body", None)
        texts = [each.value for each in body if isinstance(each, ast.Expr)] if isinstance(body, list) else []
        for text in texts:
            if isinstance(text, ast.Constant) and isinstance(text.value, str):
                docstrings.update(range(text.lineno, (text.end_lineno or text.lineno) + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - docstrings)


def sources_by_room(package: Path = PACKAGE) -> dict[str, list[str]]:
    """Return the sources of the modules of each room."""
    rooms: dict[str, list[str]] = {}
    for path in sorted(package.rglob("*.py")):
        room = path.relative_to(package).parts[0]
        rooms.setdefault(room if (package / room).is_dir() else ".", []).append(path.read_text(encoding="utf-8"))
    return rooms


def function_count(source: str) -> int:
    """Return the number of functions and methods of a module, nested ones too."""
    return sum(isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) for node in ast.walk(ast.parse(source)))


def numeric_constant_count(source: str) -> int:
    """Return the number of assignments of a module whose names are capitals and whose value contains a number."""
    assigned = [node for node in ast.parse(source).body if isinstance(node, ast.Assign | ast.AnnAssign)]
    return sum(_is_constant(node) and _has_number(node.value) for node in assigned)


def _is_constant(node: ast.Assign | ast.AnnAssign) -> bool:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    return all(name.id.isupper() for target in targets for name in ast.walk(target) if isinstance(name, ast.Name))


def _has_number(value: ast.expr | None) -> bool:
    constants = [node.value for node in ast.walk(value or ast.Pass()) if isinstance(node, ast.Constant)]
    return any(isinstance(each, int | float) and not isinstance(each, bool) for each in constants)


def word_count(*paths: Path) -> int:
    """Return the number of words of text files, separated by white space."""
    return sum(len(path.read_text(encoding="utf-8").split()) for path in paths)


class Journey:
    """The modules of the package that are entered while code runs: a function for ``sys.setprofile``.

    ``entered`` has the modules, and ``pairs`` the caller and callee of each call from one module to another. Calls
    during an import do not count.
    """

    def __init__(self) -> None:
        self.entered: set[str] = set()
        self.pairs: set[tuple[str, str]] = set()

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        """Record a call."""
        callee = _module_of(frame)
        if event != "call" or not callee or any(each.f_code.co_name == "<module>" for each in _stack(frame)):
            return
        self.entered.add(callee)
        caller = "" if frame.f_back is None else _module_of(frame.f_back)
        if caller not in ("", callee):
            self.pairs.add((caller, callee))

    @property
    def returns(self) -> int:
        """The number of pairs that enter a module that another module has entered already."""
        return len(self.pairs) - len(self.entered)


def _module_of(frame: FrameType) -> str:
    name: str = frame.f_globals.get("__name__", "")
    return name if name.startswith(f"{PACKAGE.name}.") else ""


def _stack(frame: FrameType) -> Iterator[FrameType]:
    """Yield the frames from a call back to the one that imports, or to the first."""
    caller: FrameType | None = frame
    while caller is not None and caller.f_globals.get("__name__") != "__main__":
        yield caller
        caller = caller.f_back


def journey_of_calibrate() -> Journey:
    """Return the journey of ``tam calibrate`` on a simulated recording of 360 samples."""
    from click.testing import CliRunner

    from tam_calibration.cli.main import main

    journey = Journey()
    with tempfile.TemporaryDirectory() as folder:
        run, array = Path(folder, "run.csv"), Path(folder, "run.array.yaml")
        CliRunner().invoke(main, ["simulate", "wu_table_1", "-o", str(run)], catch_exceptions=False)
        command = ["calibrate", str(run), "--array", str(array), "-o", str(Path(folder, "calibration.yaml"))]
        sys.setprofile(journey)
        try:
            CliRunner().invoke(main, command, catch_exceptions=False)
        finally:
            sys.setprofile(None)
    return journey


def main() -> None:
    """Print a table of the rooms of the package, the largest first, and the counts of the project."""
    table = Table("room", "modules", "code lines", "functions", "numeric constants")
    for column in table.columns[1:]:
        column.justify = "right"
    counts = {
        room: Counter(
            modules=len(sources),
            lines=sum(map(code_lines, sources)),
            functions=sum(map(function_count, sources)),
            constants=sum(map(numeric_constant_count, sources)),
        )
        for room, sources in sources_by_room().items()
    }
    for room, count in sorted(counts.items(), key=lambda each: -each[1]["lines"]):
        table.add_row(room, *map(str, count.values()))
    table.add_section()
    table.add_row("sum", *map(str, sum(counts.values(), Counter()).values()))
    table.add_section()
    journey = journey_of_calibrate()
    for name, number in (
        ("words of README.md", word_count(ROOT / "README.md")),
        ("words of docs/", word_count(*ROOT.glob("docs/**/*.md"))),
        ("tam calibrate: modules entered", len(journey.entered)),
        ("tam calibrate: returns to a module", journey.returns),
    ):
        table.add_row(name, str(number))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
