"""One recording: all its files at once, what a step could not do in one sentence, and what counts as done."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from tam_calibration.cli.main import main
from tam_calibration.fit import calibrate
from tam_calibration.fleet.task import Task, process, read_options, read_result
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.recordings import read_recording, write_array
from tam_calibration.recordings.channel_map import Reading
from tam_calibration.results import read_calibration, write_calibration, write_recording


def do(folder, name, options):
    """Do the task of a mission; return it and its result."""
    task = Task.of(folder / "missions" / name, folder / "out", options)
    process(task)
    return task, read_result(task.folder)


@pytest.mark.parametrize(
    ("name", "corrected"),
    [
        ("auv_1/dive_0.csv", "corrected.csv"),
        ("auv_1/dive_1.mcap", "corrected.mcap"),
        ("auv_2/dive_2", "corrected.mcap"),
        ("auv_2/dive_3", "corrected.mcap"),
    ],
)
def test_a_recording_gets_what_the_commands_give(folder, options, asked, name, corrected):
    """The calibration of `tam calibrate`, the gap of `tam diagnose`, the data of `tam correct`, byte for byte."""
    task, result = do(folder, name, options)
    assert result.status == "done" and task.is_done() and not result.problems
    assert {path.name for path in task.folder.iterdir()} == {"calibration.yaml", "gap.json", corrected, "result.json"}
    path = str(task.path)
    for arguments in (
        ["calibrate", path, "--array", "array.yaml", "-o", "calibration.yaml"],
        ["correct", path, "--calibration", "calibration.yaml", "-o", corrected],
    ):
        assert CliRunner().invoke(main, arguments).exit_code == 0
    for made in ("calibration.yaml", corrected):
        assert (task.folder / made).read_bytes() == (folder / made).read_bytes()
    gap = json.loads((task.folder / "gap.json").read_text())
    assert gap["recording"]["name"] == task.path.name
    assert (result.verdict, result.gap["causes"]) == (gap["verdict"], ["temperature_drift"])
    assert (result.samples, result.platform) == (200, task.path.parent.name)


def test_a_given_calibration_corrects(folder, asked, recording, cross):
    """Data are corrected with it; the recording's own is written beside, for the drift."""
    given = calibrate(replace(recording, readings_T=1.001 * recording.readings_T), cross)
    write_calibration(folder / "given.yaml", given)
    task, result = do(
        folder,
        "auv_1/dive_1.mcap",
        read_options(folder / "array.yaml", folder / "given.yaml", Reading(tolerance_s=1e-3)),
    )
    arguments = ["correct", str(task.path), "--calibration", "given.yaml", "-o", "corrected.mcap"]
    assert CliRunner().invoke(main, arguments).exit_code == 0
    assert (task.folder / "corrected.mcap").read_bytes() == (folder / "corrected.mcap").read_bytes()
    own = read_calibration(task.folder / "calibration.yaml")
    assert result.sensors[0]["scale_factor"] == own.errors.scale_factor[0].tolist()
    assert (own.errors.scale_factor < given.errors.scale_factor).all()


def test_effects_are_fitted_and_removed(folder, asked, recording):
    """The calibration keeps them, and those that a recording lacks a channel for are an answer."""
    path = folder / "missions/auv_1/dive_0.csv"
    current_A = np.tile([0.0, 1.0], len(recording.time_s) // 2)
    bent_T = recording.readings_T + 100e-9 * current_A[:, None, None]
    write_recording(path, replace(recording, readings_T=bent_T, current_A=current_A))
    how = Reading(tolerance_s=1e-3)
    options = read_options(folder / "array.yaml", None, how, ("current_interference",))
    assert options.digest != read_options(folder / "array.yaml", None, how).digest
    task, _ = do(folder, "auv_1/dive_0.csv", options)
    (fitted,) = read_calibration(task.folder / "calibration.yaml").effects
    assert fitted.effect == "current_interference"
    _, result = do(folder, "auv_1/dive_1.mcap", options)
    assert "needs the current channel" in result.problems["calibrate"]


def test_what_cannot_be_calibrated_is_an_answer(folder, options, asked):
    """A run about one axis has no calibration; the sentence is kept, and it is not tried again."""
    path = folder / "missions/auv_1/dive_0.csv"
    still = read_recording(path)
    write_recording(path, replace(still, readings_T=still.readings_T[:1] + 0 * still.readings_T))
    asked["answer"] = Refused("no calibration fits any part of it")
    task, result = do(folder, "auv_1/dive_0.csv", options)
    assert result.status == "refused" and task.is_done()
    assert result.problems["diagnose"] == "no calibration fits any part of it"
    assert set(result.problems) == {"calibrate", "diagnose"} and result.corrected is None
    assert {path.name for path in task.folder.iterdir()} == {"result.json"}


def test_a_given_calibration_corrects_what_cannot_be_calibrated(folder, asked, recording, cross):
    """A straight line of a survey is corrected all the same."""
    write_calibration(folder / "given.yaml", calibrate(recording, cross))
    path = folder / "missions/auv_1/dive_0.csv"
    write_recording(path, replace(recording, readings_T=recording.readings_T[:1] + 0 * recording.readings_T))
    _, result = do(
        folder,
        "auv_1/dive_0.csv",
        read_options(folder / "array.yaml", folder / "given.yaml", Reading(tolerance_s=1e-3)),
    )
    assert (result.status, set(result.problems), result.corrected) == ("refused", {"calibrate"}, "corrected.csv")


def test_what_cannot_be_read_has_failed_and_is_tried_again(folder, options, asked):
    """The sentence of the reader is kept; next time the recording may be whole."""
    task, result = do(folder, "auv_2/damaged.mcap", options)
    assert result.status == "failed" and "damaged or truncated" in result.problems["read"]
    assert not task.is_done()
    (folder / "missions/auv_1/dive_1.mcap").rename(task.path)
    process(task)
    assert read_result(task.folder).status == "done" and task.is_done()


def test_a_fault_of_the_software_is_kept_with_its_kind(folder, options, asked):
    """It is a failure, and the other steps are done all the same."""
    asked["answer"] = ZeroDivisionError("division by zero")
    task, result = do(folder, "auv_1/dive_0.csv", options)
    assert result.status == "failed" and not task.is_done()
    assert result.problems == {"diagnose": "ZeroDivisionError: division by zero"}
    assert result.corrected == "corrected.csv"


def test_other_options_and_other_content_are_done_again(folder, options, asked, cross, mission):
    """What was done counts for the same recording, array, calibration and tolerance."""
    task, _ = do(folder, "auv_1/dive_0.csv", options)
    others = [read_options(folder / "array.yaml", None, Reading(tolerance_s=2e-3))]
    write_calibration(folder / "given.yaml", calibrate(mission(0), cross))
    others.append(read_options(folder / "array.yaml", folder / "given.yaml", Reading(tolerance_s=1e-3)))
    write_array(folder / "array.yaml", replace(cross, vector_noise_T=2 * cross.vector_noise_T))
    others.append(read_options(folder / "array.yaml", None, Reading(tolerance_s=1e-3)))
    for other in others:
        assert not replace(task, options=other).is_done()
    assert task.is_done()
    write_recording(task.path, mission(5))
    assert not task.is_done()
    task.path.unlink()
    assert not task.is_done()


def test_notes_in_the_array_file_change_nothing(folder, options):
    """Only what counts for the numbers does."""
    with (folder / "array.yaml").open("a") as file:
        file.write("notes: tightened the frame\n")
    assert read_options(folder / "array.yaml", None, Reading(tolerance_s=1e-3)).digest == options.digest


def test_a_calibration_of_another_array_is_refused(folder, recording, cross):
    """Before anything is done."""
    write_calibration(folder / "given.yaml", calibrate(recording, cross))
    write_array(folder / "array.yaml", replace(cross, positions_m=2 * cross.positions_m))
    with pytest.raises(InputError, match="of another array"):
        read_options(folder / "array.yaml", folder / "given.yaml", Reading(tolerance_s=1e-3))


def test_recordings_of_one_name_have_folders_of_their_own(tmp_path, options):
    """Two platforms of one name in different years do not overwrite each other."""
    paths = [tmp_path / year / "auv/dive.mcap" for year in ("2025", "2026")]
    folders = {Task.of(path, tmp_path / "out", options).folder for path in paths}
    assert len(folders) == 2
    assert {folder.parent for folder in folders} == {tmp_path / "out/recordings/auv"}
