"""The pages on simulators: the tutorial's commands are run and print what it shows; the guide's lists are complete."""

import re
import shlex
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from mujoco_vehicle import main as vehicle

from tam_calibration.cli.main import main as tam
from tam_calibration.comparison.mend import python_plugin
from tam_calibration.comparison.mistakes.units import _UNITS

ROOT = Path(__file__).parents[1]

TUTORIAL = (ROOT / "docs" / "tutorials" / "simulator.md").read_text(encoding="utf-8")
GUIDE = (ROOT / "docs" / "how_to" / "compare.md").read_text(encoding="utf-8")

NUMBER = re.compile(r"\d+(?:\.\d+)?")

PROGRAMS = {"tam": (tam, 1), "python": (vehicle, 2)}
"""What runs a command, and how many of its words name that."""


def blocks(text):
    """Return the blocks of a text: language and content of each."""
    return re.findall(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def worked_case():
    """Return the blocks between the headline of the case and the next."""
    return blocks(TUTORIAL.partition("## From a MuJoCo model")[2].partition("\n## ")[0])


def run(command):
    """Run a command of the page, which ends with the exit code that the page says, and return what it prints."""
    words = shlex.split(command, comments=True)
    program, named = PROGRAMS[words[0]]
    result = CliRunner().invoke(program, words[named:])
    said = re.search(r"# exit code (\d)", command)
    assert result.exit_code == (int(said[1]) if said else 0), result.output
    return result.stdout


def is_printed(line, output):
    """Whether the words of a line are in an output, one after another, and its numbers nearly: they vary by machine."""
    line, output = (" ".join(text.split()) for text in (line, output))
    pattern = f"({NUMBER.pattern})".join(map(re.escape, NUMBER.split(line)))
    return any(
        [float(number) for number in found.groups()]
        == pytest.approx([float(number) for number in NUMBER.findall(line)], rel=0.1, abs=0.05)
        for found in re.finditer(pattern, output)
    )


@pytest.fixture
def judged_once(monkeypatch):
    """Judge the recording, which two commands compare, once."""
    module, judged = import_module("tam_calibration.comparison.compare"), {}
    side_of = module.side_of

    def once(source, array, progress=None):
        readings = module.in_stretches(source)[0].readings_T.tobytes()
        if readings not in judged:
            judged[readings] = side_of(source, array, progress)
        return judged[readings]

    monkeypatch.setattr(module, "side_of", once)


def test_the_worked_case_prints_what_the_page_shows(tmp_path, monkeypatch, judged_once):
    """Mistake, missing effect and mend, from the model of the simulator to a simulation that is the same."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: .venv/bin/pip install -e '.[compare]'")
    monkeypatch.chdir(tmp_path)
    output, shown = "", 0
    for language, content in worked_case():
        if language == "yaml":
            Path("robot.yaml").write_text(content, encoding="utf-8")
        elif content.split()[0] in PROGRAMS:
            output = "".join(map(run, content.splitlines()))
        else:
            shown += 1
            assert [line for line in content.splitlines() if not is_printed(line, output)] == [], output
    assert shown == 3


@pytest.mark.parametrize("other", ["sensor 2 x 2.0 nT, 12 of 13", "sensor 3 x 1.5 nT, 12 of 13", "sensor 2 x"])
def test_a_line_that_is_not_printed_is_told(other):
    """Other words and other numbers are; another last digit is not."""
    assert is_printed("sensor 2 x 1.5 nT", "noise of sensor 2 x 1.51 nT, 12 of 13")
    assert not is_printed("sensor 2 x 1.5 nT", other)


def test_the_lines_of_the_plugin_are_those_that_the_mend_holds():
    """To copy from the page or from the report."""
    assert python_plugin(SimpleNamespace(added=())) in [content for _, content in blocks(GUIDE)]


def test_the_table_of_mistakes_has_every_kind():
    """Of units by their names, of the others as they stand in the code; and no other."""
    rows = GUIDE.partition("## Gross mistakes")[2].partition("\n## ")[0].splitlines()
    told = [kind for row in rows if row.startswith("| `") for kind in re.findall(r"`(\w+)`", row.split("|")[1])]
    files = (ROOT / "tam_calibration" / "comparison" / "mistakes").glob("[!_]*.py")
    known = {kind for file in files for kind in re.findall(r'"([a-z]+(?:_[a-z]+)+)"', file.read_text(encoding="utf-8"))}
    assert sorted(told) == sorted(known | {f"{given}_for_{expected}" for given, expected in _UNITS})
