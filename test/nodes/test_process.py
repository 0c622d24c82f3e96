"""A node's process: how it ends, and what it refuses to begin with."""

import signal
import subprocess
import sys
from importlib import import_module

import pytest
import yaml

from tam_calibration.files.configuration import configuration_folder

NODES = ("collector", "calibrator", "corrector", "localizer")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_every_node_well(bench, number):
    """SIGINT and SIGTERM end a node with exit code 0 and nothing on its output."""
    children = bench.start_nodes(**{name: {} for name in NODES})
    assert {name: children.end_one(name, number) for name in NODES} == dict.fromkeys(NODES, 0)
    assert [children.log(name) for name in NODES] == [""] * len(NODES)


def test_unusable_parameter_ends_the_node_with_a_sentence(ros_domain):
    """An unknown or unusable parameter ends the node with exit code 2 and one sentence."""
    refused = {
        ("collector", "tolerence_s:=0.001"): "collector has no parameter tolerence_s: it knows array_file",
        ("collector", "tolerance_s:=1"): "of type 'INTEGER', expecting type 'DOUBLE': tolerance_s",
        ("collector", "silence_s:=-1.0"): "out of range Min: 0.1",
        ("collector", "scalar_type:=std_msgs/Int32"): "is not one of: sensor_msgs/MagneticField, std_msgs/Float64",
        ("calibrator", "method:=magic"): "is not one of: maximum_likelihood",
        ("calibrator", "array_file:=/array.yaml"): "/array.yaml",
        ("corrector", "calibration_file:=/calibration.yaml"): "/calibration.yaml",
        ("localizer", "index:=0.0"): "Max: 10.0, value: 0.0: index",
        ("localizer", "regional:=here"): "a place must be LAT,LON,DATE",
    }
    processes = {
        sentence: subprocess.Popen(
            [sys.executable, "-m", "tam_calibration.nodes.start", name, "--ros-args", "-p", parameter],
            stderr=subprocess.PIPE,
            text=True,
        )
        for (name, parameter), sentence in refused.items()
    }
    for sentence, process in processes.items():
        _, errors = process.communicate(timeout=20)
        assert process.returncode == 2, sentence
        assert errors.startswith("tam: ") and sentence in errors and len(errors.splitlines()) == 1


def test_unusable_arguments_end_the_node_with_a_sentence(ros_domain):
    """A file of parameters that is not there is not a traceback."""
    arguments = ["-m", "tam_calibration.nodes.start", "collector", "--ros-args", "--params-file", "/nowhere.yaml"]
    ended = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, timeout=20)
    assert ended.returncode == 2
    assert "tam: the arguments of ROS cannot be used" in ended.stderr and "Traceback" not in ended.stderr


def test_shipped_parameters_are_known(bench):
    """Every node takes the shipped file of parameters, which names all its parameters with their defaults."""
    path = configuration_folder() / "tam.yaml"
    commands = {
        name: ["-m", "tam_calibration.nodes.start", name, "--ros-args", "--params-file", str(path)] for name in NODES
    }
    bench.start(commands)
    bench.spin_until(lambda: set(NODES) <= set(bench.node.get_node_names()), "the nodes are seen")
    stated = yaml.safe_load(path.read_text())["/**"]
    for name in NODES:
        rules = import_module(f"tam_calibration.nodes.{name}_node").RULES
        assert stated[name]["ros__parameters"] == {rule.name: rule.default for rule in rules}


def test_namespace_moves_the_topics(bench):
    """Relative names follow the namespace, so that two arrays can live side by side."""
    bench.start({"collector": ["-m", "tam_calibration.nodes.start", "collector", "--ros-args", "-r", "__ns:=/auv"]})
    wanted = {"/auv/tam_1/magnetic_field", "/auv/samples", "/diagnostics"}
    topics = bench.node.get_topic_names_and_types
    bench.spin_until(lambda: wanted <= {name for name, _ in topics()}, "the topics are in the namespace")
