"""Bad input ends in one clear sentence on stderr and exit 2, and nothing is written."""

import os
import resource
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from tam_calibration.cli.main import SUBCOMMANDS, main
from tam_calibration.messages.point_cloud import MAGNETIC_FIELD, sensor_topic
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import write_array
from tam_calibration.recordings.bag_writing import TYPESTORE, serialise, write_bag
from tam_calibration.results import write_recording


def snapshot(folder):
    """Return the content of all files of a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refuse(folder, arguments, *words, code=2):
    """Check that a command ends with one sentence and exit code, and changes nothing."""
    before = snapshot(folder)
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == code, (result.stdout, result.stderr, result.exception)
    is_graded = code == 1 and arguments[0] in ("calibrate", "diagnose", "compare", "locate")
    said, silent = (result.stdout, result.stderr) if is_graded else (result.stderr, result.stdout)
    lines = said.splitlines()
    assert len(lines) == 1 and lines[0].startswith("Bad: " if is_graded else "tam: ") and silent == ""
    for word in words:
        assert word in lines[0]
    assert snapshot(folder) == before


def calibrate_arguments(recording):
    """Return a command line that asks for every output."""
    return [
        "calibrate",
        recording,
        "--array",
        "array.yaml",
        "-o",
        "new.yaml",
        "--json",
        "new.json",
        "--report",
        "new.html",
    ]


def refuse_recording(folder, name, *words):
    """Check that both commands refuse a recording that cannot be read."""
    refuse(folder, calibrate_arguments(name), name, *words)
    refuse(folder, ["correct", name, "--calibration", "c.yaml", "-o", "new.csv"], name, *words)
    refuse(folder, ["correct", name, "--calibration", "c.yaml", "-o", "new"], name, *words)


def edit(path, change):
    """Change the lines of a text file."""
    lines = path.read_text().splitlines()
    change(lines)
    path.write_text("\n".join(lines) + "\n")


def test_truncated_bags(folder):
    """sqlite3 and mcap that were cut before the first message; what is left behind it is in ``test_recover``."""
    for data, name in ((folder / "run" / "run.db3", "run"), (folder / "run.mcap", "run.mcap")):
        os.truncate(data, 90)
        refuse_recording(folder, name, "is damaged or truncated: no message in it is complete")


def test_empty_files_and_bags(folder):
    """Files without a byte, and a bag without a message."""
    for name in ("empty.mcap", "empty.csv"):
        (folder / name).touch()
        refuse_recording(folder, name, "empty")
    with write_bag(folder / "none", "sqlite3") as writer:
        writer.add_connection("/tam_1/magnetic_field", MAGNETIC_FIELD, typestore=TYPESTORE)
    refuse_recording(folder, "none", "contains no message")


def test_a_bag_without_index(folder):
    """A folder without metadata, in which no file of a bag is left."""
    (folder / "run" / "metadata.yaml").unlink()
    (folder / "run" / "run.db3").unlink()
    refuse_recording(
        folder, "run", "contains no metadata.yaml, nor a file that ends in .db3 or .mcap or .bag: is it a bag?"
    )


def write_topics(path, topics):
    """Write a bag of ten messages on each topic: (topic, type, values of a message)."""
    stamps_ns = np.arange(10) * 10_000_000
    with write_bag(path, "sqlite3") as writer:
        for topic, msgtype, values in topics:
            connection = writer.add_connection(topic, msgtype, typestore=TYPESTORE)
            for stamp_ns, message in zip(
                stamps_ns, serialise(msgtype, np.tile(values, (10, 1)), stamps_ns), strict=True
            ):
                writer.write(connection, int(stamp_ns), message)


def test_missing_topics_and_wrong_types(folder):
    """The topic is named, and what there is is listed."""
    sensors = [(f"/{sensor_topic(k)}", MAGNETIC_FIELD, [3e-5, 0, 4e-5]) for k in (1, 2, 3, 4)]
    write_topics(folder / "three", sensors[:2] + sensors[3:])
    refuse_recording(
        folder, "three", "topic /tam_3/magnetic_field is missing; the recording has /tam_1/magnetic_field, "
    )
    write_topics(folder / "wrong", [*sensors[:3], ("/tam_4/magnetic_field", "std_msgs/msg/Float64", [1.0])])
    refuse_recording(
        folder, "wrong", "/tam_4/magnetic_field has the type std_msgs/msg/Float64, and the map does not say"
    )


def test_files_that_are_not_there(folder):
    """Recording, array and calibration are told apart."""
    refuse_recording(folder, "nothing.csv", "there is no file or bag")
    refuse(folder, ["calibrate", "run.csv", "--array", "no.yaml"], "no.yaml cannot be read: No such file")
    refuse(
        folder, ["correct", "run.csv", "--calibration", "no.yaml", "-o", "new.csv"], "no.yaml cannot be read: No such"
    )


def test_a_malformed_line(folder):
    """The line and its fault are named."""
    edit(folder / "run.csv", lambda lines: lines.__setitem__(41, lines[41].replace(",", ",x", 1)))
    refuse_recording(folder, "run.csv", "line 42 column b1x_nT", "is not a number")


def test_not_a_number(folder, undrawn):
    """A reading that is NaN is left out, and named with its sensor and time."""
    edit(
        folder / "run.csv", lambda lines: lines.__setitem__(41, ",".join([*lines[41].split(",")[:-2], "nan", "50000"]))
    )
    done = CliRunner().invoke(main, calibrate_arguments("run.csv"))
    assert done.exit_code == 0 and "1 of 600 readings of sensor 4 is NaN or blank, first at" in done.output


def test_times_that_repeat_or_go_back(folder, undrawn):
    """Duplicated stamps and unsorted time."""
    edit(folder / "run.csv", lambda lines: lines.insert(41, lines[41]))
    done = CliRunner().invoke(main, calibrate_arguments("run.csv"))
    assert done.exit_code == 0 and "1 rows repeat the time before them and were left out" in done.stderr
    edit(folder / "run.csv", lambda lines: lines.insert(101, lines.pop(41)))
    refuse_recording(folder, "run.csv", "time goes backwards at sample 101")


def test_another_unit(folder, recording):
    """µT that are called T."""
    text = (folder / "run.csv").read_text()
    readings = [line.split(",") for line in text.splitlines()[1:]]
    header = text.splitlines()[0].replace("_nT", "_T")
    lines = [",".join([row[0], *(repr(float(cell) / 1000) for cell in row[1:])]) for row in readings]
    (folder / "microtesla.csv").write_text("\n".join([header, *lines]))
    words = ("the Earth's field has 15 to 100 µT", "µT given as T")
    refuse(folder, calibrate_arguments("microtesla.csv"), *words)
    refuse(folder, ["correct", "microtesla.csv", "--calibration", "c.yaml", "-o", "new.csv"], *words)


def write_sub(name, recording, index):
    """Write some samples of a recording."""
    write_recording(name, recording.take(index))


def test_readings_that_determine_nothing(folder, recording, true_errors, cross):
    """Constant readings, too few samples, and nine poses in one plane."""
    write_recording("constant.csv", Recording(recording.time_s, np.ones_like(recording.readings_T) * 3e-5))
    refuse(folder, calibrate_arguments("constant.csv"), "sensor 1 axis x reads the same value in all 600 samples")
    write_recording("few.csv", recording.take(slice(0, 8)))
    refuse(folder, calibrate_arguments("few.csv"), "8 samples")
    angle = np.arange(9) * 2 * np.pi / 9
    field = 50e-6 * np.stack([np.cos(angle), np.sin(angle) * 0.8, np.sin(angle) * 0.6], 1)
    plane = Recording(np.arange(9.0), true_errors.distort(field), np.full(9, 50e-6))
    write_recording("plane.csv", plane)
    refuse(folder, calibrate_arguments("plane.csv"))
    many = Recording(np.arange(900.0), np.tile(plane.readings_T, (100, 1, 1)), np.full(900, 50e-6))
    write_recording("many.csv", many)
    refuse(folder, calibrate_arguments("many.csv"), "do not determine", "turn the array")


def test_an_unknown_method(folder):
    """The methods that there are are listed."""
    refuse(folder, [*calibrate_arguments("run.csv"), "--method", "magic"], "'magic': choose one of maximum_likelihood")


@pytest.mark.parametrize("place", ["here", "1,2", "95,0,2020-01-01", "1,2,2020-13-01", "1,2,1066-10-14"])
def test_places(folder, recording, place):
    """Places that are none, or where the model does not hold."""
    write_recording("bare.csv", Recording(recording.time_s, recording.readings_T))
    refuse(folder, [*calibrate_arguments("bare.csv"), "--place", place])
    refuse(folder, [*calibrate_arguments("run.csv"), "--place", "1,2,2020-01-01"], "this one has its own")


def test_arrays_that_do_not_fit(folder, recording, cross):
    """Another geometry and another number of sensors."""
    write_array("other.yaml", Array.cross(0.6, 1e-9, 1e-10))
    write_array("pair.yaml", Array(np.eye(3)[:2], np.full(2, 1e-9)))
    correct = ["correct", "run.csv", "--calibration", "c.yaml", "-o", "new.csv", "--array"]
    refuse(folder, [*correct, "other.yaml"], "the calibration is of another array")
    refuse(folder, [*correct, "pair.yaml"], "the calibration is of another array")
    refuse(folder, ["calibrate", "run.csv", "--array", "pair.yaml"], "run.csv: the recording has 4 sensors, not 2")
    refuse(folder, ["calibrate", "run", "--array", "pair.yaml"], "run: the bag has 4 sensors, the array 2")
    write_recording("two.csv", Recording(recording.time_s, recording.readings_T[:, :2]))
    refuse(folder, ["correct", "two.csv", "--calibration", "c.yaml", "-o", "new.csv"], "has 2 sensors, not 4")


def test_calibrations_that_are_none(folder):
    """An array file, a truncated file and another version."""
    correct = ["correct", "run.csv", "-o", "new.csv", "--calibration"]
    refuse(folder, [*correct, "array.yaml"], "array.yaml: this is no calibration", "it has no schema")
    text = (folder / "c.yaml").read_text()
    (folder / "cut.yaml").write_text(text[: len(text) // 2])
    refuse(folder, [*correct, "cut.yaml"], "cut.yaml: ")
    (folder / "next.yaml").write_text(text.replace("calibration/1", "calibration/9"))
    refuse(folder, [*correct, "next.yaml"], "calibration/9")


@pytest.mark.parametrize("output", ["missing/new.csv", "run.csv/new.csv", "run", ".", "/dev/null"])
def test_outputs_that_cannot_be_written(folder, output):
    """A folder that is missing or exists, a file for a folder, a device."""
    refuse(folder, ["correct", "run.csv", "--calibration", "c.yaml", "-o", output])
    refuse(folder, ["calibrate", "run.csv", "--array", "array.yaml", "-o", output])
    refuse(folder, ["calibrate", "run.csv", "--array", "array.yaml", "-o", "new.yaml", "--report", output])


CORRECTED_THRICE = """
import sys
from tam_calibration.cli.main import main
for output in ("new.csv", "new", "new.mcap"):
    try:
        main(["correct", "run", "--calibration", "c.yaml", "-o", output])
    except SystemExit as end:
        print(end.code)
"""


def test_a_full_disk_is_one_sentence(folder):
    """When the system lets no more be written the output is named, and nothing is left behind."""
    before = snapshot(folder)

    def let_write_little():
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))

    command = [sys.executable, "-c", CORRECTED_THRICE]
    result = subprocess.run(command, capture_output=True, text=True, preexec_fn=let_write_little)
    assert result.stdout.split() == ["2", "2", "2"]
    for output, sentence in zip(("new.csv", "new", "new.mcap"), result.stderr.splitlines(), strict=True):
        assert sentence.startswith(f"tam: {output} cannot be written: ")
    assert snapshot(folder) == before


def test_a_recording_must_have_a_name(folder):
    """A folder that is there already, as `.` is, names no recording; an empty word is not taken for it."""
    refuse(folder, ["simulate", "wu_table_1", "-o", "."], "names no recording to write")
    refuse(folder, ["simulate", "wu_table_1", "-o", ""], "an empty word names no file")
    for words in (["plan", "", "--array", "array.yaml"], ["nodes", "--calibration", ""], ["demo", "--output-dir", ""]):
        refuse(folder, words, "an empty word names no file")


def test_a_channel_that_is_infinite_throughout_is_not_one_that_is_missing(folder):
    """A sensor of temperature that gives infinity is broken."""

    def append(lines):
        lines[:] = [lines[0] + ",temperature_C", *(line + ",inf" for line in lines[1:])]

    edit(folder / "run.csv", append)
    refuse_recording(folder, "run.csv", "hold infinite values, first temperature_C in sample 1")


def test_nodes_take_no_calibration_that_cannot_be_a_file(folder):
    """It could be read without end, or never be saved."""
    refuse(folder, ["nodes", "--calibration", "/dev/zero"], "/dev/zero is no regular file")
    for path in ("none/c.yaml", "c.yaml/c.yaml"):
        refuse(folder, ["nodes", "--calibration", path], f"{path} cannot be written: there is no folder")


@pytest.mark.parametrize("words", [["play", "run", "a\nb"], ["play", "--a\nb"], ["play", "run", "--rate", "a\nb"]])
def test_words_of_many_lines_are_told_on_one(folder, words):
    """Whatever was typed that no command knows."""
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 4 and r"a\nb" in result.stderr.splitlines()[-1]


def test_only_recordings_are_played(folder):
    """A text that holds none, and nothing at all."""
    refuse(folder, ["play", "array.yaml"], "array.yaml")
    refuse(folder, ["play", "nothing"], "there is no file or bag nothing")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_files_that_may_not_be_read(folder):
    """Recordings, arrays and calibrations without permission."""
    for name in ("run.csv", "run.mcap", "array.yaml", "c.yaml"):
        (folder / name).chmod(0)
    for name in ("run.csv", "run.mcap"):
        refuse_recording(folder, name, "Permission denied")
    refuse(folder, ["correct", "run", "--calibration", "c.yaml", "-o", "new.csv"], "c.yaml cannot be read")
    refuse(folder, ["calibrate", "run", "--array", "array.yaml"], "array.yaml cannot be read")


@pytest.mark.parametrize("value", ["nan", "inf", "-1", "1e30"])
def test_numbers_out_of_range(folder, value):
    """NaN, infinity and what nobody means are told with the option."""
    commands = (
        ["calibrate", "run", "--array", "array.yaml", "--tolerance-s", value],
        ["plan", "--array", "array.yaml", "--prior", "c.yaml", "--turn-rate-deg-s", value],
    )
    for command in commands:
        result = CliRunner().invoke(main, command)
        assert (result.exit_code, result.stdout) == (2, "")
        assert f"Error: Invalid value for '{command[-2]}': " in result.stderr


def test_a_refusal_is_exit_1(folder, recording, monkeypatch):
    """Sound input whose answer is no ends with exit 1 and the reason."""
    from tam_calibration.model.exceptions import Refused

    def refused(*arguments, **options):
        raise Refused("the sensor was disturbed")

    monkeypatch.setattr("tam_calibration.cli.calibrate.calibrate", refused)
    refuse(folder, calibrate_arguments("run.csv"), "Bad: the sensor was disturbed.", code=1)


def test_usage_errors_are_exit_2():
    """Unknown commands and missing options."""
    for arguments in (["fly"], ["calibrate", "run.csv"], ["correct", "--quickly"]):
        assert CliRunner().invoke(main, arguments).exit_code == 2


def test_help_lists_the_commands_without_loading_them():
    """`tam --help` names every command, and imports neither scipy, ROS nor plots."""
    code = "import sys; from tam_calibration.cli.main import main; main(['--help'], standalone_mode=False); " + (
        "sys.exit(any(name in sys.modules for name in ('scipy', 'rclpy', 'matplotlib', 'rosbags', 'pydantic')))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert all(name in result.stdout for name in SUBCOMMANDS)


def test_the_module_runs_too():
    """`python -m tam_calibration` is `tam`, with its exit codes."""
    result = subprocess.run(
        [sys.executable, "-m", "tam_calibration", "--version"], capture_output=True, text=True, check=True
    )
    assert result.stdout.startswith("tam, version ")
    command = [sys.executable, "-m", "tam_calibration", "correct", "no.csv", "--calibration", "no.yaml", "-o", "x.csv"]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 2
    assert result.stderr == "tam: no.yaml cannot be read: No such file or directory\n"
