"""Start all nodes: `ros2 launch tam_calibration tam.launch.py array_file:=A.yaml`."""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

NODES = ("collector", "calibrator", "corrector", "localizer")

ARGUMENTS = {
    "namespace": ("", "Namespace of the nodes and of their relative topics."),
    "params_file": ("", "ROS parameters of the nodes."),
    "array_file": ("", "Array YAML; empty for the cross of 0.5 m."),
    "map_file": ("", "Map YAML: topics of sensors and channels; empty for tam_1/magnetic_field and so on."),
    "calibration_file": ("", "Calibration YAML: loaded by every node where it exists, written by calibrator/save."),
    "use_sim_time": ("false", "Whether the nodes' clock is /clock."),
    "respawn": ("true", "Whether a node that ends is started again after 2 s."),
}

_RESPAWN_DELAY_S = 2.0
"""Longer than a node that ended takes to leave the graph, short against the silence that a mission bears."""


def generate_launch_description() -> LaunchDescription:
    """Return the nodes with the arguments that are given."""
    declared = [
        DeclareLaunchArgument(key, default_value=default, description=text)
        for key, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes; an argument that is not given leaves what the file of parameters says."""
    given = {key: value for key in ARGUMENTS if (value := LaunchConfiguration(key).perform(context))}
    return [
        Node(
            package="tam_calibration",
            executable=name,
            name=name,
            namespace=given.get("namespace", ""),
            parameters=[*([given["params_file"]] if "params_file" in given else []), _parameters(name, given)],
            respawn=given["respawn"].lower() == "true",
            respawn_delay=_RESPAWN_DELAY_S,
        )
        for name in NODES
    ]


def _parameters(name: str, given: dict[str, str]) -> dict[str, str | bool]:
    """Return what the arguments say to a node; a calibration that is not there yet is the calibrator's alone."""
    keys = ["array_file", "map_file"] if name == "collector" else ["array_file"]
    if name == "calibrator" or (name != "collector" and Path(given.get("calibration_file", "")).is_file()):
        keys.append("calibration_file")
    is_simulated = given["use_sim_time"].lower() == "true"
    return {"use_sim_time": is_simulated, **{key: given[key] for key in keys if key in given}}
