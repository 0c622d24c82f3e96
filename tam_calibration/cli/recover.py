"""`tam recover`: from a bag that its recorder left unfinished, or that is damaged, to a clean one."""

from pathlib import Path

import click

from tam_calibration.cli.terminal import PATH, Answer, answering, next_command
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.libraries import require
from tam_calibration.recordings.bag_storages import is_bag
from tam_calibration.results.overwriting import require_separate


@click.command()
@click.argument("bag", type=PATH)
@click.option("-o", "--output", type=PATH, required=True, help="The folder of a new bag, or an .mcap file.")
@answering
def command(bag: Path, output: Path, answer: Answer) -> None:
    """Write every complete message of an unfinished, cut or damaged BAG to a new bag.

    BAG is not changed. Damaged messages are left out and listed.
    """
    if not is_bag(bag):
        raise InputError(f"{bag} is no bag: only bags can be recovered, a rosbag2 folder, an .mcap or a .db3 file")
    require_separate([output], [bag])
    require("bags", "recovering bags")
    from tam_calibration.recordings.bag_writing import recover

    with answer.files([bag, output]):
        found = recover(bag, output)
        content = {
            "output": str(output),
            "messages": found.messages,
            "begins_s": found.first_ns / 1e9,
            "ends_s": found.last_ns / 1e9,
            "faults": list(found.faults),
        }
        answer.give(content, f"{output}: {found}", advice=next_command("inspect", output))
