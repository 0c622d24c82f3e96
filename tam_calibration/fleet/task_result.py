"""What became of one recording: the file ``result.json`` of its folder, written last."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from tam_calibration.files.recording_file import provenance
from tam_calibration.files.text_files import to_json

SCHEMA = "tam_calibration/batch_result/1"
RESULT = "result.json"
ANSWERS = ("no_gap", "explained")
"""Verdicts that leave nothing open."""

Status = Literal["done", "refused", "failed"]


@dataclass(frozen=True)
class Seal:
    """By what a recording is known to be the same: size, time of the last change, and SHA-256 of its data."""

    size_bytes: int
    modified_ns: int
    sha256: str

    def holds(self, path: Path) -> bool:
        """Whether a recording is still the same; its content is read only where its time has changed."""
        size, modified = state_of(path)
        return size == self.size_bytes and (modified == self.modified_ns or provenance(path).sha256 == self.sha256)


@dataclass(frozen=True)
class Result:
    """What became of one recording.

    Parameters
    ----------
    recording, platform, path : str
        Name of the recording, of the folder that it lies in, and its whole path.
    status : str
        ``done``; ``refused`` when it could be read, but not be calibrated or diagnosed, which is an answer; ``failed``
        when it could not be read or corrected, which is tried again the next time.
    problems : mapping
        What kept a step (read, calibrate, diagnose, correct) from its result, one sentence each.
    options : str
        Digest of what was asked for.
    seal : Seal, optional
        Of the recording; None where it could not be read.
    samples : int
        Number of samples.
    time_span_s : (float, float), optional
        First and last time stamp, seconds.
    sensors : sequence of mapping
        Errors of each sensor with standard errors, as in the calibration file; empty without a calibration.
    gap : mapping, optional
        The verdict on the gap, its statement, its size before and after, and its causes by name.
    corrected : str, optional
        Name of the file of corrected data.
    """

    recording: str
    platform: str
    path: str
    status: Status
    problems: Mapping[str, str]
    options: str
    seal: Seal | None = None
    samples: int = 0
    time_span_s: tuple[float, float] | None = None
    sensors: Sequence[Mapping[str, Any]] = field(default=(), repr=False)
    gap: Mapping[str, Any] | None = None
    corrected: str | None = None

    @property
    def verdict(self) -> str:
        """The verdict on the gap; empty where there is none."""
        return "" if self.gap is None else str(self.gap["verdict"])

    @property
    def is_settled(self) -> bool:
        """Whether every step was done and nothing of the gap stays open."""
        return self.status == "done" and self.verdict in ANSWERS

    @property
    def trouble(self) -> str:
        """What went wrong, as one text; empty where nothing did."""
        return "; ".join(f"{step}: {sentence}" for step, sentence in self.problems.items())


def write_result(folder: Path, result: Result) -> None:
    """Write a result into its folder.

    Parameters
    ----------
    folder : Path
        Folder of the recording's task; an older result there is overwritten.
    result : Result
        What became of the recording.
    """
    content = json.loads(to_json({"schema": SCHEMA} | asdict(result)))
    (folder / RESULT).write_text(to_json(content | {"digest": _digest(content)}), encoding="utf-8")


def read_result(folder: Path) -> Result | None:
    """Return the result that a folder holds; None where it holds none, or one that is not as it was written."""
    try:
        content = json.loads((folder / RESULT).read_text(encoding="utf-8"))
        if content.pop("digest") != _digest(content) or content.pop("schema") != SCHEMA:
            return None
        seal, span, sensors = (content.pop(key) for key in ("seal", "time_span_s", "sensors"))
        return Result(**content, seal=seal and Seal(**seal), time_span_s=span and tuple(span), sensors=tuple(sensors))
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None


def _digest(content: Mapping[str, Any]) -> str:
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def state_of(path: Path) -> tuple[int, int]:
    """Return size in bytes and time, ns, of the last change of a file, or of all files of a folder."""
    parts = [part for part in path.iterdir() if part.is_file()] if path.is_dir() else [path]
    states = [part.stat() for part in parts]
    return sum(state.st_size for state in states), max((state.st_mtime_ns for state in states), default=0)
