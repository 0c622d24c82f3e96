"""`tam play`: play a bag onto its topics."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tam_calibration.cli.terminal import PATH, Number
from tam_calibration.files.recording_file import is_bag
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.extras import require
from tam_calibration.nodes.session import ros_session

if TYPE_CHECKING:
    from tam_calibration.nodes.player import Player

WAIT_S = 10.0
"""Longest wait for a subscriber: nodes that start beside the player are there within some seconds."""

_SLOWEST = 0.001
"""Least rate: an hour would last six weeks."""


@click.command()
@click.argument("bag", type=PATH)
@click.option(
    "--rate",
    type=Number(min=_SLOWEST),
    default=1.0,
    show_default=True,
    help="How many times faster than recorded.",
)
@click.option("--loop", is_flag=True, help="Begin again at the end; stamps then go backwards.")
@click.option("--clock", is_flag=True, help="Publish the bag's time on /clock, for nodes with use_sim_time.")
def command(bag: Path, rate: float, loop: bool, clock: bool) -> None:
    """Play every topic of BAG, a rosbag2 folder or .mcap file, once somebody listens to the sensors."""
    if not is_bag(bag):
        raise InputError(f"{bag} is no bag: only bags can be played, a rosbag2 folder or an .mcap file")
    require("bags", "playing bags")
    from tam_calibration.files.bag import open_bag

    with ros_session(exit_code=0), open_bag(bag) as reader:
        from tam_calibration.nodes.player import Player

        player = Player(reader, rate, clock)
        _wait(player)
        _show(player, loop)


def _wait(player: "Player") -> None:
    for name in player.unknown_types:
        click.echo(f"not played: {name} is not installed here", err=True)
    if not player.wait_for_subscribers(WAIT_S):
        click.echo(f"nobody listens to {', '.join(player.unheard())}; playing all the same", err=True)


def _show(player: "Player", loop: bool) -> None:
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("playing", total=player.duration_s)
        while True:
            begin = time.monotonic()
            count = 0
            for position_s in player.play():
                count += 1
                progress.update(task, completed=position_s)
            progress.update(task, completed=player.duration_s)
            progress.console.print(f"{count} messages in {time.monotonic() - begin:.1f} s")
            if not loop:
                return
