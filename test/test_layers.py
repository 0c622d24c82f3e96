import ast
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "tam_calibration"

LAYERS = (
    ("__main__",),
    ("cli",),
    ("nodes",),
    ("fleet",),
    ("report",),
    ("results",),
    ("recordings",),
    ("files",),
    ("comparison",),
    ("gap", "localization", "live"),
    ("fit", "simulation"),
    ("integrity",),
    ("correction", "sources"),
    ("effects",),
    ("messages",),
    ("core",),
    ("model",),
)
"""The rooms from above to below; a room imports what stands below it."""

RANK = {room: rank for rank, layer in enumerate(LAYERS) for room in layer}
SURROUNDINGS = {
    "__main__",
    "cli",
    "nodes",
    "fleet",
    "report",
    "results",
    "recordings",
    "files",
    "messages",
}
"""The rooms that are not numerics."""

MODULES = {str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py"}


def room(module):
    """Return the room of a module: the first part of its path."""
    return Path(module).parts[0].removesuffix(".py")


@cache
def imports(module):
    """Return the names that a module imports, anywhere in it, each split at its dots."""
    names = set()
    for node in ast.walk(ast.parse((PACKAGE / module).read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return [name.split(".") for name in names]


def libraries(module):
    """Return the top names of all that a module imports."""
    return {name[0] for name in imports(module)}


def own_rooms(module):
    """Return the rooms of the package from which a module imports."""
    return {name[1] for name in imports(module) if name[0] == PACKAGE.name} - {"__version__"}


def own_modules(module):
    """Return the files of the package that a module imports, anywhere in it."""
    paths = [Path(*name[1:]) for name in imports(module) if name[0] == PACKAGE.name]
    tried = [(path, path / "__init__", path.parent, path.parent / "__init__") for path in paths]
    return {next((f"{path}.py" for path in each if f"{path}.py" in MODULES), "__init__.py") for each in tried}


def test_every_room_has_a_layer():
    """A new module or package gets its place in the order before it is used."""
    assert {room(module) for module in MODULES} - set(RANK) == set()


def test_imports_run_downwards_only():
    """A module imports its own room and what stands below it."""
    edges = [(module, room(module), other) for module in MODULES for other in own_rooms(module) - {room(module)}]
    assert [(module, other) for module, here, other in edges if RANK[other] <= RANK[here]] == []


def test_no_import_runs_in_a_circle():
    """The modules can be put in an order in which each imports only those before it."""
    graph = {module: own_modules(module) - {module} for module in MODULES}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the modules


def test_numerics_know_nothing_of_their_surroundings():
    """Models and fits can be used without ROS, files, terminal and pages."""
    foreign = {"rclpy", "rosbags", "click", "rich", "jinja2", "matplotlib"}
    numerics = [module for module in MODULES if room(module) not in SURROUNDINGS]
    used = {module: own_rooms(module) & SURROUNDINGS | libraries(module) & foreign for module in numerics}
    assert {module: names for module, names in used.items() if names} == {}


def test_ros_is_met_in_the_nodes_only():
    """Everything but the nodes runs on a machine without ROS."""
    others = {name for module in MODULES if room(module) != "nodes" for name in libraries(module)}
    assert {
        name for name in others if name in {"rclpy", "std_srvs"} or name.endswith(("_msgs", "_interfaces"))
    } == set()


def test_angles_are_converted_in_units_only():
    """Degrees become radians, and back, in one place."""
    functions = {
        f"{library}.{name}" for library in ("np", "math") for name in ("radians", "degrees", "deg2rad", "rad2deg")
    }
    wrong = []
    for module in MODULES - {"model/units.py"}:
        source = (PACKAGE / module).read_text()
        is_suspect = "degrees=" in source or "np.pi" in source or any(name in source for name in functions)
        for node in ast.walk(ast.parse(source)) if is_suspect else ():
            text = ast.unparse(node) if isinstance(node, ast.Attribute | ast.BinOp | ast.keyword) else ""
            if text in functions or text == "degrees=True" or ("np.pi" in text and "180" in text):
                wrong.append((module, text))
    assert wrong == []


HEAVY = {"scipy", "matplotlib", "rclpy", "rosbags", "zstandard", "pydantic", "pandas", "xarray"}


@pytest.mark.parametrize(
    ("statement", "heavy"),
    [
        ("import tam_calibration", HEAVY | {"numpy"}),
        ("from tam_calibration.cli.main import main; main(['--help'])", HEAVY | {"numpy"}),
        ("from tam_calibration.cli.main import main; main(['calibrate', '--help'])", HEAVY),
    ],
)
def test_start_loads_nothing_heavy(statement, heavy):
    """The package, ``tam --help`` and the help of a command answer at once: they load no library that takes long."""
    code = f"""import atexit, sys
atexit.register(lambda: print("loaded:", *({heavy!r} & set(sys.modules)), file=sys.stderr))
{statement}"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip() == "loaded:"
