"""Standard streams that are closed, full or of another encoding, and names that are no text."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from tam_calibration.cli.main import main
from tam_calibration.cli.streams import say, tell
from tam_calibration.cli.terminal import print_blocks, say_written, stdout
from tam_calibration.recordings import write_array
from tam_calibration.report.blocks import Table
from tam_calibration.results import read_calibration, write_recording

_INSPECT = ["inspect", "run.csv"]
_CALIBRATE = ["calibrate", "run.csv", "--array", "array.yaml", "-o", "new.yaml"]


@pytest.fixture
def folder(tmp_path, monkeypatch, recording, cross):
    """Give a working folder with a short recording and its array."""
    monkeypatch.chdir(tmp_path)
    write_recording("run.csv", recording.take(slice(150)))
    write_array("array.yaml", cross)
    return tmp_path


def run(arguments, redirection="", command='exec "$@"', **environment):
    """Run `tam` in a shell that redirects its streams; return its exit code and what it wrote to both."""
    ended = subprocess.run(
        ["bash", "-c", f"{command} {redirection}", "bash", sys.executable, "-m", "tam_calibration", *arguments],
        capture_output=True,
        timeout=100,
        env=os.environ | environment,
    )
    return ended.returncode, ended.stdout, ended.stderr


@pytest.mark.parametrize("arguments", [["--help"], _CALIBRATE], ids=["help", "calibrate"])
def test_output_that_is_full_is_a_sentence(folder, arguments):
    """Nothing else is written then, where a device says it before."""
    sentence = b"tam: standard output cannot be written: No space left on device\n"
    assert run(arguments, ">/dev/full") == (2, b"", sentence)
    assert not (folder / "new.yaml").exists()


def test_what_is_found_full_at_the_end_is_a_sentence(folder):
    """A file that may not grow says so only when it is written to."""
    (folder / "out.txt").write_bytes(b"x" * 1024)
    code, output, errors = run(_INSPECT, PYTHONUNBUFFERED="", command='ulimit -f 1; exec "$@" >>out.txt')
    assert (code, output, errors) == (2, b"", b"tam: File too large\n")


def test_output_that_is_closed_is_a_sentence(folder):
    """The answer would be lost: nothing is written."""
    sentence = b"tam: standard output is closed: lead it to a file, or to /dev/null\n"
    assert run(_CALIBRATE, ">&-") == (2, b"", sentence)
    assert not (folder / "new.yaml").exists()


@pytest.mark.parametrize("redirection", ["2>&- <&-", "2>/dev/full"])
def test_other_streams_that_are_closed_change_no_result(folder, redirection):
    """What would be told beside the answer is lost, the file is written whole."""
    code, _, errors = run(_CALIBRATE, redirection)
    assert (code, errors) == (0, b"")
    assert read_calibration("new.yaml").errors.sensor_count == 4


def test_a_sentence_that_nobody_hears_keeps_its_code(folder):
    """Bad input is exit 2 also where the sentence cannot be written."""
    assert run(["correct", "none.csv", "--calibration", "none.yaml", "-o", "x.csv"], "2>/dev/full")[0] == 2


def test_letters_that_an_encoding_lacks_are_written_as_escapes(folder):
    """Tables and sentences of faults are there in ASCII surroundings too."""
    environment = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    code, output, errors = run([*_CALIBRATE, "-v"], **environment)
    assert (code, errors) == (0, b"") and b" \\xb1 " in output and output.isascii()
    code, _, errors = run(["correct", "run.csv", "--calibration", "ä.yaml", "-o", "x.csv"], **environment)
    assert code == 2 and errors.isascii() and errors.endswith(b".yaml cannot be read: No such file or directory\n")


def test_names_that_are_no_text_are_read_and_written(folder):
    """Inputs and outputs may have them; in files their bytes stand as escapes."""
    odd = os.fsencode("run") + b"\xff\xfe.csv"
    os.rename(b"run.csv", odd)
    outputs = [b"-o", b"\xff.yaml", b"--json", b"\xff.json"]
    code, output, errors = run([b"calibrate", odd, b"--array", b"array.yaml", *outputs])
    assert (code, errors) == (0, b"") and b"written: \\udcff.yaml\n" in output
    assert read_calibration(os.fsdecode(b"\xff.yaml")).source.name == "run\\udcff\\udcfe.csv"
    refused = CliRunner().invoke(main, ["simulate", "wu_table_1", "-o", os.fsdecode(b"\xff")])
    assert refused.exit_code == 2 and refused.stderr.startswith("tam: \\udcff is no name for a bag")
    assert refused.stderr.count("\n") == 1


def test_memory_that_does_not_suffice_is_a_sentence(monkeypatch, capsys):
    """Numpy's sentence is not repeated."""

    def allocate(*arguments):
        raise MemoryError("Unable to allocate 29.8 GiB for an array")

    monkeypatch.setattr("tam_calibration.cli.calibrate.read_array", allocate)
    with pytest.raises(SystemExit) as end:
        main(_CALIBRATE, prog_name="tam")
    assert end.value.code == 2
    assert capsys.readouterr().err == "tam: this needs more memory than there is: give fewer samples or sensors\n"


@pytest.mark.parametrize("limit_MiB", [250, 330, 500])
def test_a_diagnosis_within_a_limit_of_memory_ends(folder, limit_MiB):
    """It says what it needs before it loads what would ask for memory without end, and works where there is enough."""
    arguments = ["diagnose", "run.csv", "--array", "array.yaml"]
    code, output, errors = run(arguments, command=f'ulimit -v {limit_MiB << 10}; exec "$@"')
    if limit_MiB < 500:
        assert (code, output, errors.count(b"\n")) == (2, b"", 1)
        assert errors.startswith(
            b"tam: this process may have %d MiB of memory, and needs 224 in addition to the " % limit_MiB
        )
    else:
        assert code in (0, 1) and b"No gap" in output


@pytest.mark.parametrize(
    ("sentence", "told"),
    [
        ("there is no file a\nb", "tam: there is no file a\\nb\n"),
        (
            "\x1b[2J\u202e\udcff is none: 54\u2009955 nT, Größe",
            "tam: \\u001b[2J\\u202e\\udcff is none: 54\u2009955 nT, Größe\n",
        ),
        (f"not {10**300}, nor {1e308:.2f}", f"tam: not 1{'0' * 11}…{'0' * 12}, nor 100000000000…430223118336.00\n"),
        ("x" * 1000 + "y" * 5000 + "z" * 1000, f"tam: {'x' * 1000} … {'z' * 1000}\n"),
    ],
)
def test_a_sentence_is_one_line_whatever_is_named_in_it(capsys, sentence, told):
    """Line breaks and commands to terminals are written by their numbers, the middle of thousands of letters not."""
    tell(sentence)
    assert capsys.readouterr().err == told


HOSTILE = ["\x1b[31mred.csv", "\x1b]0;title\x07", "a\rb", "\x9b2J", "\u202egnp.exe", "\udcff", "\x7f", "\u2028"]


@pytest.mark.parametrize("name", HOSTILE)
def test_a_name_sends_no_command_to_the_terminal(capsys, name):
    """Whether it stands in a line, in a table or in its title; JSON stays JSON with the same name."""
    say(f"{name}\nnext line")
    say_written([Path(name), None])
    stdout().print(f"{name} is read", soft_wrap=True)
    print_blocks([Table(("name", "count"), [[name, "1"]], name)])
    told = capsys.readouterr().out
    assert "".join(told.split("\n")).isprintable() and len(told.split("\n")) > 8
    say(json.dumps({"name": name}, ensure_ascii=False))
    assert json.loads(capsys.readouterr().out) == {"name": name}


def test_all_that_commands_print_goes_through_it():
    """Nothing is printed as it came."""
    sources = {path.name: path.read_text() for path in Path(main.callback.__code__.co_filename).parent.glob("*.py")}
    assert [name for name, source in sources.items() if "click.echo(" in source] == ["streams.py"]
