"""Which modules ``mutants.py`` changes, where, and which tests should fail then."""

import random
import re
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).parents[1]
PACKAGE = "tam_calibration"
ROOMS = ("core", "fit", "gap", "live", "localization")
SAMPLE = 12  # mutants of a module: all together are some ten thousand

OPERATORS = re.compile(
    "NumberReplacer|AddNot|Replace(True|False|And|Or)With|ZeroIteration|Replace(Break|Continue)|UnaryOperator_Delete"
    "|BinaryOperator_(Add_Sub|Sub_Add|Mul_Div|Div_Mul|Pow_Mul|FloorDiv_Mul|Mod_Mul|BitAnd_BitOr)"
    "|ComparisonOperator_(Lt_GtE|GtE_Lt|Gt_LtE|LtE_Gt|Eq_NotEq|NotEq_Eq|Is_IsNot|IsNot_Is)"
)
"""Those of cosmic-ray that may live or die: a shift of bits of a float dies wherever it runs, < for <= of one never."""

EQUIVALENT = re.compile(r"^\s*@|reshape\(.*-¦|¦\d[\d.]*e\d|¦[\d_]{4,}|(^|[(,])\s*¦\*,")
"""Lines, with ¦ in front of the mutant, where it changes nothing: how a class that nobody compares is compared; any
negative number lets numpy find a size; one more than a thousand is as good a limit; a signature is no product."""

IGNORED = "test_constants.py"
"""Compares numbers in the code with those on a page: it would kill any mutant of a constant, and proves nothing."""


@dataclass(frozen=True)
class Mutant:
    """A module as room/name, the line before and after the change in words, and the source with it."""

    module: str
    change: str
    source: str


def modules_of(names: list[str]) -> list[str]:
    """Return those of rooms and modules that are asked for, as room/name."""
    files = (path for room in ROOMS for path in sorted((ROOT / PACKAGE / room).glob("[!_]*.py")))
    found = [f"{path.parent.name}/{path.stem}" for path in files]
    return [one for one in found if one in names or one.split("/")[0] in names]


def changed_since(commit: str) -> dict[str, set[int]] | None:
    """Return the modules that have changed since a commit, with their new lines; None where the clone lacks it."""
    command = ["git", "diff", "--unified=0", "--no-prefix", commit, "--", PACKAGE]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    changed: dict[str, set[int]] = {}
    for line in told.stdout.splitlines():
        if file := re.match(rf"\+\+\+ {PACKAGE}/(.*)\.py$", line):
            lines = changed.setdefault(file[1], set())
        elif part := re.match(r"@@ -\S+ \+(\d+),?(\d*) @@", line):
            lines |= set(range(int(part[1]), int(part[1]) + int(part[2] or 1)))
    return None if told.returncode else {one: changed[one] for one in modules_of(list(changed))}


@cache
def tests_of(module: str, is_nearest: bool = False) -> list[str]:
    """Return the test files of a module, the nearest first, or these alone: of its users' users where none are."""
    room, name = module.split("/")
    files = sorted(path for path in (ROOT / "test" / room).glob("test_*.py") if path.name != IGNORED)
    is_named = re.compile(_named(room, name)).search
    mirrored = {path: path.stem.removeprefix("test_") for path in files}
    users = {name} | _users_of(room, {name})
    while not (near := [path for path in files if mirrored[path] in users or is_named(path.read_text("utf-8"))]):
        users, before = users | _users_of(room, users), users
        if users == before:
            break

    def distance(path: Path) -> int:
        return 0 if mirrored[path] == name else 1 if is_named(path.read_text("utf-8")) else 2

    near = sorted(near or files, key=distance)
    return [str(path.relative_to(ROOT)) for path in near if not is_nearest or distance(path) == distance(near[0])]


def _users_of(room: str, names: set[str]) -> set[str]:
    """Return the modules of a room that import one of some names."""
    named = re.compile("|".join(_named(room, name) for name in names))
    return {path.stem for path in (ROOT / PACKAGE / room).glob("*.py") if named.search(path.read_text("utf-8"))}


def _named(room: str, name: str) -> str:
    return rf"\b{room}\.{name} import|\b{room} import .*\b{name}\b"


def mutants_of(module: str, within: set[int] | None = None, most: int = SAMPLE) -> list[Mutant]:
    """Return some mutants of a module, or of some lines of it, by chance with a fixed seed."""
    source = (ROOT / PACKAGE / f"{module}.py").read_text("utf-8")
    lines, nodes = source.splitlines(), list(ast_nodes(get_ast(source)))
    found = []
    for name in filter(OPERATORS.search, operator_names()):
        operator = get_operator(name)()
        places = (start for node in nodes for start, _ in operator.mutation_positions(node))
        for occurrence, (line, column) in enumerate(places):
            is_asked = within is None or line in within
            if is_asked and not EQUIVALENT.search(f"{lines[line - 1][:column]}¦{lines[line - 1][column:]}"):
                found.append((operator, occurrence, line - 1))
    chosen = random.Random(module).sample(found, min(SAMPLE, len(found)))[:most]
    mutants = [(mutate_code(source, operator, occurrence), line) for operator, occurrence, line in chosen]
    return [
        Mutant(module, f"{module}: {lines[at].strip()} → {code.splitlines()[at].strip()}", code) for code, at in mutants
    ]
