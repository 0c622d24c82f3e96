"""`tam calibrate` and `tam diagnose` of a bag: how many of sensor 1's samples were used, and what if they are few."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from tam_calibration.cli import diagnose as diagnose_command
from tam_calibration.cli.main import main
from tam_calibration.files import read_calibration, recording_file, write_array, write_recording
from tam_calibration.files.bag_writing import TYPESTORE

TOPIC = "/tam_3/magnetic_field"


@pytest.fixture
def thinned(tmp_path, monkeypatch, recording, cross):
    """Give a working folder; return a function that writes a bag in which sensor 3 lacks a part of its messages."""
    monkeypatch.chdir(tmp_path)
    write_recording("whole", recording)
    write_array("array.yaml", cross)

    def write(lost):
        with Reader("whole") as reader, Writer("run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connections = {
                each.topic: writer.add_connection(each.topic, each.msgtype, typestore=TYPESTORE)
                for each in reader.connections
            }
            count = 0
            for connection, recorded_ns, data in reader.messages():
                count += connection.topic == TOPIC
                if connection.topic != TOPIC or not 100 < count <= 100 + 600 * lost:
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
    monkeypatch.setattr(recording_file, "_LARGE_BYTES", 0 if is_large else 1 << 30)
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
    monkeypatch.setattr(recording_file, "_LARGE_BYTES", 0 if is_large else 1 << 30)
    thinned(0.25)
    result = run("calibrate", "-o", "calibration.yaml")
    assert result.exit_code == 0, result.stderr
    assert "Warning: Only 450 of 600 samples of sensor 1 used: 150 found none of tam_3" in result.stdout
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
        "only 240 of 600 samples of sensor 1 used: 360 found none of tam_3, of which 240 messages came" in result.stderr
    )
    assert "Traceback" not in result.stderr and not Path("out.json").exists()
