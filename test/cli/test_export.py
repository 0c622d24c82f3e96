"""`tam export`: where its files go, what it says, and what it refuses."""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from commands import tam

from tam_calibration.fit import calibrate
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import write_array
from tam_calibration.results import calibration_from_yaml, calibration_to_yaml, write_calibration
from tam_calibration.results.export import CONSUMERS, export


@pytest.fixture(scope="module")
def calibration(recording, cross):
    """Return a calibration of four sensors, as its file holds it."""
    return calibration_from_yaml(calibration_to_yaml(calibrate(recording, cross)), "text")


@pytest.fixture(scope="module")
def files(tmp_path_factory, calibration):
    """Return a folder with a calibration file."""
    folder = tmp_path_factory.mktemp("export")
    write_calibration(folder / "c.yaml", calibration)
    return folder


run = partial(tam, "export")


@pytest.mark.parametrize("target", ["px4", "ardupilot", "c", "json"])
def test_a_single_file_is_printed_or_written(folder, calibration, target):
    """Losses are said beside it: on standard error where the file is printed, else on standard output."""
    (text,), losses = export(calibration, target).texts, export(calibration, target).losses
    sentences = "".join(f"{loss.sentence}\n" for loss in losses)
    printed, written = run("c.yaml", "--to", target), run("c.yaml", "--to", target, "-o", "new.txt")
    assert (printed.stdout, printed.stderr) == (text, sentences)
    assert (written.stdout, written.stderr) == (f"new.txt: written for {target}\n{sentences}", "")
    assert Path("new.txt").read_text() == text


@pytest.mark.parametrize(("target", "suffix"), [("imu_tools", "yaml"), ("microstrain", "json")])
def test_each_sensor_has_its_file(folder, calibration, target, suffix):
    """Numbered, and named after the calibration unless a name is given."""
    texts = list(export(calibration, target).texts)
    run("c.yaml", "--to", target)
    run("c.yaml", "--to", target, "-o", "new.txt")
    assert [Path(f"c_{target}_{number}.{suffix}").read_text() for number in (1, 2, 3, 4)] == texts
    assert [Path(f"new_{number}.txt").read_text() for number in (1, 2, 3, 4)] == texts
    assert len(os.listdir()) == 9


@pytest.mark.parametrize("target", CONSUMERS)
def test_one_sensor_has_one_file_of_the_name_that_is_given(folder, recording, target):
    """Without a number."""
    one = Recording(recording.time_s, recording.readings_T[:, :1], recording.scalar_T)
    write_calibration("one.yaml", calibrate(one, Array([[0.0, 0, 0]], [1e-9], 1e-10)))
    run("one.yaml", "--to", target, "-o", "new.txt")
    assert sorted(os.listdir()) == ["c.yaml", "new.txt", "one.yaml"]
    assert Path("new.txt").read_text() == run("one.yaml", "--to", target).stdout


@pytest.mark.parametrize("taken", ["a calibration", "a folder"])
def test_all_files_of_the_sensors_appear_or_none(folder, taken):
    """One of them would overwrite the calibration, or has the name of a folder."""
    if taken == "a calibration":
        Path("c.yaml").rename("new_2.json")
    else:
        Path("new_2.json").mkdir()
    (source,) = (path.name for path in folder.iterdir() if path.is_file())
    before = sorted(os.listdir())
    result = run(source, "--to", "microstrain", "-o", "new.json", code=2)
    assert result.stderr.startswith("tam: new_2.json ") and result.stdout == ""
    assert sorted(os.listdir()) == before


@pytest.mark.parametrize("output", [".", "..", "/", "/dev/null", "none/new.txt", "c.yaml/new.txt"])
@pytest.mark.parametrize("target", ["px4", "microstrain"])
def test_what_cannot_be_written_is_one_sentence(folder, output, target):
    """Nothing is written."""
    result = run("c.yaml", "--to", target, "-o", output, code=2)
    assert result.stderr.startswith(f"tam: {output} ") and len(result.stderr.splitlines()) == 1
    assert os.listdir() == ["c.yaml"]


def test_bad_input_is_one_sentence(folder, calibration, cross):
    """A consumer that nobody knows, an array for a calibration, and a calibration that is beyond the limits."""
    assert "'px5' is not one of 'px4'" in run("c.yaml", "--to", "px5", code=2).stderr
    assert "Missing option '--to'" in run("c.yaml", code=2).stderr
    write_array("a.yaml", cross)
    assert "a.yaml: this is no calibration" in run("a.yaml", "--to", "px4", code=2).stderr
    far = replace(calibration.errors, scale_factor=0.3 * calibration.errors.scale_factor)
    write_calibration("far.yaml", replace(calibration, errors=far))
    assert "accept scale_factor" in run("far.yaml", "--to", "px4", code=2).stderr
