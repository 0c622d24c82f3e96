"""A set of cases on disk: case_0001/data.csv and spec.yaml, commitments.json that seals the keys, keys.json apart."""

import hashlib
import json
import secrets
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from tam_calibration.files.schema import check
from tam_calibration.files.text_files import in_file, read_text, write_text
from tam_calibration.model.exceptions import InputError, Refused, quoted
from tam_validation.blind.answer import Answer
from tam_validation.blind.case import Case
from tam_validation.blind.catalogue import CATALOGUE
from tam_validation.blind.outcome import Outcome


def seal(key: dict[str, Any]) -> tuple[dict[str, Any], str]:
    """Return a key with a random nonce, and the SHA-256 of both."""
    sealed = {"nonce": secrets.token_hex(16), **key}
    return sealed, commitment(sealed)


def commitment(sealed: dict[str, Any]) -> str:
    """Return the SHA-256 of a key with its nonce."""
    return hashlib.sha256(json.dumps(sealed, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def check_seals(keys: dict[str, dict[str, Any]], commitments: dict[str, str]) -> None:
    """Hold the keys against what was committed to.

    Raises
    ------
    Refused
        When a key is not the one committed to, or is missing.
    """
    missing = sorted(set(commitments) - set(keys))
    if missing:
        raise Refused(f"the key of {missing[0]} is missing, though it was committed to")
    for name, sealed in keys.items():
        if commitments.get(name) != commitment(sealed):
            raise Refused(f"the key of {name} is not the one that was committed to: it was altered afterwards")


KEYS = "keys.json"
COMMITMENTS = "commitments.json"
TIMES = "answer_times_s.json"


def case_name(number: int) -> str:
    """Return the folder's name of a case."""
    return f"case_{number:04d}"


def write_case(folder: Path, case: Case) -> None:
    """Write what is given out of a case; fields to 1e-6 nT."""
    folder.mkdir(parents=True, exist_ok=True)
    table = np.stack(list(case.columns.values()), axis=1)
    np.savetxt(folder / "data.csv", table, fmt="%.6f", delimiter=",", header=",".join(case.columns), comments="")
    # JSON is YAML too.
    lines = [f"{name}: {json.dumps(value)}\n" for name, value in case.array.items()]
    (folder / "spec.yaml").write_text("".join(lines), encoding="utf-8")


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file."""
    write_text(path, json.dumps(content, indent=1) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file that holds keys and values.

    Raises
    ------
    InputError
        When it is none.
    """
    try:
        content = json.loads(read_text(path))
    except (json.JSONDecodeError, RecursionError):
        raise InputError(f"{path} is not a JSON file") from None
    if not isinstance(content, dict):
        raise InputError(f"{path} must hold keys and values in braces")
    return content


def read_times(folder: Path) -> dict[str, float]:
    """Return how long each answer took, seconds, where that is known.

    Raises
    ------
    InputError
        When the file of times holds others than numbers.
    """
    path = folder / TIMES
    times = read_json(path) if path.exists() else {}
    for name, time_s in times.items():
        if not isinstance(time_s, int | float):
            raise InputError(f"{path}: {quoted(name)} must be a number of seconds")
    return times


def case_folders(folder: Path) -> list[Path]:
    """Return the cases of a set, in order.

    Raises
    ------
    InputError
        When there is none.
    """
    cases = sorted(path.parent for path in folder.glob("*/data.csv"))
    if not cases:
        raise InputError(f"{folder} holds no case: a case is a folder with data.csv and spec.yaml")
    return cases


def read_keys(folder: Path, path: Path | None) -> dict[str, dict[str, Any]]:
    """Open the keys of a set.

    Raises
    ------
    InputError
        When keys or commitments cannot be read.
    Refused
        When a key is not the one that was committed to.
    """
    keys: dict[str, dict[str, Any]] = read_json(path or folder / KEYS)
    check_seals(keys, read_json(folder / COMMITMENTS))
    return keys


def read_outcomes(
    folder: Path, keys: dict[str, dict[str, Any]], answer: str, others: Collection[str] = ()
) -> list[Outcome]:
    """Return keys and answers of the cases that were answered.

    Parameters
    ----------
    folder : Path
        Of the cases.
    keys : dict
        By the names of the cases.
    answer : str
        Name of the file in the folder of each case.
    others : collection of str
        Effects that an answer may name beside those of the catalogue.

    Raises
    ------
    InputError
        When an answer is none of ``tam diagnose``, or names an effect that there is not.
    """
    paths = {name: folder / name / answer for name in keys}
    known = {*CATALOGUE, *others}
    return [_read_outcome(name, keys[name], path, known) for name, path in paths.items() if path.exists()]


def _read_outcome(name: str, key: dict[str, Any], path: Path, known: Collection[str]) -> Outcome:
    answer = read_json(path)
    with in_file(path):
        for cause in check(answer, Answer).causes or ():
            if cause.effect not in known:
                raise InputError(f"there is no effect {quoted(cause.effect)}: name {', '.join(sorted(known))}")
    return Outcome(name, key, answer)
