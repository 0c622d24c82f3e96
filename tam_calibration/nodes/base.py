"""What the nodes share: checked parameters, and health in /diagnostics once a second."""

from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from tam_calibration.nodes.node_parameters import Rule, array_name, declare, unknown_parameters
from tam_calibration.nodes.sole_name import take_name

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For what a late joiner must still get."""

STREAM = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Sensor data; deep enough to bridge ten seconds at 1000 Hz."""

RELIABLE_STREAM = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.RELIABLE)
"""Data between our own nodes, of which none may be lost."""

OK, WARN, ERROR, STALE = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE

_DIAGNOSTICS = "/diagnostics"
_TOPICS_OF_ROS = ("/parameter_events", "/rosout", _DIAGNOSTICS)

_OVERRIDABLE = QoSOverridingOptions(
    [QoSPolicyKind.DEPTH, QoSPolicyKind.DURABILITY, QoSPolicyKind.HISTORY, QoSPolicyKind.RELIABILITY]
)


@dataclass(frozen=True)
class Health:
    """What a node says of itself: a level, one sentence and figures."""

    level: bytes
    message: str
    values: Mapping[str, object] = field(default_factory=dict)


class TamNode(Node):
    """A node that checks its parameters, streams serialised messages, and tells its health.

    Parameters
    ----------
    name : str
        Name of the node.
    rules : sequence of Rule
        All its parameters; of another that is given it warns, as a file for all nodes of a robot may have them.

    Raises
    ------
    InputError
        When a node of the same name runs.
    ParameterException
        When a value has the wrong type or is out of bounds.
    """

    def __init__(self, name: str, rules: Sequence[Rule]) -> None:
        self._unwatched: list[Subscription] = []
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self._choices = {rule.name: rule.choices for rule in rules if rule.choices}
        self.add_on_set_parameters_callback(self._check_choices)
        self._unknown_parameters = unknown_parameters(self, rules)
        for remark in self._unknown_parameters.values():
            self.get_logger().warning(remark)
        declare(self, rules)
        take_name(self.get_fully_qualified_name(), self.context.get_domain_id())
        self._unusable, self._unusable_reported = Counter[str](), Counter[str]()
        self._diagnostics = self.create_publisher(DiagnosticArray, _DIAGNOSTICS, 10)
        self.create_steady_timer(1.0, self._publish_health)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions that an executor waits on: not those that are read in turns."""
        yield from (each for each in super().subscriptions if each not in self._unwatched)

    def value(self, name: str) -> Any:
        """Return the present value of a parameter."""
        return self.get_parameter(name).value

    def offer(self, message_type: Any, topic: str, quality: QoSProfile) -> Publisher:
        """Return a publisher whose quality of service parameters may override (``qos_overrides.…``).

        Parameters
        ----------
        message_type : type
            Class of the messages.
        topic : str
            Name, relative or absolute.
        quality : QoSProfile
            Used where no parameter says otherwise.
        """
        return self.create_publisher(message_type, topic, copy(quality), qos_overriding_options=_OVERRIDABLE)

    def listen(self, message_type: Any, topic: str, take: Callable[[bytes], None], quality: QoSProfile) -> Subscription:
        """Have a function called with every serialised message of a topic; parameters may override the quality.

        Parameters
        ----------
        message_type : type
            Class of the messages.
        topic : str
            Name, relative or absolute.
        take : callable
            Called with each message.
        quality : QoSProfile
            Used where no parameter says otherwise.
        """
        return self.create_subscription(
            message_type,
            topic,
            take,
            copy(quality),
            raw=True,
            qos_overriding_options=_OVERRIDABLE,
        )

    def listen_to_all(
        self, message_type: Any, topic: str, take: Callable[[list[bytes]], None], quality: QoSProfile
    ) -> None:
        """Have a function called with all serialised messages that wait, oldest first.

        A node that falls behind gets more of them in a call, so that each costs less and it catches up.

        Parameters
        ----------
        message_type : type
            Class of the messages.
        topic : str
            Name, relative or absolute.
        take : callable
            Called with the list of the messages.
        quality : QoSProfile
            Used where no parameter says otherwise; its depth bounds how many wait.
        """

        def take_waiting(first: bytes) -> None:
            take([first, *waiting(subscription)])

        subscription = self.listen(message_type, topic, take_waiting, quality)

    def listen_in_turns(
        self,
        topics: Sequence[tuple[Any, str, Callable[[list[bytes]], None]]],
        period_s: float,
        quality: QoSProfile,
    ) -> None:
        """Have functions called with all serialised messages that wait, topic after topic, once in a period.

        A message that comes in between does not even wake the process.

        Parameters
        ----------
        topics : sequence of type, str and callable
            Type and name of each topic, and what is called.
        period_s : float
            Time from turn to turn, seconds.
        quality : QoSProfile
            Its depth must hold what comes in a period.
        """
        read = [(self.listen(message_type, topic, _leave, quality), take) for message_type, topic, take in topics]
        self._unwatched += [subscription for subscription, _ in read]

        def turn() -> None:
            for subscription, take in read:
                if messages := list(waiting(subscription)):
                    take(messages)

        self.create_steady_timer(period_s, turn)

    def create_steady_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        """Have a function called periodically, whatever the time on /clock.

        Parameters
        ----------
        period_s : float
            Time from call to call, seconds.
        callback : callable
            Called without arguments.
        """
        self.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def say_start(self, *remarks: str) -> None:
        """Log one line: the array, and what else there is to know at the start.

        Parameters
        ----------
        *remarks : str
            On the calibration, and on what the node waits for.
        """
        self.get_logger().info("; ".join((f"array {array_name(self)}", *remarks)))

    @property
    def now_s(self) -> float:
        """The time of the node's clock, seconds."""
        return self.get_clock().now().nanoseconds / 1e9

    def refuse(self, topic: str, problem: str) -> None:
        """Count a message that cannot be used; the first of a topic is logged, all are told in /diagnostics.

        Parameters
        ----------
        topic : str
            By which messages are counted.
        problem : str
            What is wrong with the message, for the log.
        """
        if not self._unusable[topic]:
            self.get_logger().warning(f"{topic}: {problem}; more of them are counted in /diagnostics")
        self._unusable[topic] += 1

    @abstractmethod
    def health(self) -> Health:
        """Return the node's health; called once a second."""

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
        health = self._with_twin(self._with_unusable(self.health()))
        name = self.get_fully_qualified_name().lstrip("/")
        status = DiagnosticStatus(level=health.level, name=name, message=health.message, hardware_id=array_name(self))
        values = {**health.values, **self._peers()}
        if self._unknown_parameters:
            values["unknown_parameters"] = " ".join(self._unknown_parameters)
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _with_twin(self, health: Health) -> Health:
        """Say it while another node of this name is heard: on this machine there can be none."""
        endpoints = self.get_publishers_info_by_topic(_DIAGNOSTICS)
        names = [(each.node_namespace, each.node_name) for each in endpoints]
        if names.count((self.get_namespace(), self.get_name())) < 2:
            return health
        problem = (
            f"another {self.get_fully_qualified_name()} runs on another machine of this ROS domain, and both answer: "
            "end one, or give it a namespace or ROS_DOMAIN_ID of its own"
        )
        self.get_logger().error(problem, once=True)
        return Health(ERROR, problem, health.values)

    def _with_unusable(self, health: Health) -> Health:
        """Add what was refused to the health; what was refused since the last time is a warning."""
        new, self._unusable_reported = self._unusable - self._unusable_reported, self._unusable.copy()
        if not self._unusable:
            return health
        values = {f"unusable.{topic}": count for topic, count in self._unusable.items()}
        remark = "".join(f"; {count} messages of {topic} cannot be used, see the log" for topic, count in new.items())
        level = max(health.level, WARN) if new else health.level
        return Health(level, health.message + remark, {**health.values, **values})

    def _peers(self) -> dict[str, object]:
        """Return the number of peers on each topic: what nobody listens to is not published."""
        outputs = {f"subscribers.{each.topic_name}": each.get_subscription_count() for each in self.publishers}
        inputs = {f"publishers.{each.topic_name}": each.get_publisher_count() for each in super().subscriptions}
        return {key: count for key, count in (outputs | inputs).items() if not key.endswith(_TOPICS_OF_ROS)}


def _leave(message: bytes) -> None:
    """Stands for the callback of a subscription that no executor waits on."""


def waiting(subscription: Subscription) -> Iterator[bytes]:
    """Take the serialised messages that wait in a subscription, as many as there are room for in its queue."""
    with subscription.handle:
        for _ in range(subscription.qos_profile.depth):
            if (taken := subscription.handle.take_message(subscription.msg_type, True)) is None:
                return
            yield taken[0]
