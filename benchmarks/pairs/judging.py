"""The answer to a pair: what `tam compare` says of its files, and of nothing else."""

import traceback
from pathlib import Path
from time import process_time
from typing import Any

from pairs.folder import ANSWERS, FILES, SEALED, mended_path
from tam_calibration.comparison.compare import compare
from tam_calibration.files.text_files import to_json, write_whole
from tam_calibration.recordings import read_array, read_recording
from tam_calibration.results.comparison_json import comparison_to_mapping


def answer(folder: Path, name: str) -> None:
    """Compare a pair, and write the answer."""
    _write_answer(folder / ANSWERS / f"{name}.json", folder / name / FILES[0], folder / name)


def truth_path(folder: Path, name: str) -> Path:
    """Return where the comparison of the simulation that its maker mended lies."""
    return folder / SEALED / f"{name}.left.json"


def compare_mended(folder: Path, name: str) -> None:
    """Compare the recording with the simulation to which its maker added what it lacked."""
    _write_answer(truth_path(folder, name), mended_path(folder, name), folder / name)


def _write_answer(path: Path, simulation: Path, pair: Path) -> None:
    """Write what the comparison says; a defect of it is an answer too: no other pair may be lost by it."""
    began = process_time()
    try:
        content = _compared(simulation, pair)
    except Exception:
        content = {"verdict": "error", "why": traceback.format_exc()}
    path.parent.mkdir(exist_ok=True)
    content |= {"processor_time_s": process_time() - began}
    with write_whole(path) as beside:
        beside.write_text(to_json(content), encoding="utf-8")


def _compared(simulation: Path, pair: Path) -> dict[str, Any]:
    array = read_array(pair / FILES[2])
    comparison = compare(read_recording(simulation), read_recording(pair / FILES[1]), array)
    return comparison_to_mapping(comparison)
