"""Small files and short words that ask for much memory or time."""

import os
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import yaml
import zstandard
from numpy.random import Generator

from battery.recipes import Recipe
from battery.trial import May, Trial, pick

_MAGIC = b"\x89MCAP0\r\n"


def _zeros(rng: Generator) -> bytes:
    """Return some hundred kilobytes of zstd that are gigabytes of zeros."""
    frame = zstandard.ZstdCompressor(level=1).compress(bytes(1 << 26))
    return frame * int(rng.integers(50, 100))


def _record(kind: int, content: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(content)) + content


def _text(words: str) -> bytes:
    return struct.pack("<I", len(words)) + words.encode()


def _mcap(folder: Path, rng: Generator) -> str:
    """Write an mcap whose chunk claims, or unpacks to, gigabytes."""
    claimed = int(pick(rng, (1 << 33, 1 << 40, (1 << 64) - 1, 1 << 26)))
    packed = _zeros(rng) if rng.random() < 0.7 else rng.bytes(100)
    method = pick(rng, ("zstd", "zstd", "lz4", ""))
    chunk = struct.pack("<QQQI", 0, 1, claimed, 0) + _text(method) + struct.pack("<Q", len(packed)) + packed
    header, footer = _record(1, _text("") + _text("")), _record(2, bytes(20))
    (folder / "run.mcap").write_bytes(_MAGIC + header + _record(6, chunk) + _record(15, bytes(4)) + footer + _MAGIC)
    return f"a chunk of {claimed} bytes in {method or 'no'} compression"


def _claims(folder: Path, rng: Generator) -> str:
    """Let lengths in an mcap claim more than there is."""
    path = folder / "run.mcap"
    data = bytearray(path.read_bytes())
    for place in rng.integers(8, len(data) - 8, size=3):
        data[place : place + 8] = struct.pack("<Q", int(2 ** rng.uniform(30, 63)))
    path.write_bytes(data)
    return "lengths beyond the end"


def _packed_bag(folder: Path, rng: Generator) -> str:
    """Put zeros without end into a bag that is packed as a file."""
    [path] = (folder / "run_zstd").glob("*.zstd")
    path.write_bytes(_zeros(rng))
    return "a file that unpacks to gigabytes"


def _endless_metadata(folder: Path, rng: Generator) -> str:
    """Have metadata that never end."""
    path = folder / "run_sqlite3" / "metadata.yaml"
    path.unlink()
    path.symlink_to(pick(rng, ("/dev/zero", "/dev/urandom")))
    return "metadata without end"


def _piped_metadata(folder: Path, rng: Generator) -> str:
    """Have metadata that never come."""
    path = folder / "run_sqlite3" / "metadata.yaml"
    path.unlink()
    os.mkfifo(path)
    return "metadata from a pipe"


def _many_messages(folder: Path, rng: Generator) -> str:
    """Let metadata claim messages without number."""
    path = folder / "run_sqlite3" / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    information = content["rosbag2_bagfile_information"]
    information["message_count"] = int(10 ** rng.uniform(9, 30))
    information["relative_file_paths"] *= int(10 ** rng.uniform(0, 4))
    path.write_text(yaml.safe_dump(content))
    return "metadata of many messages and files"


def _header(folder: Path, rng: Generator) -> str:
    """Name a sensor of a high number, or very many columns."""
    path = folder / "run.csv"
    header, rest = path.read_text().split("\n", 1)
    number = int(10 ** rng.uniform(3, 12))
    many = ",".join(f"b{k}{axis}_nT" for k in range(1, min(number, 300_000)) for axis in "xyz")
    path.write_text(f"{pick(rng, (header.replace('b4x', f'b{number}x'), 'time_s,' + many, header * 999))}\n{rest}")
    return f"columns up to sensor {number}"


def _pause(folder: Path, rng: Generator) -> str:
    """Lie in two blocks that are years apart."""
    path = folder / "run.csv"
    lines = path.read_text().splitlines()
    pause = 10 ** rng.uniform(7, 12)
    for place in range(int(rng.integers(2, len(lines))), len(lines)):
        time, rest = lines[place].split(",", 1)
        lines[place] = f"{float(time) + pause!r},{rest}"
    path.write_text("\n".join(lines) + "\n")
    return f"a pause of {pause:.2g} s"


def _line(folder: Path, rng: Generator) -> str:
    """Hold one line without end."""
    path = folder / "run.csv"
    path.write_text(path.read_text() + pick(rng, ("1", ",", "x", '"')) * int(10 ** rng.uniform(7, 8)))
    return "a long last line"


def _scenario(folder: Path, rng: Generator) -> str:
    """Ask for more samples than memory holds."""
    path = folder / "scenario.yaml"
    content = yaml.safe_load(path.read_text())
    key = pick(rng, ("samples", "rate_hz"))
    content[key] = int(10 ** rng.uniform(9, 18))
    path.write_text(yaml.safe_dump(content))
    return f"{key}: {content[key]}"


def _array(folder: Path, rng: Generator) -> str:
    """Have a great many sensors."""
    count = int(10 ** rng.uniform(3, 4.5))
    positions = rng.normal(size=(count, 3)).round(3).tolist()
    (folder / "array.yaml").write_text(yaml.safe_dump({"positions_m": positions, "vector_noise_nT": 1.0}))
    return f"{count} sensors"


_BOMBS: dict[str, tuple[tuple[Callable[[Path, Generator], str], May], ...]] = {
    "run.mcap": ((_mcap, May.REFUSE), (_claims, May.DO_THE_SAME)),
    "run_zstd": ((_packed_bag, May.REFUSE),),
    "run_sqlite3": (
        (_endless_metadata, May.DO_THE_SAME),
        (_piped_metadata, May.DO_THE_SAME),
        (_many_messages, May.DO_THE_SAME),
    ),
    "run.csv": ((_header, May.REFUSE), (_pause, May.DO_ANYTHING), (_line, May.REFUSE)),
    "scenario.yaml": ((_scenario, May.REFUSE),),
    "array.yaml": ((_array, May.REFUSE),),
}


def spoil(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Put a bomb in the place of an input, or ask for too much in words."""
    if recipe.name == "plan":
        count = int(10 ** rng.uniform(5, 12))
        words = pick(rng, (("--poses", str(count)), ("--samples-per-pose", str(count)), ("--turntable", "0.01")))
        trial = Trial.of(recipe, " ".join(words), May.DO_ANYTHING)
        return replace(trial, line=(*recipe.line, *words))
    make, may = pick(rng, [bomb for name in recipe.reads for bomb in _BOMBS.get(name, ())])
    if make is _array and recipe.command == "plan":
        may = May.DO_ANYTHING
    return Trial.of(recipe, make(folder, rng), may)
