"""How a node reads its topics: serialised messages, one by one or all that wait at once, in the order of arrival."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from functools import partial
from importlib import import_module
from itertools import chain
from operator import itemgetter
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For what a late joiner must still get."""

STREAM = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Sensor data; deep enough to bridge ten seconds at 1000 Hz."""

RELIABLE_STREAM = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.RELIABLE)
"""Data between our own nodes, of which none may be lost."""

_OVERRIDABLE = QoSOverridingOptions(
    [QoSPolicyKind.DEPTH, QoSPolicyKind.DURABILITY, QoSPolicyKind.HISTORY, QoSPolicyKind.RELIABILITY]
)


class ListeningNode(Node):
    """A node that publishes and reads topics whose quality of service parameters may override (``qos_overrides.…``)."""

    def __init__(self, name: str, context: Context | None = None) -> None:
        self._unwatched: list[Subscription] = []
        self._in_order: list[tuple[Subscription, Callable[[bytes, int], None]]] = []
        super().__init__(name, context=context, automatically_declare_parameters_from_overrides=True)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions that an executor waits on: not those that are read in turns."""
        yield from (each for each in super().subscriptions if each not in self._unwatched)

    @property
    def all_subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions, also those that are read in turns."""
        yield from super().subscriptions

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

    def listen_in_order(
        self, message_type: Any, topic: str, take: Callable[[bytes, int], None], quality: QoSProfile
    ) -> Callable[[], int]:
        """Have a function called with every serialised message of a topic, and when it arrived, nanoseconds.

        The messages of all topics that are read so come in the order in which they arrived. A node that falls behind
        takes what waits on all of them at once, at a third of the cost, and catches up. The message that wakes it comes
        first, for the executor of events does not say when it arrived.

        Parameters
        ----------
        message_type : type
            Class of the messages.
        topic : str
            Name, relative or absolute.
        take : callable
            Called with each message.
        quality : QoSProfile
            Used where no parameter says otherwise; its depth bounds how many wait.

        Returns
        -------
        callable
            Returns how many messages were lost on the way since it was called last.
        """
        take_waiting = partial(self._take_in_order, len(self._in_order))
        subscription = self.listen(message_type, topic, take_waiting, quality)
        self._in_order.append((subscription, take))
        lost = QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
        event = rclpy_implementation.EventHandle(subscription.handle, lost)
        return lambda: int(event.take_event().total_count_change)

    def _take_in_order(self, turn: int, first: bytes) -> None:
        subscription, take = self._in_order[turn]
        now_ns = time.time_ns()
        later = list(_arrived(subscription, take, now_ns))
        take(first, later[0][0] - 1 if later else now_ns)
        if later:
            others = (_arrived(*other, now_ns) for other in self._in_order if other[0] is not subscription)
            for arrived_ns, take_one, message in sorted(chain(later, *others), key=itemgetter(0)):
                take_one(message, arrived_ns)

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
        read = [(self.listen(message_type, topic, leave, quality), take) for message_type, topic, take in topics]
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


def type_name(kind: Any) -> str:
    """Return the name of a message's class, such as ``sensor_msgs/msg/Imu``."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def message_class(name: str) -> Any:
    """Return the class of messages of a type, such as ``sensor_msgs/msg/Imu``; None where it is not installed."""
    package, *_, message = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), message)
    except (ImportError, AttributeError, ValueError):
        return None


def leave(message: bytes, arrived_ns: int = 0) -> None:
    """Stands for the callback of a subscription that no executor waits on."""


def waiting(subscription: Subscription) -> Iterator[bytes]:
    """Take the serialised messages that wait in a subscription, as many as there are room for in its queue."""
    yield from (message for _, _, message in _arrived(subscription, leave, math.inf))


def _arrived(
    subscription: Subscription, take: Callable[[bytes, int], None], until_ns: float
) -> Iterator[tuple[int, Callable[[bytes, int], None], bytes]]:
    """Take what waits in a subscription up to a time: when it arrived (ns), what is to be called, the message.

    What arrives meanwhile is left, but for one message: another subscription may have been read before it came.
    """
    arrived_ns = 0
    with subscription.handle:
        for _ in range(subscription.qos_profile.depth):
            taken = subscription.handle.take_message(subscription.msg_type, True) if arrived_ns <= until_ns else None
            if taken is None:
                return
            arrived_ns = taken[1]["received_timestamp"]
            yield arrived_ns, take, taken[0]
