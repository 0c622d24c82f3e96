"""Start all nodes: `ros2 launch tam_calibration tam.launch.py array_file:=A.yaml`."""

from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from tam_calibration.files.configuration import configuration_folder

NODES = ("collector", "calibrator", "corrector", "localizer")

ARGUMENTS = {
    "namespace": ("", "Namespace of the nodes and of their relative topics."),
    "params_file": ("", "ROS parameters of the nodes."),
    "array_file": ("", "Array YAML; empty for the cross of 0.5 m."),
    "calibration_file": ("", "Calibration YAML: loaded where it exists, written by calibrator/save."),
    "use_sim_time": ("false", "Whether the nodes' clock is /clock."),
}


def generate_launch_description() -> LaunchDescription:
    """Return the nodes with the arguments that are given."""
    name = "FASTRTPS_DEFAULT_PROFILES_FILE"
    profile = str(configuration_folder() / "fastdds.xml")
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(key, default_value=each[0], description=each[1])
                for key, each in ARGUMENTS.items()
            ),
            SetEnvironmentVariable(name, EnvironmentVariable(name, default_value=profile)),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes; an argument that is not given leaves what the file of parameters says."""
    given = {key: value for key in ARGUMENTS if (value := LaunchConfiguration(key).perform(context))}
    shared = {"use_sim_time": given["use_sim_time"].lower() == "true"}
    shared |= {key: given[key] for key in ("array_file",) if key in given}
    own = {"calibrator": {key: given[key] for key in ("calibration_file",) if key in given}}
    return [
        Node(
            package="tam_calibration",
            executable=name,
            name=name,
            namespace=given.get("namespace", ""),
            parameters=[*([given["params_file"]] if "params_file" in given else []), shared | own.get(name, {})],
        )
        for name in NODES
    ]
