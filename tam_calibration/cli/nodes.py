"""`tam nodes`: start the nodes and show what they say."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tam_calibration.cli.terminal import NamedPath
from tam_calibration.files.text_files import check_writable, require_regular
from tam_calibration.nodes.children import NODES, Children, node_commands
from tam_calibration.nodes.session import ros_session

if TYPE_CHECKING:
    from tam_calibration.nodes.monitor import Monitor


@click.command()
@click.option("--array", type=NamedPath(exists=True, path_type=Path), help="Array YAML; without it the cross of 0.5 m.")
@click.option(
    "--calibration",
    type=NamedPath(dir_okay=False, path_type=Path),
    help="Calibration YAML: loaded where it exists, written by calibrator/save.",
)
@click.option("--method", help="Method of the fit.")
@click.option("--params-file", type=NamedPath(exists=True, path_type=Path), help="ROS parameters of the nodes.")
def command(array: Path | None, calibration: Path | None, method: str | None, params_file: Path | None) -> None:
    """Start collector, calibrator, corrector and localizer, and show coverage, losses and advice until Ctrl-C."""
    for path in (array, params_file):
        if path is not None:
            require_regular(path)
    if calibration is not None and calibration.exists():
        require_regular(calibration)
    elif calibration is not None:
        check_writable(str(calibration))  # by calibrator/save
    log_directory = Path(os.environ.get("ROS_LOG_DIR", "~/.ros/log")).expanduser() / f"tam_nodes_{os.getpid()}"
    with ros_session(exit_code=0):
        from tam_calibration.nodes.monitor import Monitor

        with Children(node_commands(array, calibration, method, params_file), log_directory) as children:
            _watch(children, Monitor(NODES))


def _watch(children: Children, monitor: "Monitor") -> None:
    from rich.console import Console
    from rich.live import Live

    console = Console()
    with Live(console=console, auto_refresh=False, transient=True) as live:
        while True:
            monitor.turn()
            children.check()
            if console.is_terminal:
                live.update(monitor.render(), refresh=True)
            else:
                for line in monitor.news():
                    click.echo(line)
