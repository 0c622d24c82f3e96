"""What the nodes share: checked parameters, and health in /diagnostics once a second."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from tam_calibration.nodes.parameters import Rule
from tam_calibration.problems import InputError

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For what a late joiner must still get."""

STREAM = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Sensor data; deep enough to bridge ten seconds at 100 Hz."""

RELIABLE_STREAM = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Data between our own nodes, of which none may be lost."""

OK, WARN, ERROR, STALE = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE

_TOPICS_OF_ROS = ("/parameter_events", "/rosout", "/diagnostics")
_PARAMETERS_OF_ROS = ("use_sim_time", "start_type_description_service")


@dataclass(frozen=True)
class Health:
    """What a node says of itself: a level, one sentence and figures."""

    level: bytes
    message: str
    values: Mapping[str, object] = field(default_factory=dict)


class TamNode(Node):
    """A node that refuses parameters it does not know and tells its health.

    Parameters
    ----------
    name : str
        Name of the node.
    rules : sequence of Rule
        All its parameters.

    Raises
    ------
    InputError
        When an unknown parameter is given.
    ParameterException
        When a value has the wrong type or is out of bounds.
    """

    def __init__(self, name: str, rules: Sequence[Rule]) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self._choices = {rule.name: rule.choices for rule in rules if rule.choices}
        self._refuse_unknown([rule.name for rule in rules])
        self.add_on_set_parameters_callback(self._check_choices)
        for rule in rules:
            if self.has_parameter(rule.name):  # as given, without its rule
                self.undeclare_parameter(rule.name)
            self.declare_parameter(rule.name, rule.default, rule.descriptor())
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._publish_health, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def value(self, name: str) -> Any:
        """Return the present value of a parameter."""
        return self.get_parameter(name).value

    @abstractmethod
    def health(self) -> Health:
        """Return the node's health; called once a second."""

    def _refuse_unknown(self, known: Sequence[str]) -> None:
        given = self.get_parameters_by_prefix("")
        unknown = [
            name
            for name in given
            if name not in (*known, *_PARAMETERS_OF_ROS) and not name.startswith("qos_overrides.")
        ]
        if unknown:
            raise InputError(f"{self.get_name()} has no parameter {', '.join(unknown)}: it knows {', '.join(known)}")

    def _check_choices(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            choices = self._choices.get(parameter.name)
            if choices and parameter.value not in choices:
                return SetParametersResult(
                    successful=False, reason=f"{parameter.value} is not one of: {', '.join(choices)}"
                )
        return SetParametersResult(successful=True)

    def _publish_health(self) -> None:
        if not self._diagnostics.get_subscription_count():
            return
        health = self.health()
        name = self.get_fully_qualified_name().lstrip("/")
        status = DiagnosticStatus(level=health.level, name=name, message=health.message)
        values = {**health.values, **self._peers()}
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _peers(self) -> dict[str, object]:
        """Return the number of peers on each topic: what nobody listens to is not published."""
        outputs = {f"subscribers.{each.topic_name}": each.get_subscription_count() for each in self.publishers}
        inputs = {f"publishers.{each.topic_name}": each.get_publisher_count() for each in self.subscriptions}
        return {key: count for key, count in (outputs | inputs).items() if not key.endswith(_TOPICS_OF_ROS)}
