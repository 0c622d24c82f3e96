"""Small inputs with a huge cost: each has a bound, which the sentence tells before anything of that size is made."""

import os
import socket
from pathlib import Path

import numpy as np
import pytest
from click import BadParameter
from click.testing import CliRunner

from tam_calibration.cli.main import main
from tam_calibration.cli.terminal import Number
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import MOST_SENSORS, Recording
from tam_calibration.simulation.observe import MOST_READINGS

SCENARIO = """
array: {{baseline_m: 0.5, vector_noise_nT: 1, scalar_noise_nT: 0.1}}
site: {{intensity_nT: 50000, inclination_deg: 60}}
motion: {{kind: tumble}}
samples: {samples}
rate_hz: 100
effects: [{effects}]
"""


def refused(*arguments):
    """Return the sentence with which a command refuses its input."""
    result = CliRunner().invoke(main, list(arguments))
    assert result.exit_code == 2, (result.output, result.exception)
    *_, sentence = result.stderr.splitlines()
    return sentence


def put(kind, path):
    """Put something in the place of an input that is no regular file."""
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        server = socket.socket(socket.AF_UNIX)
        server.bind(os.path.relpath(path))
        server.close()
    elif kind == "loop":
        path.symlink_to(path.with_name(f"{path.name}.link"))
        path.with_name(f"{path.name}.link").symlink_to(path)
    else:
        path.symlink_to(kind)


COMMANDS = {
    "recording.csv": ["calibrate", "recording.csv", "--array", "array.yaml"],
    "recording": ["diagnose", "recording", "--array", "array.yaml"],
    "recording.mcap": ["correct", "recording.mcap", "--calibration", "c.yaml", "-o", "out.csv"],
    "bag.db3": ["play", "bag.db3"],
    "poses.csv": ["plan", "poses.csv", "--array", "array.yaml", "--turntable", "30"],
    "other.yaml": ["diagnose", "run.csv", "--array", "other.yaml"],
    "calibration.yaml": ["locate", "run.csv", "--calibration", "calibration.yaml"],
    "made.yaml": ["simulate", "made.yaml", "-o", "made.csv"],
    "twin.csv": ["simulate", "--from-calibration", "c.yaml", "--recording", "twin.csv", "-o", "made.csv"],
}


@pytest.mark.parametrize("kind", ["/dev/zero", "pipe", "socket", "loop"])
@pytest.mark.parametrize("name", COMMANDS)
def test_only_regular_files_are_read(folder, name, kind):
    """A device has no end, a pipe nobody writes to, and a loop of links leads nowhere: nothing waits for them."""
    put(kind, folder / name)
    sentence = refused(*COMMANDS[name])
    assert name in sentence
    assert ("no regular file" in sentence) == (kind != "loop")


@pytest.mark.parametrize(
    "arguments",
    [
        ["batch", "loop.csv", "--array", "array.yaml", "--out", "results"],
        ["batch", "run.csv", "--array", "array.yaml", "--out", "loop.csv"],
        ["recover", "run", "-o", "loop.csv"],
    ],
)
def test_a_loop_of_links_is_told_wherever_it_stands(folder, arguments):
    """As a pattern that finds nothing, or a place where nothing can be written."""
    put("loop", folder / "loop.csv")
    assert "loop.csv" in refused(*arguments)


@pytest.mark.parametrize("name", ["metadata.yaml", "run.db3"])
@pytest.mark.parametrize("kind", ["/dev/zero", "pipe"])
def test_nor_does_a_bag_hold_anything_else(folder, name, kind):
    """Whatever the metadata name is a file of the folder."""
    (folder / "run" / name).unlink()
    put(kind, folder / "run" / name)
    assert f"run/{name} is no regular file" in refused("diagnose", "run", "--array", "array.yaml")


@pytest.mark.parametrize("option", ["--array", "--calibration"])
def test_a_folder_is_no_text(folder, option):
    """It is told as such."""
    (folder / "other").mkdir()
    rest = ["--array", "array.yaml"] if option == "--calibration" else []
    assert "other cannot be read: Is a directory" in refused("diagnose", "run.csv", option, "other", *rest)


@pytest.mark.parametrize("size", [1 << 27, 1 << 40])
def test_a_text_has_a_longest_size(folder, size):
    """A file with a hole takes no room on the disk, but would in memory."""
    for name in ("big.yaml", "big.csv"):
        (folder / name).touch()
        os.truncate(folder / name, size)
    assert f"big.yaml has {size} bytes, and at most 67108864 are read" in refused(
        "diagnose", "run.csv", "--array", "big.yaml"
    )
    assert "big.csv is not a text file" in refused("diagnose", "big.csv", "--array", "array.yaml")


@pytest.mark.parametrize("end", ["", "\n0,1,2,3"])
def test_a_line_has_a_longest_size(folder, end):
    """The header's as any other's."""
    Path("long.csv").write_text("time_s,b1x_nT,b1y_nT,b1z_nT" + end + "0" * 20_000_000)
    line = 2 if end else 1
    sentence = refused("diagnose", "long.csv", "--array", "array.yaml")
    assert f"long.csv line {line} is longer than 65536 characters" in sentence


@pytest.mark.parametrize("number", ["65", "999999999", "9" * 5000])
def test_an_array_has_a_largest_number_of_sensors(folder, number):
    """A column that names the last of a billion sensors makes no billion columns."""
    Path("many.csv").write_text(f"time_s,b{number}x_nT\n0,1\n")
    sentence = refused("diagnose", "many.csv", "--array", "array.yaml")
    told = "at most 64" if len(number) < 10 else "no vector of a magnetic field is recognised"
    assert MOST_SENSORS == 64 and told in sentence
    Path("many.yaml").write_text(f"positions_m: {[[float(sensor), 0.0, 1.0] for sensor in range(65)]}")
    assert "there are 65 sensors, and an array has at most 64" in refused("diagnose", "run.csv", "--array", "many.yaml")


def test_readings_of_more_sensors_are_no_recording():
    """Nor from Python."""
    with pytest.raises(InputError, match="there are 65 sensors, and an array has at most 64"):
        Recording(np.arange(3.0), np.ones((3, 65, 3)))


@pytest.mark.parametrize("samples", [MOST_READINGS // 4 + 1, 1_000_000_000, 10**30])
def test_a_scenario_has_a_largest_number_of_samples(folder, samples):
    """They are told before any is simulated."""
    Path("big.yaml").write_text(SCENARIO.format(samples=samples, effects=""))
    sentence = refused("simulate", "big.yaml", "-o", "big.csv")
    assert MOST_READINGS == 8_000_000
    assert f"at most 2000000 samples of 4 sensors, not {samples}" in sentence


@pytest.mark.parametrize("value", ["1e12", "101", "-1", "1e29"])
@pytest.mark.parametrize("effect", ["outliers", "stale_samples", "interpolated_samples"])
def test_bursts_are_no_longer_than_the_run(folder, effect, value):
    """A burst of so many samples would be laid out in memory."""
    values = f"{{rate: 0.01, size: 1 nT, burst: {value}, samples late: 1}}"
    stated = f"{{effect: {effect}, terms: [{{sensor: 1, term: repeats, values: {values}}}]}}"
    Path("bursts.yaml").write_text(SCENARIO.format(samples=100, effects=stated))
    assert "the burst of repeats must be at most the 100 samples of the run" in refused(
        "simulate", "bursts.yaml", "-o", "big.csv"
    )


def test_a_rate_of_bursts_is_a_part(folder):
    """More than all samples cannot be struck."""
    stated = "{effect: outliers, terms: [{sensor: 1, term: spikes, values: {rate: 50, size: 1 nT, burst: 100}}]}"
    Path("bursts.yaml").write_text(SCENARIO.format(samples=100, effects=stated))
    assert "the rate of spikes must be a part of all samples, 0 to 1, not 50" in refused(
        "simulate", "bursts.yaml", "-o", "big.csv"
    )


@pytest.mark.parametrize(
    ("arguments", "most"),
    [
        (["plan", "--array", "array.yaml", "--turntable", "30", "--poses", "100000"], 200),
        (["plan", "--array", "array.yaml", "--turntable", "30", "--samples-per-pose", "9" * 400], 1_000_000),
        (["batch", "run.csv", "--array", "array.yaml", "--out", "o", "--jobs", "100000000000"], 256),
        (["blind", "make", "o", "--seed", "1", "--cases", "1000000000"], 9999),
        (["blind", "make", "o", "--seed", "1", "--jobs", "1000000000"], 256),
        (["reproduce", "wu2025", "--seeds", "1000000000"], 1000),
        (["play", "run", "--rate", "1e4"], 1000.0),
        (["plan", "--array", "array.yaml", "--turntable", "30", "--poses", "9" * 400], 200),
        (["play", "run", "--rate", "inf"], 1000.0),
    ],
)
def test_numbers_on_the_command_line_have_a_largest(folder, arguments, most):
    """It is told with the range."""
    told = refused(*arguments)
    assert f"<={most}" in told and len(told) < 300


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "1e999"])
@pytest.mark.parametrize(("least", "most"), [(0, 60), (0.001, None), (None, None)])
def test_a_number_of_the_command_line_is_finite(number, least, most):
    """Also where its range has no end."""
    with pytest.raises(BadParameter, match=r"is not a finite number|is not in the range"):
        Number(least, most).convert(number, None, None)
    assert Number(least, most).convert("0.5", None, None) == 0.5
