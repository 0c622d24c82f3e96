"""The parameters of the nodes: declared with meaning and bounds, and those that several nodes share."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from tam_calibration.files import read_array
from tam_calibration.files.configuration import configuration_folder
from tam_calibration.messages.point_cloud import FRAME_ID as DEFAULT_FRAME_ID
from tam_calibration.model.array import Array


@dataclass(frozen=True)
class Rule:
    """A parameter: its name, default, meaning (SI), bounds or choices, and whether it may change at run time."""

    name: str
    default: bool | int | float | str
    description: str
    bounds: tuple[float, float] | None = None
    choices: Sequence[str] = ()
    read_only: bool = True

    def descriptor(self) -> ParameterDescriptor:
        """Return the rule as ROS tools show it."""
        descriptor = ParameterDescriptor(description=self.description, read_only=self.read_only)
        if self.choices:
            descriptor.additional_constraints = f"one of: {', '.join(self.choices)}"
        if self.bounds and isinstance(self.default, int):
            descriptor.integer_range = [
                IntegerRange(from_value=int(self.bounds[0]), to_value=int(self.bounds[1]), step=1)
            ]
        elif self.bounds:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(self.bounds[0]), to_value=float(self.bounds[1]))
            ]
        return descriptor


ARRAY_FILE = Rule("array_file", "", "Path of the array YAML; empty for the cross with a baseline of 0.5 m.")
FRAME_ID = Rule("frame_id", DEFAULT_FRAME_ID, "Frame of all that is published: the array frame.")


def array_of(node: Node) -> Array:
    """Return the array that a node's parameter ``array_file`` names.

    Raises
    ------
    InputError
        When the file cannot be used.
    """
    path: str = node.get_parameter(ARRAY_FILE.name).value
    return read_array(Path(path) if path else configuration_folder() / "cross.yaml")
