"""`tam nodes`: start the nodes and show what they say."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import MAP_HELP, NamedPath, completed
from tam_calibration.files.text_files import check_writable, require_regular
from tam_calibration.nodes.session import Children, node_commands, ros_session

if TYPE_CHECKING:
    from rich.console import Console

    from tam_calibration.nodes.monitor import Monitor


def _methods() -> Iterable[str]:
    from tam_calibration.fit import METHODS  # a signal ends the nodes well while nothing else is loaded

    return METHODS


@click.command()
@click.option("--array", type=NamedPath(exists=True, path_type=Path), help="Array YAML; without it the cross of 0.5 m.")
@click.option(
    "--calibration",
    type=NamedPath(dir_okay=False, path_type=Path),
    help="Calibration YAML: loaded if it exists, written by calibrator/save.",
)
@click.option("--method", shell_complete=completed(_methods), help="Method of the fit.")
@click.option("--map", "map_file", type=NamedPath(exists=True, path_type=Path), help=MAP_HELP)
@click.option("--params-file", type=NamedPath(exists=True, path_type=Path), help="ROS parameters of the nodes.")
def command(
    array: Path | None, calibration: Path | None, method: str | None, map_file: Path | None, params_file: Path | None
) -> None:
    """Start collector, calibrator, corrector and localizer, and show coverage, losses and advice until Ctrl-C."""
    for path in (array, map_file, params_file):
        if path is not None:
            require_regular(path)
    if calibration is not None and calibration.exists():
        require_regular(calibration)
    elif calibration is not None:
        check_writable(str(calibration))  # by calibrator/save
    log_directory = Path(os.environ.get("ROS_LOG_DIR", "~/.ros/log")).expanduser() / f"tam_nodes_{os.getpid()}"
    with ros_session(exit_code=0):
        from rich.console import Console

        commands = node_commands(array, calibration, method, params_file, map_file)
        with Children(commands, log_directory) as children, watched(Console(), children) as monitor:
            monitor.wait_until(lambda: False)


@contextmanager
def watched(console: "Console", children: Children) -> Iterator["Monitor"]:
    """Give a monitor of the nodes: while it waits, what they say is shown as bars, or line by line in a file."""
    from rich.live import Live

    from tam_calibration.nodes.monitor import Monitor

    with Live(console=console, auto_refresh=False, transient=True) as live:

        def show(monitor: Monitor) -> None:
            if console.is_terminal:
                live.update(monitor.render(), refresh=True)
            else:
                for line in monitor.news():
                    say(line)

        yield Monitor(children, show)
