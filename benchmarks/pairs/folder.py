"""A set of pairs on disk: pair_001/simulation.csv, recording.csv and array.yaml; the key and what seals it; answers."""

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from pairs.making import Columns, Pair
from tam_calibration.files.text_files import write_whole
from tam_calibration.model.exceptions import InputError, Refused
from tam_validation.blind.folder import read_json, write_json

KEY, SEAL, SEALED, ANSWERS, SETTINGS = "key.json", "key.sha256", "sealed", "answers", "settings.json"
FILES = ("simulation.csv", "recording.csv", "array.yaml")


def pair_name(number: int) -> str:
    """Return the folder's name of a pair."""
    return f"pair_{number:03d}"


def begin(folder: Path, settings: dict[str, Any]) -> None:
    """Begin a set, or go on with it.

    Raises
    ------
    InputError
        When the folder holds another one.
    """
    (folder / SEALED).mkdir(parents=True, exist_ok=True)
    path = folder / SETTINGS
    if not path.exists():
        write_json(path, settings)
    if read_json(path) != settings:
        raise InputError(f"{folder} holds pairs that were made otherwise: name a new folder")


def write_pair(folder: Path, name: str, pair: Pair) -> None:
    """Write a pair, its key last: what has one is whole."""
    place = folder / name
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    for file, columns in zip(FILES, (pair.simulation, pair.recording), strict=False):
        _write_columns(place / file, columns)
    # JSON is YAML too.
    (place / FILES[2]).write_text(json.dumps(pair.array) + "\n", encoding="utf-8")
    if pair.mended is not None:
        _write_columns(mended_path(folder, name), pair.mended)
    write_json(key_path(folder, name), pair.key)


def _write_columns(path: Path, columns: Columns) -> None:
    """Write a table; fields to 1e-6 nT."""
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, table, fmt="%.6f", delimiter=",", header=",".join(columns), comments="")


def key_path(folder: Path, name: str) -> Path:
    """Return where the key of a pair lies."""
    return folder / SEALED / f"{name}.json"


def mended_path(folder: Path, name: str) -> Path:
    """Return where the simulation lies to which its maker added what it lacked."""
    return folder / SEALED / f"{name}.csv"


def seal(folder: Path, names: list[str]) -> str:
    """Write the keys of all pairs to one file, and its SHA-256 beside it, which is returned."""
    write_json(folder / KEY, {name: read_json(key_path(folder, name)) for name in names})
    digest = _digest(folder)
    with write_whole(folder / SEAL) as beside:
        beside.write_text(digest + "\n", encoding="utf-8")
    return digest


def _digest(folder: Path) -> str:
    return hashlib.sha256((folder / KEY).read_bytes()).hexdigest()


def open_key(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the keys of all pairs.

    Raises
    ------
    Refused
        When the file is not the one that was sealed.
    """
    keys = read_json(folder / KEY)
    if _digest(folder) != (folder / SEAL).read_text(encoding="utf-8").strip():
        raise Refused(f"{folder / KEY} is not the key that was sealed: it was altered afterwards")
    return keys


def pair_names(folder: Path) -> list[str]:
    """Return the pairs of a set, in order.

    Raises
    ------
    InputError
        When it is not made, or not whole.
    """
    names = sorted(path.name for path in folder.glob("pair_*") if path.is_dir())
    if not (folder / SEAL).exists() or not names:
        raise InputError(f"{folder} holds no set of pairs that was sealed: make it, to its end")
    return names
