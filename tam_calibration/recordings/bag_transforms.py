"""Where the frames of a bag's messages sit in the array's, by what was recorded of `/tf_static`."""

from functools import cache
from pathlib import Path

from tam_calibration.messages.point_cloud import FRAME_ID
from tam_calibration.messages.transforms import STATIC_TRANSFORMS, TransformTree
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray
from tam_calibration.recordings.array_yaml import LookUp
from tam_calibration.recordings.bag_storages import is_bag


def transforms_in(path: Path) -> LookUp:
    """Return what looks frames up in a recording, which is read when the first is asked for.

    Parameters
    ----------
    path : Path
        A bag with `/tf_static`; of a CSV file no frame is known.
    """
    tree_of = cache(_tree_of)

    def look_up(frame: str) -> tuple[FloatArray, FloatArray]:
        pose = tree_of(path).pose(frame, FRAME_ID)
        if pose is None:
            raise InputError(
                f"{path} has no {STATIC_TRANSFORMS} that leads from {FRAME_ID} to {frame}: state positions_m and "
                "rotations_deg in the array file"
            )
        return pose

    return look_up


def _tree_of(path: Path) -> TransformTree:
    tree = TransformTree()
    if is_bag(path):
        from tam_calibration.recordings.bag_reader import open_bag, raw_messages

        with open_bag(path) as reader:
            connections = [each for each in reader.connections if each.topic == STATIC_TRANSFORMS]
            for _, _, message in raw_messages(reader, connections) if connections else ():
                tree.add(message)
    return tree
