"""`tam call`: call a service of the nodes where there is no `ros2` command."""

import re

import click

from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import completed
from tam_calibration.model.exceptions import InputError
from tam_calibration.nodes.session import ros_session

_FIND_S = 5.0
"""Longest wait for a service, seconds: a node that runs is found within one."""

_SERVICES = ("calibrator/calibrate", "calibrator/diagnose", "calibrator/compare", "calibrator/save", "collector/reset")
"""Those of our nodes that people call."""

_NAME = re.compile(r"(~?/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)


@click.command()
@click.argument("service", shell_complete=completed(lambda: _SERVICES))
def command(service: str) -> None:
    """Call SERVICE, such as calibrator/calibrate, and print its answer; exit 1 when the answer is no."""
    if not _NAME.fullmatch(service):
        raise InputError(f"{service!r} is no name of a service: give one such as calibrator/calibrate")
    with ros_session():
        from tam_calibration.nodes.monitor import call

        say(call(service, _FIND_S))
