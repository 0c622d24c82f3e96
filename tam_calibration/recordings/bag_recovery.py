"""Recovery of unfinished or damaged bags: their complete messages are written to a new bag."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from tam_calibration.files.text_files import require_regular
from tam_calibration.files.whole_files import temporary_place, unfinished
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.bag_bounds import damage_named
from tam_calibration.recordings.bag_folder import data_files
from tam_calibration.recordings.bag_reader import BagReader, raw_blocks
from tam_calibration.recordings.bag_recovered import Recovered, RecoveredFile, room_named, unpacked
from tam_calibration.recordings.bag_storages import READABLE, serialisation_of, storage_of
from tam_calibration.recordings.bag_writing import copy_connection, write_bag

log = logging.getLogger(__name__)


def recover(path: Path, target: Path) -> Recovered:
    """Write a bag of all messages of another that are complete, in the order in which they were written.

    Parameters
    ----------
    path : Path
        The bag, which may be unfinished or damaged, and is not changed.
    target : Path
        The bag to write: a folder of the same storage, or a single file where its storage has single files.

    Raises
    ------
    InputError
        When it is no bag, no message of it is complete, or the new one cannot be written.
    """
    require_regular(path)
    faults: list[str] = []
    with unfinished(temporary_place()) as folder:
        with room_named(path):
            files = unpacked(data_files(path), folder, faults)
        faults += [f"{file.name} is missing" for file in files if not file.exists()]
        with damage_named(path, may_recover=False):
            bag = BagReader(path, [RecoveredFile(file, faults) for file in files if file.exists()])
        readable = [one for one in bag.topics if serialisation_of(one) in READABLE]
        if not readable:
            raise InputError(f"{path} is damaged or truncated: no message in it is complete")
        with write_bag(target, storage_of(path)) as writer:
            ids = np.array([copy_connection(writer, one).id for one in readable])
            for block in raw_blocks(bag, readable):
                writer.write_block(replace(block, connection=ids[block.connection]))
    for one in bag.topics:
        if one not in readable:
            what = f"{one.msgcount} messages of {one.topic} in {serialisation_of(one)}"
            log.warning("%s: %s are left out", path, what)
    count = sum(one.msgcount for one in readable)
    return Recovered(count, bag.start_time, bag.start_time + bag.duration, tuple(faults))
