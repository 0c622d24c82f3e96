"""What commands see of the nodes: answers of services, and what they say in /diagnostics."""

import math
import re
import time
from collections.abc import Callable, Mapping

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text
from std_srvs.srv import Trigger

from tam_calibration.model.exceptions import Refused
from tam_calibration.nodes.session import NODES, PERIOD_S, Children

_LEVELS = {
    DiagnosticStatus.OK: ("OK", "green"),
    DiagnosticStatus.WARN: ("WARN", "yellow"),
    DiagnosticStatus.ERROR: ("ERROR", "red"),
    DiagnosticStatus.STALE: ("WAIT", "cyan"),
}

_BAR_WIDTH = 40


class Monitor(Node):
    """Keeps the newest status of each of the nodes, and fails at once when one of them ends.

    Parameters
    ----------
    children : Children
        Their processes.
    on_turn : callable
        Called with the monitor some times a second while it waits.
    """

    def __init__(self, children: Children, on_turn: "Callable[[Monitor], None]") -> None:
        super().__init__("monitor")
        self._children, self._on_turn = children, on_turn
        self._statuses: dict[str, DiagnosticStatus | None] = dict.fromkeys(NODES)
        self._printed: dict[str, str] = {}
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take, 10)

    def wait_until(self, condition: Callable[[], object], what: str = "", timeout_s: float = math.inf) -> None:
        """Wait until a condition is true.

        Parameters
        ----------
        condition : callable
            Called without arguments; what it returns is taken as true or false.
        what : str
            Name of what is waited for, for the message of `Refused`.
        timeout_s : float
            Longest time to wait, seconds.

        Raises
        ------
        InputError
            When a node has ended because of a parameter or file.
        Refused
            When it does not hold in time, or a node ends.
        """
        limit, shown = time.monotonic() + timeout_s, 0.0
        while not condition():
            self._children.check()
            if time.monotonic() > limit:
                said = " | ".join(filter(None, map(_line, self._statuses.values())))
                raise Refused(f"{what} did not happen within {timeout_s:g} s; the nodes say: {said}")
            self._executor.spin_once(timeout_sec=PERIOD_S)
            if time.monotonic() > shown + PERIOD_S:
                shown = time.monotonic()
                self._on_turn(self)

    def figures(self, name: str) -> dict[str, str]:
        """Return the figures of a node's status; none before the first."""
        return _figures_of(self._statuses[name])

    def news(self) -> list[str]:
        """Return a line for each node whose status says something else than before, figures aside."""
        lines = []
        for name, status in self._statuses.items():
            line = _line(status)
            if line and self._printed.get(name) != (said := re.sub(r"[\d.]+", "#", line)):
                self._printed[name] = said
                lines.append(line)
        return lines

    def render(self) -> RenderableType:
        """Return bars of coverage and losses, and a row for each node."""
        return render_statuses(self._statuses)

    def _take(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name in self._statuses:
                self._statuses[status.name] = status


def render_statuses(statuses: Mapping[str, DiagnosticStatus | None]) -> RenderableType:
    """Return bars of the collector's coverage and losses, and a row for each node; None for one that is silent yet."""
    table = Table.grid(padding=(0, 2))
    for name, status in statuses.items():
        level, colour = _LEVELS[status.level] if status else ("…", "dim")
        table.add_row(name, Text(level, colour), Text(status.message if status else "starting"))
    return Group(*_bars(_figures_of(statuses["collector"])), table)


def _figures_of(status: DiagnosticStatus | None) -> dict[str, str]:
    """Return the figures of a status; none before the first."""
    return {value.key: value.value for value in status.values} if status else {}


def _bars(figures: Mapping[str, str]) -> list[RenderableType]:
    if "fraction" not in figures:
        return []
    is_enough = figures["enough"] == "True"
    fraction, colour = float(figures["fraction"]), "green" if is_enough else "yellow"
    samples, lost = int(figures["samples"]), int(figures["lost"])
    grid = Table.grid(padding=(0, 2))
    grid.add_row(
        "sphere of directions",
        ProgressBar(1.0, fraction, width=_BAR_WIDTH, complete_style=colour, finished_style=colour),
        f"{fraction:.0%}  {'enough' if is_enough else 'missing: ' + figures['missing']}",
    )
    grid.add_row(
        "synchronised",
        ProgressBar(max(samples + lost, 1), samples, _BAR_WIDTH, complete_style="green", finished_style="green"),
        f"{samples} samples, {lost} messages lost",
    )
    return [grid]


def _line(status: DiagnosticStatus | None) -> str:
    return f"{status.name} {_LEVELS[status.level][0]}: {status.message}" if status else ""


def call(service: str, find_s: float) -> str:
    """Call a service and return its message.

    Parameters
    ----------
    service : str
        Name, relative or absolute.
    find_s : float
        Longest time to find the service, seconds; its answer takes as long as its node lives.

    Raises
    ------
    Refused
        When no one offers the service, its node ends before it answers, or it answers no, with its reason.
    """
    node = Node("tam_call")
    try:
        client = node.create_client(Trigger, service)
        if not client.wait_for_service(timeout_sec=find_s):
            raise Refused(
                f"the service {service} is not offered: are the nodes running (tam nodes), in this namespace?"
            )
        future = client.call_async(Trigger.Request())
        while not future.done() and client.service_is_ready():
            rclpy.spin_until_future_complete(node, future, timeout_sec=1.0)  # until Ctrl-C is looked at again
        response = future.result() if future.done() else None
        if response is None:
            raise Refused(f"the node of {service} ended before it answered: its log says why")
        if not response.success:
            raise Refused(f"{service}: {response.message}")
        return str(response.message)
    finally:
        node.destroy_node()
