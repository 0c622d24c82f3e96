"""Options that commands share: each means the same in all of them, and a shell completes what has names."""

import json
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete
from commands import tam

from tam_calibration.cli.main import main
from tam_calibration.effects.library import installed_effects
from tam_calibration.fit import METHODS
from tam_calibration.integrity import ACCEPTABLE

CONTEXT = click.Context(main)
OPTIONS = [
    (name, parameter)
    for name in main.list_commands(CONTEXT)
    for parameter in main.get_command(CONTEXT, name).params
    if isinstance(parameter, click.Option)
]


@pytest.mark.parametrize(
    ("long", "short"), [("--output", "-o"), ("--verbose", "-v"), ("--quiet", "-q")], ids=["output", "verbose", "quiet"]
)
def test_a_letter_and_its_word_go_together(long, short):
    """Neither is found without the other, in any command."""
    found = [(name, set(option.opts)) for name, option in OPTIONS if {long, short} & set(option.opts)]
    assert len(found) > 5 and [name for name, words in found if words != {long, short}] == []


def completed(*words):
    """Return what a shell proposes for the last word."""
    return {
        each.value
        for each in ShellComplete(main, {}, "tam", "_TAM_COMPLETE").get_completions(list(words[:-1]), words[-1])
    }


def test_a_shell_completes_names():
    """Commands, methods, findings, target software, and effects, also behind a comma."""
    assert completed("cali") == {"calibrate"}
    assert completed("calibrate", "--method", "") == set(METHODS)
    assert completed("diagnose", "--accept", "") == set(ACCEPTABLE)
    assert completed("diagnose", "--without", "") == set(installed_effects())
    assert completed("calibrate", "--effects", "auto,bias_j") == {"auto,bias_jump"}
    assert "px4" in completed("export", "--to", "")


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Return a function that runs `tam` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tam


def test_json_goes_to_a_file_or_to_standard_output(run):
    """With a path next to the words, without one or with - instead of them."""
    simulate = ["simulate", "wu_turntable", "-o", "run.csv"]
    words = run(*simulate, "--json", "made.json").stdout
    assert words.startswith("72 samples") and "written: made.json" in words
    made = json.loads(Path("made.json").read_text())
    assert json.loads(run(*simulate, "--json").stdout) == json.loads(run(*simulate, "--json", "-").stdout) == made


def test_json_replaces_no_recording(run):
    """A recording that follows --json by mistake stays as it is."""
    run("simulate", "wu_turntable", "-o", "run.csv")
    before = Path("run.csv").read_bytes()
    told = run("inspect", "--json", "run.csv", "other.csv", code=2).stderr
    assert "run.csv would be overwritten: put --json last" in told and Path("run.csv").read_bytes() == before


@pytest.mark.parametrize(("command", "old"), [("batch", "--out"), ("demo", "--output-dir")])
def test_earlier_spellings_are_taken_and_not_shown(run, command, old):
    """Scripts that have them go on; the help shows --output."""
    assert old + " " not in run(command, "--help").stdout
    assert "No such option" not in run(command, old, "", code=2).stderr
