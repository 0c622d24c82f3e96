"""`tam play`: play a recording onto topics."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import MAP_HELP, PATH, Number
from tam_calibration.files.text_files import in_file
from tam_calibration.model.libraries import require
from tam_calibration.nodes.session import ros_session
from tam_calibration.recordings.channel_map import Reading, read_map
from tam_calibration.recordings.recording_file import open_source

if TYPE_CHECKING:
    from tam_calibration.nodes.player import Player

WAIT_S = 10.0
"""Longest wait for a subscriber: nodes that start with the player are there within some seconds."""

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
def command(recording: Path, map_path: Path | None, rate: float, loop: bool, clock: bool) -> None:
    """Play RECORDING, once a node subscribes to the sensors.

    A bag with the topics of this package is played as it was recorded. Of any other recording, and with --map, the
    sensors and channels are played onto the topics that the collector reads.
    """
    require("bags", "playing recordings")
    reading = Reading(None if map_path is None else read_map(map_path))
    with ros_session(exit_code=0), open_source(recording, reading.channel_map) as source, in_file(recording):
        from tam_calibration.nodes.player import Player, playback_of

        player = Player(playback_of(source, reading), rate, clock)
        _wait(player)
        _show(player, loop)


def _wait(player: "Player") -> None:
    for name in player.unknown_types:
        say(f"not played: {name} is not installed here", err=True)
    if not player.wait_for_subscribers(WAIT_S):
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
