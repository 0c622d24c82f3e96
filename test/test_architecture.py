"""The pages for those who change the code name what is there."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "tam_calibration"
ARCHITECTURE = (ROOT / "docs" / "development" / "architecture.md").read_text()
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text()
GLOSSARY = (ROOT / "docs" / "reference" / "glossary.md").read_text()


def defined(path):
    """Return the names of the functions, methods and classes of a file."""
    kinds = ast.FunctionDef | ast.ClassDef
    return {node.name for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, kinds)}


@pytest.mark.parametrize("place", sorted(set(re.findall(r"`(\w+/\w+\.py):(\w+)`", ARCHITECTURE))))
def test_every_function_on_the_ways_is_there(place):
    """In the file that the page names."""
    file, name = place
    assert name in defined(PACKAGE / file)


def test_the_rooms_are_those_of_the_package():
    """Every room has its line, and no other."""
    rooms = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))
    assert sorted(re.findall(r"^\| `(\w+)` \|", ARCHITECTURE, re.MULTILINE)) == rooms


@pytest.mark.parametrize(
    "text", [CONTRIBUTING, GLOSSARY, ARCHITECTURE], ids=["contributing", "glossary", "architecture"]
)
def test_every_file_that_is_named_is_there(text):
    """From the top of the repository, or within the package; NAME stands for what is added."""
    named = {file for file in re.findall(r"`([\w/]+\.(?:py|md|yaml))`", text) if "NAME" not in file and "/" in file}
    assert named
    missing = [file for file in named if not ((ROOT / file).exists() or (PACKAGE / file).exists())]
    assert missing == []


def test_the_glossary_is_in_order():
    """Of the alphabet."""
    words = re.findall(r"^\*\*(.+?)\*\*", GLOSSARY, re.MULTILINE)
    assert len(words) > 20 and words == sorted(words, key=str.casefold)
