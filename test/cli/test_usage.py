"""`tam calibrate` and `tam diagnose` of a bag: how many of sensor 1's samples were used, and what if they are few."""

import json
from pathlib import Path
from shutil import copy

import pytest
from click.testing import CliRunner
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from tam_calibration.cli import diagnose as diagnose_command
from tam_calibration.cli.main import main
from tam_calibration.messages.samples import Usage
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings import fit_input
from tam_calibration.recordings.bag_writing import TYPESTORE
from tam_calibration.results import read_calibration

TOPIC = "/tam_3/magnetic_field"


@pytest.fixture
def thinned(files, tmp_path, monkeypatch):
    """Give a working folder; return a function that writes a bag in which sensor 3 lacks some of its messages."""
    monkeypatch.chdir(tmp_path)
    copy(files / "array.yaml", "array.yaml")

    def write(lost, every=0):
        with Reader(files / "run") as reader, Writer("run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connections = {
                each.topic: writer.add_connection(each.topic, each.msgtype, typestore=TYPESTORE)
                for each in reader.connections
            }
            count = 0
            for connection, recorded_ns, data in reader.messages():
                count += connection.topic == TOPIC
                is_lost = count % every == 0 if every else 100 < count <= 100 + 600 * lost
                if connection.topic != TOPIC or not is_lost:
                    writer.write(connections[connection.topic], recorded_ns, data)

    return write


def run(name, *arguments):
    """Run a command on the bag and return its result."""
    return CliRunner().invoke(main, [name, "run", "--array", "array.yaml", *arguments])


@pytest.fixture
def asked(monkeypatch, gap):
    """Have the diagnosis answered at once."""
    monkeypatch.setattr(diagnose_command, "diagnose", lambda *args, **options: gap)


@pytest.mark.parametrize("is_large", [False, True])
def test_every_answer_tells_the_usage(thinned, asked, monkeypatch, is_large):
    """Whether or not it is a warning, and also where the recording is larger than memory."""
    monkeypatch.setattr(fit_input, "MOST_BYTES", 0 if is_large else 1 << 30)
    thinned(0.05)
    why = "30 found none of tam_3, of which 570 messages came: they have gaps"
    for name in ("calibrate", "diagnose"):
        result = run(name, "--json", "out.json")
        assert result.exit_code == 0, result.stderr
        assert f"570 of 600 samples of sensor 1 used: {why}" in result.stdout
        assert "Only" not in result.stdout and "only 570" not in Path("out.json").read_text()


@pytest.mark.parametrize("is_large", [False, True])
def test_below_nine_tenths_is_a_warning(thinned, asked, monkeypatch, is_large):
    """In the answer, in the files and for programs."""
    monkeypatch.setattr(fit_input, "MOST_BYTES", 0 if is_large else 1 << 30)
    thinned(0.25)
    result = run("calibrate", "-o", "calibration.yaml")
    assert result.exit_code == 0, result.stderr
    assert "; only 450 of 600 samples of sensor 1 used: 150 found none of tam_3" in result.stdout
    assert read_calibration("calibration.yaml").warnings[0].startswith("only 450 of 600 samples of sensor 1 used")
    result = run("diagnose", "--json", "gap.json")
    assert result.exit_code == 0, result.stderr
    assert json.loads(Path("gap.json").read_text())["remarks"][0].startswith("Only 450 of 600 samples of sensor 1 used")
    assert "Only 450 of 600" in result.stdout


@pytest.mark.parametrize("name", ["calibrate", "diagnose"])
def test_below_half_is_refused(thinned, name):
    """With the cause, exit code 1 and no file."""
    thinned(0.6)
    result = run(name, "--json", "out.json")
    assert result.exit_code == 1
    assert (
        "only 240 of 600 samples of sensor 1 used: 360 found none of tam_3, of which 240 messages came" in result.stdout
    )
    assert "Traceback" not in result.stderr and not Path("out.json").exists()


@pytest.fixture
def half(thinned, monkeypatch):
    """Write a bag in which sensor 3 has half of the rate; fits shall refuse it where they count its readings."""
    thinned(0.5, every=2)
    assert run("calibrate", "-o", "calibration.yaml").exit_code == 0
    assert read_calibration("calibration.yaml").samples == pytest.approx(300, abs=5)

    def refuse(usage, samples):
        raise InputError(f"{samples.sample_count} samples with each reading once")

    monkeypatch.setattr(Usage, "with_each_reading_once", refuse)


@pytest.mark.parametrize("is_large", [False, True])
def test_a_slower_sensor_counts_once_in_every_fit(half, monkeypatch, is_large):
    """Whichever command fits or judges noise; what is corrected has all samples."""
    monkeypatch.setattr(fit_input, "MOST_BYTES", 0 if is_large else 1 << 30)
    array, known = ["--array", "array.yaml"], ["--calibration", "calibration.yaml"]
    for command in (
        ["calibrate", "run", *array],
        ["calibrate", "run", *array, "--estimate-delays"],
        ["diagnose", "run", *array],
        ["diagnose", "run", *array, *known],
        ["locate", "run", *known],
        ["plan", "run", *array],
        ["compare", "run", "run", *array],
    ):
        result = CliRunner().invoke(main, command)
        assert result.exit_code == 2 and "samples with each reading once" in result.stderr, (command, result.stderr)
    result = CliRunner().invoke(main, ["correct", "run", *known, "-o", "corrected.csv"])
    assert result.exit_code == 0, result.stderr
    assert len(Path("corrected.csv").read_text().splitlines()) > 590
