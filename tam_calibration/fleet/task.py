"""One recording through calibration, diagnosis and correction, into a folder that appears whole."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from tam_calibration import __version__
from tam_calibration.correction.calibration import Calibration
from tam_calibration.files import (
    array_to_mapping,
    calibration_to_mapping,
    calibration_to_yaml,
    provenance,
    read_array,
    read_calibration,
    read_samples,
    write_calibration,
    write_corrected_pieces,
)
from tam_calibration.files.recording_file import correct_file, is_bag, read_source
from tam_calibration.files.results_json import gap_to_mapping, write_gap
from tam_calibration.files.text_files import printable, to_json
from tam_calibration.files.whole_files import replace_folder, unfinished
from tam_calibration.fit import calibrate
from tam_calibration.fleet.task_result import Result, Seal, Status, read_result, state_of, write_result
from tam_calibration.gap import diagnose
from tam_calibration.messages.usage import Usage
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import SampleSource

_DIGEST_LETTERS = 8


@dataclass(frozen=True, eq=False)
class Options:
    """What is asked for every recording.

    Parameters
    ----------
    array : Array
        Geometry and noise.
    calibration : Calibration, optional
        What recordings are corrected with, its effects taken off first; by default each with its own calibration.
    tolerance_s : float
        Greatest difference of stamps within a sample of a bag, seconds.
    digest : str
        Of all these and of the software's version.
    """

    array: Array
    calibration: Calibration | None
    tolerance_s: float
    digest: str


def read_options(array_path: Path, calibration_path: Path | None, tolerance_s: float) -> Options:
    """Return what is asked for every recording.

    Parameters
    ----------
    array_path : Path
        Array file.
    calibration_path : Path or None
        Calibration to correct all recordings with; None where each is corrected with its own.
    tolerance_s : float
        Greatest difference of stamps within a sample of a bag, seconds.

    Raises
    ------
    InputError
        When a file cannot be read, or the calibration is of another array.
    """
    array = read_array(array_path)
    calibration = None if calibration_path is None else read_calibration(calibration_path)
    if calibration is not None and not calibration.is_of(array):
        raise InputError(f"the calibration is of another array than {array_path}: use the calibration of this array")
    asked = {
        "software": __version__,
        "array": array_to_mapping(array),
        "calibration": None if calibration is None else calibration_to_yaml(calibration),
        "tolerance_s": tolerance_s,
    }
    return Options(array, calibration, tolerance_s, sha256(to_json(asked).encode()).hexdigest())


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
        digest = sha256(os.fsencode(path)).hexdigest()[:_DIGEST_LETTERS]
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
        return Result(*names, status, problems, self.options.digest, **rest)

    def is_done(self) -> bool:
        """Whether its result is there, of this recording as it is now and of these options."""
        result = read_result(self.folder)
        if result is None or result.status == "failed" or result.seal is None:
            return False
        with suppress(InputError, OSError):
            return result.options == self.options.digest and result.seal.holds(self.path)
        return False


def process(task: Task) -> None:
    """Do a task; what is wrong with the recording is kept in its result.

    Raises
    ------
    OSError
        When its folder cannot be written.
    """
    with _placing(task.folder) as folder:
        write_result(folder, _work(task, folder))


@contextmanager
def _placing(folder: Path) -> Iterator[Path]:
    """Give a folder to write to that takes its place when all is written; an older one goes after that."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with unfinished(folder) as parent:
        beside = parent / folder.name
        beside.mkdir()
        yield beside
        replace_folder(beside, folder)


@dataclass
class _Notes:
    """What kept the steps from their results, and whether that is a failure rather than an answer."""

    problems: dict[str, str] = field(default_factory=dict)
    is_failed: bool = False

    @contextmanager
    def step(self, name: str, may_refuse: bool = False) -> Iterator[None]:
        """Keep what goes wrong within."""
        try:
            yield
        except (InputError, Refused) as problem:
            self.problems[name] = str(problem)
            self.is_failed |= not may_refuse
        except Exception as problem:  # one recording does not stop the others, whatever it is
            self.problems[name] = f"{type(problem).__name__}: {problem}"
            self.is_failed = True

    @property
    def status(self) -> Status:
        if self.is_failed:
            return "failed"
        return "refused" if self.problems else "done"


def _work(task: Task, folder: Path) -> Result:
    """Write all files but the result, and return it."""
    options, notes = task.options, _Notes()
    calibration = options.calibration
    rest: dict[str, Any] = {}
    with notes.step("read"):
        state = state_of(task.path)
        origin = provenance(task.path)
        source, usage = _read(task.path, options)
        rest |= {"seal": Seal(*state, origin.sha256), "samples": source.sample_count, "time_span_s": source.time_span_s}
    if notes.problems:
        return task.result(notes.status, notes.problems)
    seen = source if usage is None else usage.with_each_reading_once(source)
    with notes.step("calibrate", may_refuse=True):
        warnings = () if usage is None else usage.warnings()
        own = calibrate(seen, options.array)
        if usage is not None:
            warnings += usage.interpolation_warnings(source, own.array.vector_noise_T)
        own = replace(own, source=origin, warnings=(*warnings, *own.warnings))
        write_calibration(folder / "calibration.yaml", own)
        rest["sensors"] = calibration_to_mapping(own)["sensors"]
        calibration = calibration or read_calibration(folder / "calibration.yaml")  # what others will correct with
    with notes.step("diagnose", may_refuse=True):
        remarks = () if usage is None else usage.remarks()
        gap = diagnose(seen, options.array)
        gap = replace(gap, remarks=(*remarks, *gap.remarks))
        write_gap(folder / "gap.json", gap, origin)
        rest["gap"] = _in_short(gap_to_mapping(gap))
    if calibration is not None:
        with notes.step("correct"):
            rest["corrected"] = _correct(task, calibration, folder)
    return task.result(notes.status, notes.problems, **rest)


def _read(path: Path, options: Options) -> tuple[SampleSource, Usage | None]:
    """Return the samples, without what effects of the given calibration add, and their usage."""
    array = options.array
    source = path, array.sensor_count, options.tolerance_s
    if options.calibration is not None and options.calibration.effects:
        samples = read_samples(*source, array=array)
        return options.calibration.without_effects(samples.recording), samples.usage
    return read_source(*source, array=array)


def _in_short(content: dict[str, Any]) -> dict[str, Any]:
    """Return what the summary tells of a gap."""
    return {
        "verdict": content["verdict"],
        "statement": content["statement"],
        **{key: content["gap"][key] for key in ("before", "after", "closed")},
        "causes": [cause["effect"] for cause in content["causes"]],
    }


def _correct(task: Task, calibration: Calibration, folder: Path) -> str:
    """Write the corrected data, a bag as one .mcap file with its other topics, and return the file's name."""
    name = "corrected.mcap" if is_bag(task.path) else "corrected.csv"
    pieces = correct_file(task.path, calibration, task.options.tolerance_s)
    write_corrected_pieces(folder / name, pieces, task.path)
    return name
