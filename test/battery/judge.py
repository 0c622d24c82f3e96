"""What became of a trial: nothing bad, or one of the bad classes."""

import re
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from enum import Enum
from hashlib import sha256
from pathlib import Path
from urllib.parse import quote

import numpy as np

from battery.run import MEMORY_BYTES
from battery.surroundings import Ended
from battery.trial import May, Trial


class Bad(Enum):
    """The bad classes, worst first."""

    TRACEBACK = "traceback or death by a signal"
    NUMBERS = "other numbers, exit 0"
    ACCEPTED = "accepted though nonsense"
    LEFT = "something left behind or changed"
    HUNG = "hung"
    MEMORY = "more than 1.5 GiB"
    CODE = "wrong exit code"
    NOISE = "noise beside or in the sentence"


Files = Mapping[str, str]
"""Digests of files by their paths in the folder of a case; of others what they are."""

_TRACEBACK = re.compile(r"Traceback \(most recent|Fatal Python error|Exception ignored|Error in sys\.|core dumped")
_OUT_OF_MEMORY = re.compile(r"MemoryError|Unable to allocate|cannot allocate memory", re.IGNORECASE)
_WARNED = re.compile(r"\b[A-Z]\w+Warning: ")
"""Of Python and its libraries; ours has no word before it."""
_OF_PYTHON = re.compile(
    r"not supported between|object is not|has no attribute|NoneType|invalid literal|could not convert|cannot unpack"
    r"|codec can't|unhashable|list index|must be str|dtype|could not be broadcast|numpy\.|<class |Unable to allocate"
    r"|0x[0-9a-f]{8}|positional argument|\[Errno"
)
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f\x9b]")
_NOTICE = re.compile(
    r"damage|recover|unfinished|truncat|checksum|CRC|cut off|not whole|do not agree|does not agree|rebuilt|lost", re.I
)
_WARNING = re.compile(
    r"^(Doubtful|Warning): |^warnings:\n?- |\"warnings\": \[\s*\"|\d+ of \d+ readings of|without a time"
    r"|repeats? the time before",
    re.M,
)
_TAKEN = re.compile(r"[^:]+: taken as |units by the size of the field: ")
_LONGEST_SENTENCE = 2100
_OF_THE_FILE = re.compile(r"sha256|_bytes|bytes:|software|written|\bname:|\"name\"|source")
"""Lines of a result that tell of the input's bytes, not of what it says."""
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_NAMES_FILES = re.compile(r"^(written|next): .*$", re.M)
_NO_NUMBER = re.compile(r"(?<![\w.])[-+]?\.?(nan|inf)\b", re.IGNORECASE)


def look(folder: Path) -> Files:
    """Return what a folder holds."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = f"link to {path.readlink()}"
        elif path.is_file():
            found[name] = sha256(path.read_bytes()).hexdigest()
        else:
            found[name] = "folder" if path.is_dir() else "other"
    return found


@dataclass(frozen=True)
class Answer:
    """The numbers of an answer, and whether it speaks of damage.

    Parameters
    ----------
    numbers : array
        All that stand in what was printed and written, in their order.
    text : str
        What was printed and written.
    """

    numbers: np.ndarray
    text: str

    @classmethod
    def of(cls, folder: Path, trial: Trial, ended: Ended) -> "Answer":
        """Return the answer of a command that has ended."""
        texts = [_text(path) for name in trial.recipe.writes for path in _files(folder / name)]
        said = _letters(ended.stdout) if not trial.recipe.writes and not trial.around.stdout else ""
        kept = [line for text in (*texts, said) for line in text.splitlines() if not _OF_THE_FILE.search(line)]
        numbers = np.array([float(each) for each in _NUMBER.findall("\n".join(kept))])
        return cls(numbers, "\n".join([*texts, ended.stdout, ended.stderr]))

    @classmethod
    def none(cls) -> "Answer":
        """Return the answer of what cannot be read."""
        return cls(np.array([]), "")

    def is_like(self, other: "Answer") -> bool:
        """Return whether the numbers are the same, but for rounding."""
        same = self.numbers.shape == other.numbers.shape
        return same and np.allclose(self.numbers, other.numbers, rtol=1e-9, atol=1e-12)


def _letters(said: str) -> str:
    """Return what was said with the letters that an encoding lacked, which were written by their numbers."""
    return re.sub(r"\\(?:u([0-9a-f]{4})|x([0-9a-f]{2}))", lambda found: chr(int(found[1] or found[2], 16)), said)


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        files = [each for each in path.rglob("*") if each.is_file() and each.name != ".lock"]
        return sorted(files, key=lambda each: (each.suffix, each))  # the names of some follow that of the folder
    return [path] if path.exists() else []


def _text(path: Path) -> str:
    """Return the text of an output; of a bag that its messages can be read, and what they are."""
    if path.suffix in (".mcap", ".db3"):
        rows = _rows_of_mcap(path) if path.suffix == ".mcap" else _rows_of_sqlite(path)
        return "\n".join(f"{time} {int(sha256(data).hexdigest()[:12], 16)}" for time, data in rows)
    return "" if path.suffix == ".html" else path.read_text(errors="replace")


def _rows_of_mcap(path: Path) -> list[tuple[int, bytes]]:
    from rosbags.rosbag2.storage_mcap import McapReader

    reader = McapReader(path)
    reader.open()
    rows = [(time, data) for _, time, data in reader.messages(reader.connections)]
    reader.close()
    return rows


def _rows_of_sqlite(path: Path) -> list[tuple[int, bytes]]:
    with closing(sqlite3.connect(f"file:{quote(str(path))}?immutable=1", uri=True)) as database:
        return database.execute("SELECT timestamp, data FROM messages ORDER BY timestamp, id").fetchall()


def judge(
    trial: Trial, ended: Ended, before: Files, after: Files, answer: Answer, good: Answer | None
) -> dict[Bad, str]:
    """Return what is bad about a run, by its class with the reason.

    Parameters
    ----------
    trial : Trial
        What was tried.
    ended : Ended
        How it ended.
    before, after : Files
        What the folder held.
    answer : Answer
        What the command made.
    good : Answer or None
        What it makes of what is not spoiled; None where that is not asked for.
    """
    found = {
        Bad.TRACEBACK: _traceback(trial, ended),
        Bad.NUMBERS: _numbers(trial, ended, answer, good),
        Bad.ACCEPTED: _accepted(trial, ended, answer),
        Bad.LEFT: _left(trial, ended, before, after),
        Bad.HUNG: f"after {ended.seconds:.0f} s" if ended.is_hung else "",
        Bad.MEMORY: _memory(ended),
        Bad.CODE: _code(trial, ended),
        Bad.NOISE: _noise(trial, ended),
    }
    if ended.is_hung:
        return {Bad.HUNG: found[Bad.HUNG]}
    return {bad: why for bad, why in found.items() if why}


def _was_ended(trial: Trial, ended: Ended) -> bool:
    """Return whether a command ended because it was told to."""
    number = trial.around.ended_by
    return number is not None and ended.code == 128 + number


def _traceback(trial: Trial, ended: Ended) -> str:
    said = ended.stdout + ended.stderr
    if ended.died and not _was_ended(trial, ended):
        return f"signal {ended.code - 128}"
    match = None if _OUT_OF_MEMORY.search(said) else _TRACEBACK.search(said)
    return said[match.start() :][-300:] if match else ""


def _memory(ended: Ended) -> str:
    if ended.memory_bytes > MEMORY_BYTES:
        return f"{ended.memory_bytes / 2**30:.1f} GiB"
    match = _OUT_OF_MEMORY.search(ended.stderr + ended.stdout)
    return match.group() if match else ""


def _numbers(trial: Trial, ended: Ended, answer: Answer, good: Answer | None) -> str:
    if ended.code or trial.may is not May.DO_THE_SAME or good is None:
        return ""
    if trial.around.stdout and not trial.recipe.writes:
        return ""  # nobody could read them
    if answer.is_like(good) or _NOTICE.search(_told(answer.text)):
        return ""
    return f"{len(answer.numbers)} numbers for {len(good.numbers)}, or others"


def _told(text: str) -> str:
    """Return the lines of an answer that may speak of damage: those with numbers alone do not."""
    return "\n".join(line for line in text.splitlines() if re.search("[a-z]{4}", line))


def _accepted(trial: Trial, ended: Ended, answer: Answer) -> str:
    if ended.code:
        return ""
    if trial.may is May.REFUSE:
        return "exit 0"
    if _WARNING.search(answer.text):
        return ""
    if trial.may is May.WARN:
        return "exit 0 without a warning"
    if trial.recipe.command == "calibrate" and _NO_NUMBER.search(_NAMES_FILES.sub("", answer.text)):
        return "the result holds NaN or infinity"
    return ""


def _left(trial: Trial, ended: Ended, before: Files, after: Files) -> str:
    if ended.left_running:
        return f"still running: {', '.join(ended.left_running)}"
    changed = [name for name in before if after.get(name) != before[name] and not _is_own(trial, name)]
    if changed:
        return f"changed: {', '.join(changed[:5])}"
    new = [name for name in after if name not in before]
    hidden = [name for name in new if Path(name).name.startswith(".") and Path(name).name != ".lock"]
    if hidden:
        return f"left: {', '.join(hidden[:5])}"
    if trial.recipe.in_steps and any(after[name] not in ("folder", "other") for name in new if ".lock" not in name):
        return ""  # what is done stays, and a second call does the rest
    keeps = not ended.code or is_answer(ended) or trial.recipe.tells_after_writing or bool(trial.around.stdout)
    if new and not (keeps or trial.around.stderr or trial.around.ended_by):
        return f"left after exit {ended.code}: {', '.join(new[:5])}"
    return ""


def _is_own(trial: Trial, name: str) -> bool:
    """Return whether the trial itself lets something change: the folder that it removes, or what an output replaces."""
    is_output = name in trial.line and name not in trial.recipe.reads
    return is_output or (trial.around.loses_folder and name == trial.around.within)


def is_answer(ended: Ended) -> bool:
    """Return whether exit 1 is what was found, and no refusal."""
    return ended.code == 1 and bool(ended.stdout) and "tam: " not in ended.stderr


def _code(trial: Trial, ended: Ended) -> str:
    if ended.code in (0, 1, 2) and not (trial.around.ended_by and ended.code and trial.recipe.ends):
        return ""
    if _was_ended(trial, ended) or ended.died or (not trial.recipe.ends and ended.code == 130):
        return ""
    if trial.around.ended_by and is_answer(ended):
        return ""
    return f"exit {ended.code}"


def _noise(trial: Trial, ended: Ended) -> str:
    said = ended.stderr
    if match := _WARNED.search(said + ended.stdout):
        return f"{match.group()}{(said + ended.stdout)[match.end() :][:150]}"
    if not ended.code or ended.died or _TRACEBACK.search(said) or _OUT_OF_MEMORY.search(said):
        return ""
    if _was_ended(trial, ended):
        return f"{said[:200]!r}" if len(said.split("\n")) > 3 else ""
    if is_answer(ended) or trial.around.stderr or trial.around.stdout:
        return ""
    # What was taken of a recording is told first, where it has names of its own.
    told = "".join(line for line in said.splitlines(keepends=True) if not _TAKEN.match(line))
    return _no_sentence(told) or (
        ended.stdout and not trial.recipe.tells_after_writing and f"stdout: {ended.stdout[:99]!r}"
    )


def _no_sentence(said: str) -> str:
    """Return what is wrong with a sentence on stderr; empty where it is one."""
    lines = said.rstrip("\n").split("\n")
    is_of_usage = lines[0].startswith("Usage: ") and len(lines) <= 5
    if lines[-1].startswith("Error: ") and (is_of_usage or len(lines) == 1):
        lines = [f"tam: {lines[-1].removeprefix('Error: ')[: _LONGEST_SENTENCE // 2]}"]  # with what was typed
    [first, *others] = lines
    if others:
        return f"{len(lines)} lines: {said[:300]!r}"
    if not first.startswith("tam: ") or len(first) < 12:
        return f"no sentence: {said[:200]!r}"
    if len(first) > _LONGEST_SENTENCE:
        return f"{len(first)} letters: {first[:200]!r}"
    if match := _OF_PYTHON.search(first) or _CONTROL.search(first):
        return f"{match.group()!r} in {first[:300]!r}"
    return ""
