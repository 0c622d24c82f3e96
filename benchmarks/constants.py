"""The numeric constants of the diagnosis, as they stand in its code: value, reason, and what kind of number each is.

The kind follows from a rule, in this order, and not from an opinion:

- ``label``: negative whole numbers, and numbers named by strings that are all 0 or ±1, which stand for a thing;
- ``tolerance``: within 1e-4 of 0 or 1 and without a unit at the end of its name: what rounding may do;
- ``decision``: one number, or one for each name, that stands in a comparison with other than zero, itself or by way of
  the local name or of the function that is made of it; but not whole numbers from 200 on, which are sizes of the work;
- ``basis``: several numbers: orders, grids, time constants to try;
- ``size``: another whole number: samples, rounds, blocks;
- ``factor``: any other number, which enters a formula.
"""

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

import tam_calibration

PACKAGE = Path(tam_calibration.__file__).parent
ROOMS = ("gap", "effects", "comparison", "core")
KINDS = ("decision", "tolerance", "size", "factor", "basis", "label")

_ROUNDING = 1e-4
"""A number nearer to 0 or to 1 is a tolerance of numerics, and decides nothing."""

_WORK = 200
"""A whole number as large says how much is worked through at a time, and decides nothing."""

_UNITS = ("_T", "_A", "_K", "_S", "_MIN", "_RAD", "_HZ")


@dataclass(frozen=True)
class Constant:
    """A constant: its module and name, value, the docstring under it, kind, and whether any code reads it."""

    module: str
    name: str
    value: Any
    reason: str
    kind: str
    is_read: bool

    @property
    def key(self) -> str:
        """Room, file and name."""
        return f"{self.module.removeprefix('tam_calibration.')}.{self.name}"

    @property
    def told(self) -> str:
        """Its value as people read it."""
        return _in_words(self.value)

    def scaled(self, factor: float) -> Any:
        """Return the value times a factor; of a part between 0.9 and 1, what it lacks of 1 is scaled."""
        return _scaled(self.value, factor)


def find_constants() -> list[Constant]:
    """Return the constants of the diagnosis by room, file and line."""
    trees = {module_of(path): ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}
    own = {name: tree for room in ROOMS for name, tree in trees.items() if name.split(".")[1] == room}
    compared = _compared(own)
    read = {(module, name) for module, tree in trees.items() for name in _names(tree)}
    users_of = _users(trees)
    constants = []
    for module, tree in own.items():
        for name, reason in _assigned(tree):
            value = getattr(import_module(module), name)
            if _is_numeric(value):
                users = {(user, name) for user in users_of[module, name]}
                kind = _kind(name, value, bool(users & compared))
                constants.append(Constant(module, name, value, reason, kind, bool(users & read)))
    return constants


def modules_with(constant: Constant) -> Iterator[ModuleType]:
    """Yield the modules that have a constant: its own, and those that import it by its name."""
    trees = {module_of(path): ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}
    yield from map(import_module, _users(trees)[constant.module, constant.name])


def module_of(path: Path) -> str:
    """Return the name of the module in a file of the package."""
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)


def _users(trees: Mapping[str, ast.Module]) -> dict[tuple[str, str], list[str]]:
    """Return the module that assigns a name and those that import it, by module and name."""
    users = {(module, name): [module] for module, tree in trees.items() for name, _ in _assigned(tree)}
    for user, tree in trees.items():
        for one in tree.body:
            if isinstance(one, ast.ImportFrom):
                for alias in one.names:
                    users.get((one.module or "", alias.name), []).append(user)
    return users


def unnamed_in_comparisons() -> int:
    """Return how many numbers other than 0, ±1, 2 and 3 are compared with no name."""
    trees = [ast.parse(path.read_text()) for room in ROOMS for path in (PACKAGE / room).rglob("*.py")]
    numbers = [
        one.value
        for tree in trees
        for comparison in ast.walk(tree)
        if isinstance(comparison, ast.Compare)
        for one in ast.walk(comparison)
        if isinstance(one, ast.Constant) and isinstance(one.value, int | float) and not isinstance(one.value, bool)
    ]
    return sum(number not in (0, 1, 2, 3) for number in numbers)


def _assigned(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Yield the names that a module assigns and the docstring under them, which lines without a gap share."""
    for index, node in enumerate(tree.body):
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            reason = _docstring_after(tree.body, index)
            for target in (one for whole in targets for one in ast.walk(whole)):
                if isinstance(target, ast.Name) and isinstance(target.ctx, ast.Store):
                    yield target.id, reason


def _docstring_after(body: list[ast.stmt], index: int) -> str:
    for before, node in zip(body[index:], body[index + 1 :], strict=False):
        if node.lineno != (before.end_lineno or 0) + 1:
            return ""
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            return " ".join(node.value.value.split())
        if not isinstance(node, ast.Assign | ast.AnnAssign):
            return ""
    return ""


def _names(node: ast.AST) -> set[str]:
    """Return the names that are read in a part of the code."""
    loads = (one for one in ast.walk(node) if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Load))
    return {one.id for one in loads}


def _compared(trees: Mapping[str, ast.Module]) -> set[tuple[str, str]]:
    """Return the modules and names that stand in comparisons."""
    functions = [
        (module, one) for module, tree in trees.items() for one in ast.walk(tree) if isinstance(one, ast.FunctionDef)
    ]
    returned: dict[str, set[tuple[str, str]]] = {}
    for module, function in functions:
        for one in ast.walk(function):
            if isinstance(one, ast.Return) and one.value is not None:
                returned.setdefault(function.name, set()).update((module, name) for name in _names(one.value))
    found: set[tuple[str, str]] = set()
    for module, function in functions:
        made = _made(function)
        for one in ast.walk(function):
            if isinstance(one, ast.Compare) and _is_threshold(one):
                names = _names(one).union(*(made.get(name, set()) for name in _names(one)))
                found |= {(module, name) for name in names}.union(*(returned.get(name, set()) for name in names))
    return found


def _is_threshold(one: ast.Compare) -> bool:
    """Whether a comparison has a size: it asks for more than the sign, and not what is in a set or the same object."""
    sides = [one.left, *one.comparators]
    is_order = not any(isinstance(operator, ast.In | ast.NotIn | ast.Is | ast.IsNot) for operator in one.ops)
    return is_order and not any(isinstance(side, ast.Constant) and side.value == 0 for side in sides)


def _made(function: ast.FunctionDef) -> dict[str, set[str]]:
    """Return of each local name the names from which it is made."""
    made: dict[str, set[str]] = {}
    for one in ast.walk(function):
        if isinstance(one, ast.Assign):
            for target in one.targets:
                if isinstance(target, ast.Name):
                    made.setdefault(target.id, set()).update(_names(one.value))
    return made


def _is_numeric(value: Any) -> bool:
    if isinstance(value, dict):
        return bool(value) and all(_is_numeric(one) for one in value.values())
    if isinstance(value, tuple | list):
        return bool(value) and all(_is_numeric(one) for one in value)
    return isinstance(value, int | float | np.ndarray) and not isinstance(value, bool)


def _kind(name: str, value: Any, is_compared: bool) -> str:
    is_sign = isinstance(value, Mapping) and all(np.isin(one, (-1, 0, 1)).all() for one in value.values())
    if is_sign or (isinstance(value, int) and value < 0):
        return "label"
    is_tiny = isinstance(value, float) and min(abs(value), abs(1 - value)) < _ROUNDING
    if is_tiny and not name.endswith(_UNITS):
        return "tolerance"
    is_work = isinstance(value, int) and value >= _WORK
    values = list(value.values()) if isinstance(value, Mapping) else [value]
    if is_compared and not is_work and all(isinstance(one, int | float) for one in values):
        return "decision"
    return "size" if isinstance(value, int) else "factor" if isinstance(value, float) else "basis"


def _scaled(value: Any, factor: float) -> Any:
    if isinstance(value, Mapping):
        return {name: _scaled(one, factor) for name, one in value.items()}
    if isinstance(value, tuple | list):
        return type(value)(_scaled(one, factor) for one in value)
    if isinstance(value, int):
        return max(round(value * factor), 1) if value > 0 else value
    if isinstance(value, float) and 0.9 <= value < 1:
        return 1 - (1 - value) * factor
    return value * factor


def _in_words(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name}: {_in_words(one)}" for name, one in value.items())
    if isinstance(value, tuple | list):
        return "(" + ", ".join(map(_in_words, value)) + ")"
    if isinstance(value, float):
        return f"{value:.4g}" if not 0.999 < value < 1 else f"1 − {1 - value:.2g}"
    if hasattr(value, "largest"):
        return f"{value.largest:.4g} {value.unit}"
    return str(value) if isinstance(value, int) else f"array {value.shape}"
