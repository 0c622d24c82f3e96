"""`tam recover`: from a bag that its recorder left unfinished, or that is damaged, to a clean one."""

from pathlib import Path

import click

from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import PATH
from tam_calibration.files.text_files import to_json
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.extras import require
from tam_calibration.recordings.bag_storages import is_bag
from tam_calibration.results.overwriting import require_separate


@click.command()
@click.argument("bag", type=PATH)
@click.option("-o", "--output", type=PATH, required=True, help="The folder of a new bag, or an .mcap file.")
@click.option("--json", "as_json", is_flag=True, help="Print what was recovered as JSON.")
def command(bag: Path, output: Path, as_json: bool) -> None:
    """Write every complete message of an unfinished, cut or damaged BAG to a new bag.

    BAG is not changed. Damaged messages are left out and listed.
    """
    if not is_bag(bag):
        raise InputError(f"{bag} is no bag: only bags can be recovered, a rosbag2 folder, an .mcap or a .db3 file")
    require_separate([output], [bag])
    require("bags", "recovering bags")
    from tam_calibration.recordings.bag_recovery import recover

    found = recover(bag, output)
    summary = {
        "output": str(output),
        "messages": found.messages,
        "begins_s": found.first_ns / 1e9,
        "ends_s": found.last_ns / 1e9,
        "faults": list(found.faults),
    }
    say(to_json(summary) if as_json else f"{output}: {found}")
