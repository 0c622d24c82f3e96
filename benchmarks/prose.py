"""Check that documents and messages are plain English: no sentence over 35 words, none of our private words.

Run ``python benchmarks/prose.py``. Documents must pass. Of the messages in the code it counts those that fall short;
``--messages`` lists them. ``make check`` fails if a document falls short, or more messages than ``MOST_MESSAGES``.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
LONGEST = 35
"""Words in a sentence."""
MOST_MESSAGES = 400
"""Messages that fall short today: lower it, never raise it."""
PRIVATE = {
    "alike": "in the same way",
    "beside": "next to, with",
    "by which": "two sentences",
    "holds": "contains, is true",
    "is none": "is not",
    "mends?|mended|mending": "correct, repair",
    "nobody": "passive voice",
    "stands(?! for)": "is",
    "told(?! apart)|tells(?! you| developers)": "state, report, show",
    "unaffected": "valid",
    "what is left": "the residual, what remains",
    "whole": "complete, entire",
    "(?:resolved|wide) prior": "weighted prior",
}
_WORDS = [(re.compile(rf"\b(?:{word})\b", re.IGNORECASE), instead) for word, instead in PRIVATE.items()]


def shortcomings(text: str) -> Iterator[str]:
    """Yield what a paragraph, table cell or message lacks; words in backticks and italics are quotations."""
    text = re.sub(r"`[^`]*`|(?<!\*)\*[^*\n]+\*(?!\*)|\$.*?\$", "X", re.sub(r"\]\([^)]*\)", "]", text))
    for sentence in re.split(r"(?<=[.!?])\s+|\s*(?<=:)\s+(?=[-*] )", text):
        if len(words := re.findall(r"\S*\w\S*", sentence)) > LONGEST:
            yield f"{len(words)} words: {' '.join(words[:8])} …"
        yield from (f"'{found[0]}' ({instead}): {sentence[:60]}" for word, instead in _WORDS if (found := word.search(sentence)))


def of_document(path: Path) -> Iterator[str]:
    """Yield the shortcomings of a document, by paragraph, list item and table cell."""
    text = path.read_text(encoding="utf-8")
    if path.name == "CHANGELOG.rst":  # releases stay as they were
        text = "\n".join(text.partition("Forthcoming")[2].partition("\n0.")[0].replace("``", "`").split("\n")[2:])
    text = re.sub(r"```.*?```|<!--.*?-->|^(?:    |\.\. ).*?$", "", text, flags=re.DOTALL | re.MULTILINE)
    for part in re.split(r"\n\s*\n|\n\s*(?:[-*]|\d+\.) |\n#+ |\n?\|", text):
        yield from shortcomings(" ".join(part.split()))


def of_messages(path: Path) -> Iterator[str]:
    """Yield the shortcomings of the strings of a module that are sentences, docstrings left out."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    skipped = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for joined in (node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)):
        skipped |= {id(part) for part in joined.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in skipped:
            parts = node.values if isinstance(node, ast.JoinedStr) else [node]
            text = "".join(part.value if isinstance(part, ast.Constant) and isinstance(part.value, str) else "X" for part in parts)
            if len(text.split()) > 4:
                yield from (f"line {node.lineno}: {one}" for one in shortcomings(text))


if __name__ == "__main__":
    pages = [*ROOT.glob("*.md"), ROOT / "CHANGELOG.rst", ROOT / "examples/README.md", *(ROOT / "docs").rglob("*.md")]
    told = [f"{path.relative_to(ROOT)}: {one}" for path in pages for one in of_document(path)]
    modules = (ROOT / "tam_calibration").rglob("*.py")
    messages = [f"{path.relative_to(ROOT)}: {one}" for path in modules for one in of_messages(path)]
    print("\n".join(told + messages * ("--messages" in sys.argv)))
    print(f"{len(told)} shortcomings in documents, {len(messages)} in messages")
    sys.exit(bool(told) or len(messages) > MOST_MESSAGES)
