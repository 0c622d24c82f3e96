"""The parameters of the nodes: declared with meaning and bounds, those that several share, and the array they name."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from tam_calibration.files.text_files import configuration_folder
from tam_calibration.messages.cdr import STATIC_TRANSFORMS, TransformTree
from tam_calibration.messages.point_cloud import FRAME_ID
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.units import FloatArray
from tam_calibration.nodes.session import PATIENCE_S
from tam_calibration.nodes.topics import leave, waiting
from tam_calibration.recordings import read_array


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
        if self.bounds:
            least, most = map(type(self.default), self.bounds)
            if isinstance(self.default, int):
                descriptor.integer_range = [IntegerRange(from_value=least, to_value=most, step=1)]
            else:
                descriptor.floating_point_range = [FloatingPointRange(from_value=least, to_value=most)]
        return descriptor

    def require_choice(self, value: object) -> None:
        """Check that a value is one of the choices.

        Raises
        ------
        InputError
            When it is none.
        """
        if value not in self.choices:
            raise InputError(f"{value} is not one of: {', '.join(self.choices)}")


SHARED = (
    Rule("array_file", "", "Path of the array YAML; empty for the cross with a baseline of 0.5 m."),
    Rule("frame_id", FRAME_ID, "Frame of all that is published: the array frame."),
)
"""Parameters of every node."""

REAL_TIME = Rule("real_time", True, "Whether the process comes before all that is not real-time, where its user may.")


_OF_ROS = ("use_sim_time", "start_type_description_service")
_QOS_OVERRIDES = "qos_overrides."
_QOS_CHOICES = {
    "durability": ("volatile", "transient_local", "system_default"),
    "history": ("keep_last", "keep_all", "system_default"),
    "reliability": ("reliable", "best_effort", "system_default"),
}
_DEEPEST = 1_000_000
"""Messages that a queue contains at most: a quarter of an hour of 1000 Hz."""


def unknown_parameters(node: Node, rules: Sequence[Rule]) -> dict[str, str]:
    """Forget what a node was given and does not know, and return a sentence on each, with the nearest known name.

    Parameters
    ----------
    node : Node
        That has declared all it was given.
    rules : sequence of Rule
        The parameters that it knows, in addition to those of ROS.

    Returns
    -------
    dict of str to str
        Sentences by the names of the parameters.
    """
    remarks = {}
    for name in node.get_parameters_by_prefix(""):
        known = [rule.name for rule in rules] + list(_OF_ROS)
        if name.startswith(_QOS_OVERRIDES):
            known = [f"{name.rpartition('.')[0]}.{policy}" for policy in ("depth", *_QOS_CHOICES)]
        if name not in known:
            node.undeclare_parameter(name)
            near = "".join(f": is {each} meant?" for each in get_close_matches(name, known, 1))
            remarks[name] = f"the parameter {name} is not known here and without effect{near}"
    return remarks


def require_quality(node: Node) -> None:
    """Check the quality of service that a node was given (``qos_overrides.…``).

    Parameters
    ----------
    node : Node
        That has declared all it was given.

    Raises
    ------
    InputError
        When a value is none of its policy.
    """
    for name in node.get_parameters_by_prefix(_QOS_OVERRIDES.rstrip(".")):
        value = node.get_parameter(f"{_QOS_OVERRIDES}{name}").value
        choices = _QOS_CHOICES.get(name.rpartition(".")[2])
        if choices is None:
            is_right, right = type(value) is int and 1 <= value <= _DEEPEST, f"an integer from 1 to {_DEEPEST}"
        else:
            is_right, right = str(value).lower() in choices, f"one of {', '.join(choices)}"
        if not is_right:
            raise InputError(f"the parameter {_QOS_OVERRIDES}{name} must be {right}, not {quoted(value)}")


def declare(node: Node, rules: Sequence[Rule]) -> None:
    """Declare parameters by their rules, with the values that a node was given; a whole number is a number.

    Parameters
    ----------
    node : Node
        That has declared all it was given.
    rules : sequence of Rule
        Of all its parameters.

    Raises
    ------
    ParameterException
        When a value has the wrong type or is out of bounds.
    """
    for rule in rules:
        value, is_whole = rule.default, False
        if node.has_parameter(rule.name):  # as given, without its rule
            given = node.get_parameter(rule.name).value
            node.undeclare_parameter(rule.name)
            if is_whole := isinstance(value, float) and type(given) is int:
                value = float(given)
        node.declare_parameter(rule.name, value, rule.descriptor(), ignore_override=is_whole)


_LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""As tf2 publishes and hears static transforms; each of their publishers has a message."""


class StaticTransforms:
    """The static transforms towards the array's frame, which are waited for.

    Parameters
    ----------
    node : Node
        That hears them.
    array_frame : str
        Name of the array's frame.

    Attributes
    ----------
    subscription : Subscription or None
        Once a frame was looked up.
    """

    def __init__(self, node: Node, array_frame: str) -> None:
        self._node, self._array_frame = node, array_frame
        self._tree = TransformTree()
        self.subscription: Subscription | None = None

    def look_up(self, frame: str) -> tuple[FloatArray, FloatArray]:
        """Return the origin (3,) of a frame, metres, and the quaternion (4,) of its axes in the array's frame.

        Raises
        ------
        InputError
            When the messages of tf are not installed, or no transform comes.
        """
        limit = time.monotonic() + PATIENCE_S
        while (pose := self._tree.pose(frame, self._array_frame)) is None:
            if time.monotonic() > limit:
                raise InputError(
                    f"{STATIC_TRANSFORMS} leads from {self._array_frame} to no {frame}: publish that transform, or "
                    "state positions_m and rotations_deg in the array file"
                )
            self.subscription = self.subscription or self._subscribe()
            for message in waiting(self.subscription):
                self._tree.add(message)
            # Short against the start of a node.
            time.sleep(0.02)
        return pose

    def _subscribe(self) -> Subscription:
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            raise InputError(
                "it leaves positions to tf, and tf2_msgs is not installed: apt install ros-jazzy-tf2-msgs, or state "
                "positions_m and rotations_deg"
            ) from None
        return self._node.create_subscription(TFMessage, STATIC_TRANSFORMS, leave, _LATCHED, raw=True)


def array_name(node: Node) -> str:
    """Return the name of the file of a node's array, without what follows the last dot."""
    return _array_path(node).stem


def array_of(node: Node) -> Array:
    """Return the array that a node's parameter ``array_file`` names, placed by tf where the file leaves that to tf.

    Raises
    ------
    InputError
        When the file cannot be used, or tf does not tell what it leaves to it.
    """
    transforms = StaticTransforms(node, node.get_parameter("frame_id").value)
    try:
        array = read_array(_array_path(node), transforms.look_up)
    finally:
        if transforms.subscription is not None:
            node.destroy_subscription(transforms.subscription)
    if transforms.subscription is not None:
        places = (f"sensor {sensor} at {x:g} {y:g} {z:g} m" for sensor, (x, y, z) in enumerate(array.positions_m, 1))
        node.get_logger().info(f"{STATIC_TRANSFORMS} states where the sensors are: {', '.join(places)}")
    return array


def _array_path(node: Node) -> Path:
    path: str = node.get_parameter("array_file").value
    return Path(path) if path else configuration_folder() / "cross.yaml"
