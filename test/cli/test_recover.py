"""Unfinished bags at the command line: `tam recover`, and the commands that go on with what is whole."""

import json
from pathlib import Path

import pytest
from commands import tam as run
from numpy.testing import assert_array_equal

from tam_calibration.cli import diagnose as diagnose_command
from tam_calibration.fit import calibrate
from tam_calibration.fleet import task
from tam_calibration.fleet.task import read_result
from tam_calibration.recordings import fit_input, read_recording, write_array
from tam_calibration.recordings.channel_map import Reading
from tam_calibration.results import read_calibration, write_calibration, write_recording


@pytest.fixture(scope="module")
def files(tmp_path_factory, recording, cross):
    """Return a folder with a bag of each storage that lacks its last tenth, and with a calibration."""
    folder = tmp_path_factory.mktemp("recover")
    for name, storage in (("run.mcap", "mcap"), ("run", "sqlite3")):
        write_recording(folder / name, recording, storage)
        file = folder / name if name.endswith("mcap") else folder / name / "run.db3"
        file.write_bytes(file.read_bytes()[: file.stat().st_size * 9 // 10])
    (folder / "run" / "metadata.yaml").unlink()
    write_array(folder / "array.yaml", cross)
    write_calibration(folder / "c.yaml", calibrate(recording, cross))
    return folder


@pytest.mark.parametrize("name", ["run.mcap", "run"])
@pytest.mark.parametrize("output", ["new", "new.mcap"])
def test_a_clean_bag_is_written(folder, recording, name, output):
    """Which is read without a word and holds what the other held; its line is followed by the next command."""
    before = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    told = run("recover", name, "-o", output).stdout
    assert told.startswith(f"{output}: ") and "complete messages are recovered, the recording ends at 170000000" in told
    assert told.splitlines()[1:] == [f"next: tam inspect {output}"]
    assert all(file.read_bytes() == content for file, content in before.items())
    new = read_recording(output)
    assert 400 < new.sample_count < 600
    assert_array_equal(new.readings_T, recording.readings_T[: new.sample_count])
    assert_array_equal(read_recording(name).readings_T, new.readings_T)


def test_the_summary_is_there_for_programs(folder):
    """With the number of messages, and the time of the first and the last."""
    found = json.loads(run("recover", "run.mcap", "-o", "new", "--json").stdout)
    assert found["output"] == "new" and 2_000 < found["messages"] < 3_000 and found["faults"] == []
    assert 1.7e9 == found["begins_s"] < found["ends_s"] < 1.7e9 + 6


def test_what_is_no_bag_is_told(folder):
    """In one sentence, and nothing is written."""
    write_recording("run.csv", read_recording("run"))
    assert "run.csv is no bag: only bags can be recovered" in run("recover", "run.csv", "-o", "new", code=2).stderr
    Path("no.mcap").write_text("no bag")
    assert "no.mcap cannot be read: no.mcap does not begin" in run("recover", "no.mcap", "-o", "new", code=2).stderr
    Path("empty").mkdir()
    assert "is it a bag?" in run("recover", "empty", "-o", "new", code=2).stderr
    assert not Path("new").exists()


@pytest.mark.parametrize("name", ["run.mcap", "run"])
@pytest.mark.parametrize("is_large", [False, True])
def test_commands_go_on_with_what_is_whole(folder, caplog, gap, monkeypatch, name, is_large):
    """With a warning, in the log and in what they write; the corrected bag holds as many samples."""
    monkeypatch.setattr(diagnose_command, "diagnose", lambda *args, **options: gap)
    monkeypatch.setattr(fit_input, "MOST_BYTES", 0 if is_large else 1 << 30)
    run("calibrate", name, "--array", "array.yaml", "-o", "new.yaml")
    assert "the recording was left unfinished" in caplog.text
    assert read_calibration("new.yaml").warnings[0].startswith("the recording was left unfinished: 2")
    run("diagnose", name, "--array", "array.yaml", "--json", "gap.json")
    assert json.loads(Path("gap.json").read_text())["remarks"][0].startswith("The recording was left unfinished: 2")
    samples = json.loads(run("correct", name, "--calibration", "c.yaml", "-o", "out", "--json").stdout)["samples"]
    assert 400 < samples == read_recording("out").sample_count < 600


def test_a_refusal_tells_in_one_sentence_that_the_recording_is_unfinished(folder):
    """As it may be the reason; a command that succeeds says it once on stderr."""
    file = Path("run.mcap")
    file.write_bytes(file.read_bytes()[:9000])
    refused = run("calibrate", "run.mcap", "--array", "array.yaml", "-o", "new.yaml", code=1)
    assert refused.stdout.count("\n") == 1 and refused.stdout.startswith("Bad: ")
    assert "(run.mcap: the recording was left unfinished: " in refused.stdout
    told = run("correct", "run.mcap", "--calibration", "c.yaml", "-o", "out").stderr
    assert told.startswith("run.mcap: the recording was left unfinished: ") and told.count("unfinished") == 1


@pytest.mark.parametrize("name", ["run.mcap", "run"])
def test_a_batch_goes_on_too(folder, gap, monkeypatch, name):
    """The recording is calibrated, with the warning, and corrected."""
    monkeypatch.setattr(task, "diagnose", lambda recording, array: gap)
    asked = task.Task.of(
        folder / name, folder / "results", task.read_options(folder / "array.yaml", None, Reading(tolerance_s=0.0))
    )
    task.process(asked)
    result = read_result(asked.folder)
    assert result.status == "done" and result.problems == {} and 400 < result.samples < 600
    assert "left unfinished" in read_calibration(asked.folder / "calibration.yaml").warnings[0]
    assert read_recording(asked.folder / result.corrected).sample_count == result.samples
