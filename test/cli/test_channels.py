"""Channels that no sound sensor makes end in exit 1 before any fit, unless they are accepted by name."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from tam_calibration.cli.main import main
from tam_calibration.recordings import write_array
from tam_calibration.results import write_recording


@pytest.fixture
def folder(tmp_path, monkeypatch, cross):
    """Give a working folder with the array."""
    monkeypatch.chdir(tmp_path)
    write_array("array.yaml", cross)
    return tmp_path


def run(recording, change, command, *options):
    """Write a recording whose readings (N, K, 3) a function has changed, and run a command on it."""
    readings_T = recording.readings_T.copy()
    change(readings_T)
    write_recording("run.csv", replace(recording, readings_T=readings_T))
    return CliRunner().invoke(main, [command, "run.csv", "--array", "array.yaml", *options])


def repeated(readings):
    """Sensor 2 is a copy of sensor 1."""
    readings[:, 1] = readings[:, 0]


def mirrored(readings):
    """Axis y of sensor 1 is reversed."""
    readings[:, 0, 1] *= -1


def unit(readings):
    """Axis y of sensor 3 is in microtesla."""
    readings[:, 2, 1] *= 1e-3


def frozen(readings):
    """Sensor 4 holds its reading for a second."""
    readings[100:200, 3] = readings[100, 3]


def quantised(readings):
    """Sensor 3 reads whole microtesla."""
    readings[:, 2] = np.round(readings[:, 2], 6)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (repeated, "sensor 2 repeats sensor 1 throughout"),
        (mirrored, "sensor 1 is left-handed throughout"),
        (unit, "sensor 3 axis y varies by"),
    ],
)
@pytest.mark.parametrize("command", ["calibrate", "diagnose"])
def test_what_no_effect_makes_is_refused_by_both_commands(folder, recording, change, sentence, command):
    """With one sentence and its name, and nothing is written."""
    result = run(recording, change, command, "--json", "new.json")
    assert (result.exit_code, result.stderr) == (1, "")
    (line,) = result.stdout.splitlines()
    advice = "; correct that." if change is mirrored else f"accept it by name: {change.__name__}."
    assert line.startswith(f"Bad: {sentence}") and line.endswith(advice)
    assert not (folder / "new.json").exists()


@pytest.mark.parametrize("change", [frozen, quantised])
def test_what_a_diagnosis_can_name_is_refused_by_a_calibration_only(folder, recording, change):
    """The diagnosis goes on, and says below its verdict why a calibration would not."""
    recording = recording.take(slice(0, 300))
    refused = run(recording, change, "calibrate")
    assert refused.exit_code == 1 and refused.stdout.endswith(f"accept it by name: {change.__name__}.\n")
    diagnosed = run(recording, change, "diagnose")
    assert " tam calibrate would refuse this recording: sensor" in diagnosed.stdout.splitlines()[0]


def test_a_finding_that_is_accepted_is_a_warning(folder, recording, undiagnosed):
    """Beside those of the fit."""
    result = run(recording, quantised, "calibrate", "--accept", "quantised", "--accept", "mirrored")
    assert result.exit_code == 0, result.stderr
    assert "; sensor 3 axis x reads in steps of 1000 nT" in result.stdout.replace("\n", " ")


def test_ten_rows_are_refused(folder, recording, undiagnosed):
    """They leave too few to check the fit on."""
    result = run(recording.take(slice(0, 10)), lambda readings: None, "calibrate")
    assert result.exit_code == 1 and "10 samples leave too few to check a fit on" in result.stdout
    accepted = run(recording.take(slice(0, 10)), lambda readings: None, "calibrate", "--accept", "few_samples")
    assert accepted.exit_code == 0, accepted.stderr


@pytest.mark.parametrize("command", ["calibrate", "diagnose"])
def test_an_unknown_finding_is_bad_input(folder, recording, command):
    """Those that there are are listed."""
    result = run(recording, lambda readings: None, command, "--accept", "everything")
    told = "no finding 'everything' to accept: choose among alternating, few_samples"
    assert result.exit_code == 2 and told in result.stderr
