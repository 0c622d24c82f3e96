"""How a node answers its services: every call at once, or by one action at a time in a thread of its own."""

import ctypes
import gc
import math
import sys
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from traceback import format_exc
from typing import Any, TypeVar

from rclpy.context import Context
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.service import Service
from std_srvs.srv import Trigger

from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.nodes.listening import ListeningNode

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

    def __init__(self, name: str, context: Context | None = None) -> None:
        self._served: dict[Service, tuple[str, Callable[[], str], Work | None]] = {}
        self._answers: deque[tuple[Service, Any, Trigger.Response]] = deque()
        super().__init__(name, context)
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
