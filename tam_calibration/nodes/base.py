"""What the nodes share: checked parameters, health in /diagnostics once a second, and services answered in turns."""

import ctypes
import gc
import math
import sys
from abc import abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from traceback import format_exc
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.service import Service
from std_srvs.srv import Trigger

from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.nodes import node_parameters
from tam_calibration.nodes.session import take_name
from tam_calibration.nodes.topics import ListeningNode, type_name

Result = TypeVar("Result")


class Work:
    """The actions of a node in addition to its stream; they return their memory.

    rclpy's executor with threads would do the same at the cost of a core.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1)
        self._name, self._done = "", math.nan

    @property
    def busy_with(self) -> str:
        """The action that is under way and how far it is, for people; empty when there is none."""
        return self._name if math.isnan(self._done) else f"{self._name}, {self._done:.0%} done"

    def begin(self, name: str, action: Callable[[], Result], answer: Callable[[Result], None]) -> None:
        """Do an action; when `busy_with` is not empty it waits for the one before.

        Parameters
        ----------
        name : str
            For `busy_with`.
        action : callable
            Returns a result.
        answer : callable
            Called with the result, once the next action may begin.
        """
        self._name, self._done = name, math.nan
        self._thread.submit(self._do, action, answer)

    def _do(self, action: Callable[[], Result], answer: Callable[[Result], None]) -> None:
        try:
            result = action()
        finally:
            self._name, self._done = "", math.nan
        answer(result)
        del result
        gc.collect()
        if sys.platform == "linux":  # else the allocator keeps it
            ctypes.CDLL(None).malloc_trim(0)

    def progress(self, done: float) -> None:
        """Note how far the action is: from 0 to 1."""
        self._done = done


class AnsweringNode(ListeningNode):
    """A node whose `Trigger` services are answered in turns, so that none waits for an executor or is lost."""

    def __init__(self, name: str) -> None:
        self._served: dict[Service, tuple[str, Callable[[], str], Work | None]] = {}
        self._answers: deque[tuple[Service, Any, Trigger.Response]] = deque()
        super().__init__(name)
        self.create_steady_timer(0.05, self._turn)  # seconds from one look for calls to the next

    @property
    def services(self) -> Iterator[Service]:
        """The services that the executor answers: not those that are answered in turns."""
        yield from (each for each in super().services if each not in self._served)

    def serve(self, name: str, action: Callable[[], str], work: Work | None = None) -> None:
        """Offer a service of the type `Trigger`.

        Parameters
        ----------
        name : str
            Name of the service below that of the node.
        action : callable
            Returns the message of the answer; what it raises is the answer that it could not be done.
        work : Work, optional
            Does the action if it takes long; other callers are told at once that it is busy.
        """
        # Of a storm of calls the ten of ROS's default lose all others.
        quality = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
        service = self.create_service(Trigger, f"~/{name}", lambda _, unused: unused, qos_profile=quality)
        self._served[service] = name, action, work

    def _turn(self) -> None:
        for service, (name, action, work) in self._served.items():
            while (header := _next_call(service)) is not None:
                send = partial(self._send, service, header)
                if work is None:
                    send(self._response(action))
                elif busy_with := work.busy_with:
                    busy = f"busy with {busy_with}: call again when that is answered"
                    send(Trigger.Response(success=False, message=busy))
                else:
                    work.begin(name, partial(self._response, action), send)
        # A caller has room for ten answers that wait, as ROS's default is, and loses the others when it is slow.
        for _ in range(min(4, len(self._answers))):
            service, header, response = self._answers.popleft()
            service.send_response(response, header)

    def _send(self, service: Service, header: Any, response: Trigger.Response) -> None:
        self._answers.append((service, header, response))

    def _response(self, action: Callable[[], str]) -> Trigger.Response:
        response = Trigger.Response()
        try:
            response.message, response.success = action(), True
        except (InputError, Refused, OSError) as problem:
            response.message, response.success = " ".join(str(problem).split()), False
            self.get_logger().warning(response.message)
        except Exception as defect:  # a defect of a fit must not cost the mission its samples
            response.message, response.success = f"a defect of this software: {defect!r}", False
            self.get_logger().error(f"{response.message}\n{format_exc()}")
        return response


def _next_call(service: Service) -> Any:
    """Take a call that waits, and return what its response needs to find the caller; None where there is none."""
    with service.handle:
        _, header = service.handle.service_take_request(Trigger.Request)
    return header


OK, WARN, ERROR, STALE = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE

_DIAGNOSTICS = "/diagnostics"
_TOPICS_OF_ROS = ("/parameter_events", "/rosout", _DIAGNOSTICS)


@dataclass
class Health:
    """What a node says of itself: a level, one sentence and figures."""

    level: bytes
    message: str
    values: dict[str, object] = field(default_factory=dict)


class TamNode(AnsweringNode):
    """A node that checks its parameters, streams serialised messages, and reports its health.

    Parameters
    ----------
    name : str
        Name of the node.
    rules : sequence of Rule
        All its parameters, with those of `SHARED`; of another that is given it warns, as a file for all nodes of a
        robot may have them.

    Raises
    ------
    InputError
        When a node of the same name runs, a quality of service is none, or the array file cannot be used.
    ParameterException
        When a value has the wrong type or is out of bounds.
    """

    def __init__(self, name: str, rules: Sequence[node_parameters.Rule]) -> None:
        super().__init__(name)
        self._takes: dict[str, Callable[[Any], object]]
        self._takes = {rule.name: rule.require_choice for rule in rules if rule.choices}
        self.add_on_set_parameters_callback(self._take_parameters)
        self._unknown_parameters = node_parameters.unknown_parameters(self, rules)
        for remark in self._unknown_parameters.values():
            self.get_logger().warning(remark)
        node_parameters.require_quality(self)
        node_parameters.declare(self, rules)
        take_name(self.get_fully_qualified_name(), self.context.get_domain_id())
        self._unusable, self._unusable_reported = Counter[str](), Counter[str]()
        self._last_problem: dict[str, str] = {}
        self._level: bytes = STALE
        self._diagnostics = self.create_publisher(DiagnosticArray, _DIAGNOSTICS, 10)
        self.create_steady_timer(1.0, self._publish_health)
        self._array = node_parameters.array_of(self)

    def value(self, name: str) -> Any:
        """Return the present value of a parameter."""
        return self.get_parameter(name).value

    def say_start(self, *remarks: str) -> None:
        """Log one line: the array, and what else there is to know at the start.

        Parameters
        ----------
        *remarks : str
            On the calibration, and on what the node waits for.
        """
        self.get_logger().info("; ".join((f"array {node_parameters.array_name(self)}", *remarks)))

    @property
    def now_s(self) -> float:
        """The time of the node's clock, seconds."""
        return self.get_clock().now().nanoseconds / 1e9

    def refuse(self, topic: str, problem: str) -> None:
        """Count a message that cannot be used; the first of a topic is logged, all are counted in /diagnostics.

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
        self._last_problem[topic] = problem

    def on_change(self, takes: Mapping[str, Callable[[Any], object]]) -> None:
        """Have functions called with new values of parameters; what they raise refuses the value, with the reason.

        Parameters
        ----------
        takes : mapping of str to callable
            By the name of the parameter; each raises `InputError` where a value cannot be used.
        """
        self._takes |= takes

    @abstractmethod
    def health(self) -> Health:
        """Return the node's health; called once a second."""

    def _take_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                if take := self._takes.get(parameter.name):
                    take(parameter.value)
        except (InputError, OSError) as problem:
            return SetParametersResult(successful=False, reason=" ".join(str(problem).split()))
        return SetParametersResult(successful=True)

    def _publish_health(self) -> None:
        """Publish the health, and log each change of its level."""
        health = self.health()
        self._add_unusable(health)
        if problems := self._problems_of_types():
            health.level, health.message = ERROR, "; ".join([*problems, health.message])
        if problem := self._problem_of_twin():
            health.level, health.message = ERROR, problem
        if health.level != self._level:
            self._level = health.level
            if health.level in (OK, STALE):  # a logger has one severity at each place
                self.get_logger().info(health.message)
            else:
                self.get_logger().warning(health.message)
        if not self._diagnostics.get_subscription_count():
            return
        values = health.values | self._peers()
        if self._unknown_parameters:
            values["unknown_parameters"] = " ".join(self._unknown_parameters)
        name, array = self.get_fully_qualified_name().lstrip("/"), node_parameters.array_name(self)
        status = DiagnosticStatus(level=health.level, name=name, message=health.message, hardware_id=array)
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _problem_of_twin(self) -> str:
        """Return a sentence while another node of this name is heard: on this machine there can be none."""
        endpoints = self.get_publishers_info_by_topic(_DIAGNOSTICS)
        names = [(each.node_namespace, each.node_name) for each in endpoints]
        if names.count((self.get_namespace(), self.get_name())) < 2:
            return ""
        problem = (
            f"another {self.get_fully_qualified_name()} runs on another machine of this ROS domain, and both answer: "
            "end one, or give it a namespace or ROS_DOMAIN_ID of its own"
        )
        self.get_logger().error(problem, once=True)
        return problem

    def _problems_of_types(self) -> list[str]:
        """Return which inputs are published as another type than is read: nothing arrives of these."""
        problems = []
        for subscription in self.all_subscriptions:
            expected, topic = type_name(subscription.msg_type), subscription.topic_name
            types = {endpoint.topic_type for endpoint in self.get_publishers_info_by_topic(topic)}
            if others := sorted(types - {expected}):
                told = f"{topic.lstrip('/')} is published as {' and '.join(others)}, not {expected}"
                problems.append(f"{told}: {self.mend_of_type(topic, others[0])}")
        return problems

    def mend_of_type(self, topic: str, published: str) -> str:
        """Return what to do about an input that is published as another type.

        Parameters
        ----------
        topic : str
            Its complete name.
        published : str
            The type, such as ``sensor_msgs/msg/Imu``.
        """
        return "look for the node that publishes it, and remap its topic or give it the right type"

    def _add_unusable(self, health: Health) -> None:
        """Add what was refused to the health; what was refused since the last time is a warning."""
        health.values |= {f"unusable.{topic}": count for topic, count in self._unusable.items()}
        for topic, count in (self._unusable - self._unusable_reported).items():
            health.level = max(health.level, WARN)
            health.message += f"; {count} messages of {topic} cannot be used: {self._last_problem[topic]}"
        self._unusable_reported = self._unusable.copy()

    def _peers(self) -> dict[str, object]:
        """Return the number of peers on each topic: topics without subscribers are not published."""
        outputs = {f"subscribers.{each.topic_name}": each.get_subscription_count() for each in self.publishers}
        inputs = {f"publishers.{each.topic_name}": each.get_publisher_count() for each in self.all_subscriptions}
        return {key: count for key, count in (outputs | inputs).items() if not key.endswith(_TOPICS_OF_ROS)}
