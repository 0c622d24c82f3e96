"""One recording through calibration, diagnosis and correction, into a folder that appears complete.

What became of it is the file ``result.json`` of its folder, written last.
"""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from tam_calibration import __version__, results
from tam_calibration.correction.calibration import Calibration
from tam_calibration.files.text_files import replace_folder, to_json, unfinished
from tam_calibration.fit import calibrate
from tam_calibration.gap import diagnose
from tam_calibration.gap.calibration_with_effects import calibrate_with_effects
from tam_calibration.messages.samples import Usage
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused, printable, sensors_in_words
from tam_calibration.model.recording import SampleSource
from tam_calibration.recordings import array_to_mapping, read_array, read_samples
from tam_calibration.recordings.bag_storages import is_bag
from tam_calibration.recordings.channel_map import Reading
from tam_calibration.recordings.fit_input import fit_with_usage, read_source
from tam_calibration.recordings.recording_file import provenance
from tam_calibration.results.data_files import correct_file
from tam_calibration.results.results_json import gap_to_mapping, write_gap

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
        Name of the recording, of the folder that it lies in, and its complete path.
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
    """Return the result that a folder contains; None where it contains none, or one that is not as it was written."""
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


@dataclass(frozen=True, eq=False)
class Options:
    """What is asked for every recording.

    Parameters
    ----------
    array : Array
        Geometry and noise.
    calibration : Calibration, optional
        What recordings are corrected with, its effects taken off first; by default each with its own calibration.
    how : Reading
        How recordings are read.
    effects : tuple of str
        Names of effects that are fitted too, as of ``calibrate_with_effects``.
    digest : str
        Of all these and of the software's version.
    """

    array: Array
    calibration: Calibration | None
    how: Reading
    effects: tuple[str, ...]
    digest: str

    def fit(self, samples: SampleSource) -> Calibration:
        """Return the calibration of the samples of a recording, with the effects that are asked for."""
        if not self.effects:
            return calibrate(samples, self.array)
        return calibrate_with_effects(samples.whole(), self.array, self.effects)


def read_options(
    array_path: Path, calibration_path: Path | None, how: Reading, effects: tuple[str, ...] = ()
) -> Options:
    """Return what is asked for every recording.

    Parameters
    ----------
    array_path : Path
        Array file.
    calibration_path : Path or None
        Calibration to correct all recordings with; None where each is corrected with its own.
    how : Reading
        How recordings are read.
    effects : tuple of str
        Names of effects that are fitted too.

    Raises
    ------
    InputError
        When a file cannot be read, or the calibration is of another array.
    """
    array = read_array(array_path)
    calibration = None if calibration_path is None else results.read_calibration(calibration_path)
    if calibration is not None and not calibration.is_of(array):
        raise InputError(f"the calibration is of another array than {array_path}: use the calibration of this array")
    asked = {
        "software": __version__,
        "array": array_to_mapping(array),
        "calibration": None if calibration is None else results.calibration_to_yaml(calibration),
        "how": repr(how),
        "effects": effects,
    }
    return Options(array, calibration, how, effects, sha256(to_json(asked).encode()).hexdigest())


@dataclass(frozen=True, eq=False)
class Task:
    """A recording, by its absolute path, and the folder for what is made of it."""

    path: Path
    folder: Path
    options: Options

    @classmethod
    def of(cls, path: Path, out: Path, options: Options) -> "Task":
        """Return the task of a recording.

        Parameters
        ----------
        path : Path
            Absolute path of the recording; its digest is in the folder's name, to tell recordings of one name apart.
        out : Path
            Folder of the batch, in which that of the task will lie.
        options : Options
            What is asked for every recording.
        """
        digest = sha256(os.fsencode(path)).hexdigest()[:8]
        own = Path("recordings", printable(path.parent.name), f"{printable(path.name)}-{digest}")
        return cls(path, Path(os.path.realpath(out)) / own, options)

    def result(self, status: Status, problems: dict[str, str], **rest: Any) -> Result:
        """Return a result of this recording.

        Parameters
        ----------
        status : str
            ``done``, ``refused`` or ``failed``.
        problems : dict of str to str
            What kept a step from its result, one sentence each, by the step's name.
        **rest
            Further fields of `Result`.
        """
        names = printable(self.path.name), printable(self.path.parent.name), printable(self.path)
        told = {step: printable(sentence) for step, sentence in problems.items()}
        return Result(*names, status, told, self.options.digest, **rest)

    def is_done(self) -> bool:
        """Whether its result is there, of this recording as it is now and of these options."""
        result = read_result(self.folder)
        if result is None or result.status == "failed" or result.seal is None:
            return False
        with suppress(InputError, OSError):
            return result.options == self.options.digest and result.seal.holds(self.path)
        return False


def process(task: Task) -> None:
    """Do a task; what is wrong with the recording is kept in its result, and an older result goes when all is written.

    Raises
    ------
    OSError
        When its folder cannot be written.
    """
    task.folder.parent.mkdir(parents=True, exist_ok=True)
    with unfinished(task.folder) as parent:
        beside = parent / task.folder.name
        beside.mkdir()
        write_result(beside, _work(task, beside))
        replace_folder(beside, task.folder)


@dataclass
class _Steps:
    """What kept steps from their results, and the status that follows."""

    problems: dict[str, str] = field(default_factory=dict)
    status: Status = "done"

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Keep what goes wrong within; that a fit refuses a recording is an answer and no failure."""
        try:
            yield
        except Exception as problem:  # one recording does not stop the others, whatever it is
            is_refusal = isinstance(problem, InputError | Refused)
            self.problems[name] = str(problem) if is_refusal else f"{type(problem).__name__}: {problem}"
            is_answer = is_refusal and name in ("calibrate", "diagnose")
            self.status = "refused" if is_answer and self.status != "failed" else "failed"


def _work(task: Task, folder: Path) -> Result:
    """Write all files but the result, and return it."""
    options, steps = task.options, _Steps()
    calibration = options.calibration
    rest: dict[str, Any] = {}
    with steps.step("read"):
        state = state_of(task.path)
        origin = provenance(task.path)
        source, usage = _read(task.path, options)
        rest |= {"seal": Seal(*state, origin.sha256), "samples": source.sample_count, "time_span_s": source.time_span_s}
    if steps.problems:
        return task.result(steps.status, steps.problems)
    with steps.step("calibrate"):
        fitted = fit_with_usage(source, usage, options.fit)
        own = replace(fitted, source=origin)
        results.write_calibration(folder / "calibration.yaml", own)
        rest["sensors"] = results.calibration_to_mapping(own)["sensors"]
        # What others will correct with.
        calibration = calibration or results.read_calibration(folder / "calibration.yaml")
    with steps.step("diagnose"):
        found = diagnose(source, options.array)
        gap = replace(found, remarks=(*usage.remarks(), *found.remarks))
        write_gap(folder / "gap.json", gap, origin)
        rest["gap"] = _in_short(gap_to_mapping(gap))
    if calibration is not None:
        with steps.step("correct"):
            rest["corrected"] = _correct(task, calibration, folder)
    return task.result(steps.status, steps.problems, **rest)


def _read(path: Path, options: Options) -> tuple[SampleSource, Usage]:
    """Return samples for a fit, without what effects of the given calibration add, and their usage."""
    source = path, options.array, options.how
    if options.calibration is None or not options.calibration.effects:
        return read_source(*source)
    samples = read_samples(*source)
    quiet = options.calibration.without_effects(samples.recording)
    return samples.usage.with_each_reading_once(quiet), samples.usage


def _in_short(content: dict[str, Any]) -> dict[str, Any]:
    """Return what the summary says of a gap."""
    return {
        "verdict": content["verdict"],
        "statement": content["statement"],
        **{key: content["gap"][key] for key in ("before", "after", "closed")},
        "causes": [cause["effect"] for cause in content["causes"]],
        "laws": [_law_in_short(law) for law in content["signature"]],
    }


_COURSES = {
    "step": "stepping",
    "episodes": "coming and going",
    "slow": "drifting",
    "random": "changing at random",
    "motion": "going with the motion",
    "constant": "staying the same",
}
"""Courses in words; of the others the channel or the tone is named."""


def _law_in_short(law: dict[str, Any]) -> str:
    """Return a law as it may come again in other recordings: place, what it does, and its course."""
    course = _COURSES.get(law["course"], f"following {law['follows']}")
    return f"{sensors_in_words(law['sensors'])}: {law['law'].replace('_', ' ')} {course}"


def _correct(task: Task, calibration: Calibration, folder: Path) -> str:
    """Write the corrected data, a bag as one .mcap file with its other topics, and return the file's name."""
    name = "corrected.mcap" if is_bag(task.path) else "corrected.csv"
    pieces = correct_file(task.path, calibration, task.options.how)
    results.write_corrected_pieces(folder / name, pieces, task.path, how=task.options.how, array=calibration.array)
    return name
