"""Check that documents and messages are plain English: no sentence over 35 words, none of our private words.

Run ``python benchmarks/prose.py``. It fails if a document falls short, or more messages of the code than ``MOST``;
``--messages`` lists those. Words in backticks or italics are quotations.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
LONGEST, MOST = 35, 55
"""Words in a sentence; messages that fall short today, a number to lower and never to raise."""
_WORDS = r"alike|beside|by which|holds|is none|mend|mends|mended|mending|nobody|stands(?! for)|told(?! apart| from)"
PRIVATE = re.compile(rf"\b(?:{_WORDS}|tells(?! you)|unaffected|what is left|whole|(?:resolved|wide) prior)\b", re.I)
"""Words that readers had to guess at; the usual word is better."""


def shortcomings(text: str) -> Iterator[str]:
    """Yield what is wrong with a paragraph, a table cell or a message."""
    text = re.sub(r"\]\([^)]*\)", "]", " ".join(text.split()))
    for sentence in re.split(r"(?<=[.!?])\s+", re.sub(r"`[^`]*`|(?<!\*)\*[^*]+\*(?!\*)", "X", text)):
        if len(words := re.findall(r"\S*\w\S*", sentence)) > LONGEST:
            yield f"{len(words)} words: {sentence[:60]}"
        yield from (f"'{found[0]}': {sentence[:60]}" for found in PRIVATE.finditer(sentence))


def parts_of_document(path: Path) -> Iterator[str]:
    """Yield the paragraphs, list items and table cells of a document; of the changelog, those of the next release."""
    text = re.sub(r"```.*?```|<!--.*?-->", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    text = text.replace("``", "`").partition("\n0.1.0 (")[0]
    yield from re.split(r"\n\s*\n|\n\s*(?:[-*]|\d+\.) |\n#+ |\n?\|", text)


def messages_of(path: Path) -> Iterator[str]:
    """Yield the strings of a module that are sentences, docstrings left out."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    skipped = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    skipped |= {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if id(node) not in skipped and isinstance(node, ast.Constant | ast.JoinedStr):
            values = [getattr(part, "value", "") for part in getattr(node, "values", [node])]
            text = "".join(value if isinstance(value, str) else "X" for value in values)
            yield from [text] * (len(text.split()) > 4)


if __name__ == "__main__":
    documents = [*ROOT.glob("*.md"), ROOT / "CHANGELOG.rst", ROOT / "examples/README.md", *ROOT.glob("docs/**/*.md")]
    bad = [f"{path}: {one}" for path in documents for part in parts_of_document(path) for one in shortcomings(part)]
    modules = sorted(ROOT.glob("tam_calibration/**/*.py"))
    messages = [f"{path}: {one}" for path in modules for text in messages_of(path) for one in shortcomings(text)]
    print("\n".join(bad + messages * (len(messages) > MOST or "--messages" in sys.argv)))
    sys.exit(f"{len(bad)} in documents, {len(messages)} in messages" if bad or len(messages) > MOST else 0)
