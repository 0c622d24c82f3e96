"""How long ``tam inspect`` takes for 100 MB: ``python benchmarks/inspecting.py``; or for files of one's own.

It writes five recordings: a bag of five topics, a bag with images of 1 MB, a text of fourteen columns, and logs of PX4
and ArduPilot. It times the whole command, after a first run that fills the caches.
"""

import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory
from time import perf_counter

import click
import numpy as np
from bag_making import RATE_HZ, START_S, make_recording
from rosbags.rosbag2 import StoragePlugin, Writer
from spread import Row, show

from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.recordings.bag_writing import TYPESTORE
from tam_calibration.results import write_recording

ASKED_S = 2.0
"""Longest time for 100 MB on two idle cores: a person waits so long for a first look."""
SAMPLES = {"bag": 117_000, "text": 386_000, "ulog": 556_000, "dataflash": 952_000}
"""Of recordings of 100 MB."""
IMAGES, PIXELS = 95, (1000, 1000)
FIELD, IMAGE = "sensor_msgs/msg/MagneticField", "sensor_msgs/msg/Image"


def write_with_images(path: Path) -> None:
    """Write a bag of images and of one sensor, by rosbags alone."""
    types = TYPESTORE.types
    image = np.zeros(PIXELS[0] * PIXELS[1], np.uint8)
    readings = make_recording(1000).readings_T[:, 0]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {kind: writer.add_connection(name, kind, typestore=TYPESTORE) for name, kind in _TOPICS.items()}
        for number, reading in enumerate(readings):
            time_ns = round((START_S + number / RATE_HZ) * 1e9)
            stamp = types["builtin_interfaces/msg/Time"](time_ns // 10**9, time_ns % 10**9)
            header = types["std_msgs/msg/Header"](stamp, "mag")
            field = types[FIELD](header, types["geometry_msgs/msg/Vector3"](*reading), np.zeros(9))
            writer.write(topics[FIELD], time_ns, TYPESTORE.serialize_cdr(field, FIELD))
            if number % (len(readings) // IMAGES) == 0:
                picture = types[IMAGE](header, *PIXELS, "mono8", 0, PIXELS[1], image)
                writer.write(topics[IMAGE], time_ns, TYPESTORE.serialize_cdr(picture, IMAGE))


_TOPICS = {"/mag": FIELD, "/camera": IMAGE}


def write_ulog(path: Path) -> None:
    """Write four instances of ``sensor_mag``, as PX4 does."""
    fields = "uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float x;float y;float z;"
    texts = [b"F" + f"sensor_mag:{fields}uint32_t error_count;float temperature;".encode()]
    texts += [b"A" + struct.pack("<BH", number, number) + b"sensor_mag" for number in range(4)]
    head = b"ULog\x01\x12\x35\x01" + bytes(8) + struct.pack("<HB", 40, ord("B")) + bytes(40)
    recording = make_recording(SAMPLES["ulog"])
    kind = "<u2,u1,<u2,<u8,<u8,<u4,(3,)<f4,<u4,<f4"
    rows = np.zeros((recording.sample_count, 4), kind)
    rows["f0"], rows["f1"], rows["f2"] = rows.itemsize - 3, ord("D"), range(4)
    rows["f3"] = rows["f4"] = _microseconds(recording.time_s)[:, None]
    rows["f6"] = 1e4 * recording.readings_T
    path.write_bytes(head + b"".join(struct.pack("<H", len(each) - 1) + each for each in texts) + rows.tobytes())


def write_dataflash(path: Path) -> None:
    """Write three instances of ``MAG``, as ArduPilot does."""
    columns = b"TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S"
    kind = "<u2,u1,<u8,u1,(9,)<i2,u1,<u4"
    recording = make_recording(SAMPLES["dataflash"])
    rows = np.zeros((recording.sample_count, 3), kind)
    rows["f0"], rows["f1"], rows["f3"], rows["f5"] = _BEGINNING, 140, range(3), 1
    rows["f2"] = _microseconds(recording.time_s)[:, None]
    rows["f4"][..., :3] = np.round(1e7 * recording.readings_T[:, :3])
    described = [
        (128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"),
        (130, 44, b"FMTU", b"QBNN", b"TimeUS,FmtType,UnitIds,MultIds"),
        (140, rows.itemsize, b"MAG", b"QBhhhhhhhhhBI", columns),
    ]
    head = [struct.pack("<HBBB4s16s64s", _BEGINNING, 128, *each) for each in described]
    units = struct.pack("<HBQB16s16s", _BEGINNING, 130, 0, 140, b"s#GGGGGGGGG-s", b"F-CCCCCCCCC-F")
    path.write_bytes(b"".join(head) + units + rows.tobytes())


_BEGINNING = 0x95A3
"""With which a message of DataFlash begins."""


def _microseconds(time_s: FloatArray) -> IntArray:
    return np.round(1e6 * (time_s - time_s[0])).astype(np.int64) + 5_000_000


def make(folder: Path) -> Iterator[Path]:
    """Write the recordings, and yield their paths."""
    write_recording(folder / "fields.mcap", make_recording(SAMPLES["bag"]))
    write_with_images(folder / "images")
    write_recording(folder / "rows.csv", make_recording(SAMPLES["text"]))
    write_ulog(folder / "px4.ulg")
    write_dataflash(folder / "ardupilot.bin")
    yield from (folder / name for name in ("fields.mcap", "images", "rows.csv", "px4.ulg", "ardupilot.bin"))


@click.command(help=__doc__)
@click.argument("files", nargs=-1, type=click.Path(path_type=Path, exists=True))
@click.option("--repeats", default=5, show_default=True)
def main(files: tuple[Path, ...], repeats: int) -> None:
    """Print seconds, and megabytes a second."""
    rows = []
    with TemporaryDirectory() as folder:
        for path in files or tuple(make(Path(folder))):
            parts = path.rglob("*") if path.is_dir() else [path]
            megabytes = sum(part.stat().st_size for part in parts) / 1e6
            seconds, busy = np.array([_seconds(path) for _ in range(repeats + 1)][1:]).T
            case = f"{path.name}, {megabytes:.0f} MB"
            rows.append(Row(case, "seconds", seconds, most=ASKED_S * megabytes / 100))
            rows.append(Row(case, "seconds of CPU", busy))
            rows.append(Row(case, "MB/s", megabytes / seconds))
    show("tam inspect", "python benchmarks/inspecting.py", "inspecting.csv", rows)


def _seconds(path: Path) -> tuple[float, float]:
    """Return how long the command takes, and how much of the processors' time."""
    begin, before = perf_counter(), sum(getrusage(RUSAGE_CHILDREN)[:2])
    done = subprocess.run([sys.executable, "-m", "tam_calibration", "inspect", path], stdout=subprocess.DEVNULL)
    if done.returncode > 1:
        raise click.ClickException(f"{path} cannot be inspected")
    return perf_counter() - begin, sum(getrusage(RUSAGE_CHILDREN)[:2]) - before


if __name__ == "__main__":
    main()
