"""`tam nodes`, `tam play` and `tam call`: start the nodes, feed them a recording, and ask for their services."""

import os
import re
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import MAP_HELP, PATH, NamedPath, Number, completed
from tam_calibration.files.text_files import check_writable, in_file, require_regular
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.libraries import require
from tam_calibration.nodes.session import PATIENCE_S, Children, node_commands, ros_session
from tam_calibration.recordings.channel_map import Reading, read_map

if TYPE_CHECKING:
    from rich.console import Console

    from tam_calibration.nodes.monitor import Monitor
    from tam_calibration.nodes.player import Player


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


_SLOWEST, _FASTEST = 0.001, 1000.0
"""Limits of the rate: an hour lasts six weeks, or 3.6 s, which no node keeps up with."""


@click.command()
@click.argument("recording", type=PATH)
@click.option("--map", "map_path", type=PATH, help=MAP_HELP)
@click.option(
    "--rate",
    type=Number(_SLOWEST, _FASTEST),
    default=1.0,
    show_default=True,
    help="How many times faster than recorded.",
)
@click.option("--loop", is_flag=True, help="Begin again at the end; stamps then go backwards.")
@click.option("--clock", is_flag=True, help="Publish the bag's time on /clock, for nodes with use_sim_time.")
def play(recording: Path, map_path: Path | None, rate: float, loop: bool, clock: bool) -> None:
    """Play RECORDING, once a node subscribes to the sensors.

    A bag with the topics of this package is played as it was recorded. Of any other recording, and with --map, the
    sensors and channels are played onto the topics that the collector reads.
    """
    require("bags", "playing recordings")
    from tam_calibration.recordings.recording_file import open_source

    reading = Reading(None if map_path is None else read_map(map_path))
    with ros_session(exit_code=0), open_source(recording, reading.channel_map) as source, in_file(recording):
        from tam_calibration.nodes.player import Player, playback_of

        player = Player(playback_of(source, reading), rate, clock)
        _wait(player)
        _show(player, loop)


def _wait(player: "Player") -> None:
    for name in player.unknown_types:
        say(f"not played: {name} is not installed here", err=True)
    if not player.wait_for_subscribers(PATIENCE_S):
        say(f"no subscriber for {', '.join(player.unheard())}; playing all the same", err=True)


def _show(player: "Player", loop: bool) -> None:
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("playing", total=player.playback.duration_s)
        while True:
            begin = time.monotonic()
            count = 0
            for position_s in player.play():
                count += 1
                progress.update(task, completed=position_s)
            progress.update(task, completed=player.playback.duration_s)
            progress.console.print(f"{count} messages in {time.monotonic() - begin:.1f} s")
            if not loop:
                return


_SERVICES = ("calibrator/calibrate", "calibrator/diagnose", "calibrator/save", "collector/reset")
"""Those of our nodes that people call."""

_NAME = re.compile(r"(~?/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)


@click.command()
@click.argument("service", shell_complete=completed(lambda: _SERVICES))
def call(service: str) -> None:
    """Call SERVICE, such as calibrator/calibrate, and print its answer; exit 1 when the answer is no."""
    if not _NAME.fullmatch(service):
        raise InputError(f"{service!r} is no name of a service: give one such as calibrator/calibrate")
    with ros_session():
        from tam_calibration.nodes import monitor

        say(monitor.call(service, PATIENCE_S))
