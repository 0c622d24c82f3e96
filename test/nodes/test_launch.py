"""The launch file, as far as it can be checked where ROS 2 launch is not installed."""

import ast
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from tam_calibration.nodes import start

ROOT = Path(__file__).parents[2]
LAUNCH_FILE = ROOT / "launch" / "tam.launch.py"


class Recorded(SimpleNamespace):
    """Stands for any action or substitution: keeps what it was made with."""

    def __init__(self, *positional, **named):
        super().__init__(positional=positional, **named)

    def perform(self, context):
        """Return the value of a launch argument, as LaunchConfiguration does."""
        return context[self.positional[0]]


@pytest.fixture
def launch_file(monkeypatch):
    """Return the names of the launch file, run with stand-ins for the launch packages."""
    names = {
        "launch": ["LaunchContext", "LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "OpaqueFunction"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
    }
    for module, members in names.items():
        stand_in = ModuleType(module)
        for member in members:
            setattr(stand_in, member, type(member, (Recorded,), {}))
        monkeypatch.setitem(sys.modules, module, stand_in)
    return runpy.run_path(str(LAUNCH_FILE))


def started(launch_file, **given):
    """Return the nodes that the launch file starts with some arguments given, by name."""
    actions = launch_file["generate_launch_description"]().positional[0]
    defaults = {action.positional[0]: action.default_value for action in actions if hasattr(action, "default_value")}
    [opaque] = [action for action in actions if hasattr(action, "function")]
    return {node.name: node for node in opaque.function(defaults | given)}


def test_nodes_are_the_entry_points(launch_file):
    """Executables, names and modules of the nodes are the same everywhere."""
    nodes = started(launch_file)
    assert list(nodes) == ["collector", "calibrator", "corrector", "localizer"]
    setup = ast.unparse(ast.parse((ROOT / "setup.py").read_text()))
    for name, node in nodes.items():
        assert (node.package, node.executable) == ("tam_calibration", name)
        assert f"{name} = {{NAME}}.nodes.start:{name}" in setup
        assert callable(getattr(start, name))


def test_arguments_become_parameters_only_where_given(launch_file):
    """What is not given leaves the file of parameters in force; each node gets what it knows."""
    nodes = started(
        launch_file,
        params_file="p.yaml",
        array_file="a.yaml",
        map_file="m.yaml",
        calibration_file="c.yaml",
        namespace="auv",
    )
    assert nodes["collector"].parameters == [
        "p.yaml",
        {"use_sim_time": False, "array_file": "a.yaml", "map_file": "m.yaml"},
    ]
    assert "map_file" not in nodes["calibrator"].parameters[1]
    assert nodes["calibrator"].parameters[1]["calibration_file"] == "c.yaml"
    assert "calibration_file" not in nodes["corrector"].parameters[1]
    assert {node.namespace for node in nodes.values()} == {"auv"}
    assert started(launch_file)["collector"].parameters == [{"use_sim_time": False}]


def test_every_node_loads_the_calibration_that_is_there(launch_file, tmp_path):
    """The collector has none; a file that the calibrator will write is no reason for the others not to start."""
    path = tmp_path / "calibration.yaml"

    def loading():
        nodes = started(launch_file, calibration_file=str(path))
        return [name for name, node in nodes.items() if node.parameters[0].get("calibration_file") == str(path)]

    assert loading() == ["calibrator"]
    path.write_text("")
    assert loading() == ["calibrator", "corrector", "localizer"]


def test_nodes_are_started_again(launch_file):
    """Unless somebody wants to see why one ended."""
    assert all(node.respawn and node.respawn_delay == 2.0 for node in started(launch_file).values())
    assert not any(node.respawn for node in started(launch_file, respawn="false").values())


def test_nothing_is_set_for_what_is_launched_later(launch_file):
    """The nodes see to their settings themselves: the environment of other nodes of the robot stays as it was."""
    actions = launch_file["generate_launch_description"]().positional[0]
    assert {type(action).__name__ for action in actions} == {"DeclareLaunchArgument", "OpaqueFunction"}
    assert not any(hasattr(node, "additional_env") for node in started(launch_file).values())
