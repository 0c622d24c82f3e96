"""How the package is cut up: modules, names and documented parameters; of this checkout, or of the folder of a package.

python benchmarks/structure.py [PACKAGE FOLDER]
"""

import ast
import sys
from collections import Counter
from pathlib import Path
from statistics import median

SMALL = 60
"""Lines below which a module is small."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def modules_of(package):
    """Return the source of each module of a package by its path in it."""
    return {path.relative_to(package): path.read_text(encoding="utf-8") for path in sorted(package.rglob("*.py"))}


def imported(tree, name, modules):
    """Return the paths of the package's modules that a module imports, anywhere in it."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
    parts = [each.split(".")[1:] for each in names if each.split(".")[0] == name]
    tried = {path for part in parts if part for path in (Path(*part).with_suffix(".py"), Path(*part, "__init__.py"))}
    return tried & set(modules)


def is_public(name):
    """Whether a name has no underscore in front."""
    return not name.startswith("_")


def top_level_names(tree):
    """Return the public functions, classes and constants of a module."""
    names = [node.name for node in tree.body if isinstance(node, Function | ast.ClassDef)]
    for node in tree.body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        names += [each.id for target in targets for each in ast.walk(target) if isinstance(each, ast.Name)]
    return {name for name in names if is_public(name)}


def public_functions(tree):
    """Return the public functions of a module and the public methods of its public classes."""
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef) and is_public(node.name)]
    nodes = [*tree.body, *(node for each in classes for node in each.body)]
    return [node for node in nodes if isinstance(node, Function) and is_public(node.name)]


def argument_count(function):
    """Return the number of arguments that a caller gives."""
    given = function.args
    names = [
        each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg) if each
    ]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def main():
    """Print the counts."""
    package = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1] / "tam_calibration").resolve()
    modules = modules_of(package)
    trees = {path: ast.parse(text) for path, text in modules.items()}
    lines = {path: len(text.splitlines()) for path, text in modules.items()}
    importers = Counter(
        other for path, tree in trees.items() for other in imported(tree, package.name, modules) - {path}
    )
    small = [path for path in modules if path.name != "__init__.py" and lines[path] < SMALL and importers[path] == 1]
    classes = Counter(node.name for tree in trees.values() for node in tree.body if isinstance(node, ast.ClassDef))
    asked = [each for tree in trees.values() for each in public_functions(tree) if argument_count(each) >= 2]
    told = [each for each in asked if "Parameters\n---" in (ast.get_docstring(each) or "")]
    twice = sorted(name for name, count in classes.items() if count > 1)
    print(f"modules                                      {len(modules)}")
    print(f"lines in all, median                         {sum(lines.values())}, {median(lines.values()):g}")
    print(f"modules under {SMALL} lines with one importer     {len(small)}")
    print(f"public top-level names                       {sum(len(top_level_names(tree)) for tree in trees.values())}")
    print(f"class names used twice                       {len(twice)} {' '.join(twice)}")
    print(f"functions of two arguments with Parameters   {len(told)} of {len(asked)}, {len(told) / len(asked):.0%}")


if __name__ == "__main__":
    main()
