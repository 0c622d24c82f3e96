"""Count the code lines of the package, room by room: lines with a token that is no comment, blank or docstring."""

import ast
import io
import sys
import tokenize
from collections import Counter
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "tam_calibration"

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


def main(package: Path = PACKAGE) -> None:
    """Print modules and code lines of each room, the largest first, and their sums."""
    modules: Counter[str] = Counter()
    lines: Counter[str] = Counter()
    for path in package.rglob("*.py"):
        parts = path.relative_to(package).parts
        room = parts[0] if len(parts) > 1 else "."
        modules[room] += 1
        lines[room] += code_lines(path.read_text(encoding="utf-8"))
    for room, count in lines.most_common():
        print(f"{room:14} {modules[room]:4} modules {count:6} lines")
    print(f"{'sum':14} {modules.total():4} modules {lines.total():6} lines")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
