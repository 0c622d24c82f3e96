"""Speed of reading bags, over iterating their raw messages with rosbags and over deserialising each of them."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from bag_making import STORAGES, copy, make_recording
from rich.progress import track
from rosbags.rosbag2 import Reader
from spread import Row, measure

from tam_calibration.recordings import read_samples
from tam_calibration.recordings.bag_writing import TYPESTORE
from tam_calibration.recordings.channel_map import Reading, map_of
from tam_calibration.results import write_recording

MAP = map_of(
    {
        "sensors": [{"topic": f"/tam_{number}/magnetic_field"} for number in range(1, 5)],
        "scalar": {"topic": "/scalar/intensity"},
    }
)


def reading(folder: Path, samples: int, repeats: int) -> Iterator[Row]:
    """Yield how many times faster a recording is there than rosbags has read its messages."""
    write_recording(folder / "made", make_recording(samples))
    for case, (storage, compression) in track(STORAGES.items(), description="reading"):
        path = folder / case.replace(", ", "_").replace(" ", "_")
        copy(folder / "made", path, storage, compression)
        calls: dict[str, Callable[[], object]] = {
            "raw": partial(iterate, path, False),
            "deserialised": partial(iterate, path, True),
            "ours": partial(read_samples, path),
            "with a map": partial(read_samples, path, reading=Reading(channel_map=MAP)),
        }
        times = measure(calls, repeats)
        yield Row(case, "deserialising one by one over reading", list(times["deserialised"] / times["ours"]), 10)
        yield Row(case, "iterating raw over reading", list(times["raw"] / times["ours"]), 0.7)
        yield Row(case, "reading with a map over reading", list(times["with a map"] / times["ours"]), most=1.05)


def iterate(path: Path, deserialise: bool) -> None:
    """Read a bag with rosbags alone."""
    with Reader(path) as reader:
        for connection, _, message in reader.messages(reader.connections):
            if deserialise:
                TYPESTORE.deserialize_cdr(message, connection.msgtype)
