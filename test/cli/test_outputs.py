"""Every command that writes: no output costs what is stored, outputs appear together, and a signal leaves nothing."""

import os
import signal
import sys
import time
import weakref
from pathlib import Path

import pytest
from click.testing import CliRunner

from tam_calibration.cli.main import main
from tam_calibration.fit import calibrate
from tam_calibration.model.signals import ENDING
from tam_calibration.recordings import write_array
from tam_calibration.results import write_calibration, write_recording

SCENARIO = """
array: {baseline_m: 0.5, vector_noise_nT: 1.0}
intensity_nT: 50000
inclination_deg: 60
samples: 20
rate_Hz: 10
seed: 1
motion: {kind: random}
"""

SOURCE = "{recording: coil.csv, position_m: [5, 0, 0], axis: [0, 0, 1], moment_Am2: 100, frequency_Hz: 10}"


@pytest.fixture(scope="module")
def stored(tmp_path_factory, recording, cross):
    """Return a folder with good files of every kind."""
    folder = tmp_path_factory.mktemp("stored")
    write_recording(folder / "s.csv", recording)
    write_recording(folder / "bag", recording)
    write_recording(folder / "other.mcap", recording)
    write_recording(folder / "coil.csv", recording)
    write_array(folder / "a.yaml", cross)
    for name in ("c.yaml", "x.truth.yaml", "x.array.yaml"):
        write_calibration(folder / name, calibrate(recording, cross))
    (folder / "scenario.truth.yaml").write_text(SCENARIO)
    (folder / "observed.yaml").write_text(SCENARIO + "drift: {kind: observatory, file: day.csv}\n")
    (folder / "day.csv").write_text("an observatory's record")
    (folder / "source.yaml").write_text(SOURCE)
    (folder / "hard.csv").hardlink_to(folder / "s.csv")
    (folder / "into").symlink_to("bag")
    return folder


def content(folder):
    """Return the bytes of all files below a folder; None for other paths."""
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


CALIBRATE = "calibrate bag --array a.yaml"
CORRECT = "correct s.csv --calibration c.yaml"
TWIN = "simulate --from-calibration c.yaml --recording"


@pytest.mark.parametrize(
    "command",
    [
        f"{CALIBRATE} -o bag/metadata.yaml",
        f"{CALIBRATE} -o bag/bag.db3",
        f"{CALIBRATE} -o into/new.yaml",
        f"{CALIBRATE} --json bag/new.json",
        f"{CALIBRATE} --report bag/new.html",
        f"{CALIBRATE} -o A.yaml",
        f"{CALIBRATE} -o other.mcap",
        f"{CALIBRATE} -o new.yaml --source source.yaml --json coil.csv",
        "diagnose bag --array a.yaml --report bag/bag.db3",
        "diagnose s.csv --array a.yaml --calibration c.yaml --json c.yaml",
        "diagnose s.csv --array a.yaml --json bag/metadata.yaml",
        f"{CORRECT} -o hard.csv",
        f"{CORRECT} -o bag/corrected",
        f"{CORRECT} -o other.mcap",
        f"{CORRECT} --array a.yaml -o a.yaml",
        "locate bag --calibration c.yaml --report bag/metadata.yaml",
        "locate s.csv --calibration c.yaml --report c.yaml",
        "simulate scenario.truth.yaml -o scenario.csv",
        "simulate scenario.truth.yaml -o SCENARIO.csv",
        "simulate observed.yaml -o day.csv",
        "simulate wu_table_1 -o bag/new.csv",
        "simulate wu_table_1 --from-calibration x.truth.yaml -o x.csv",
        "simulate wu_table_1 --from-calibration x.array.yaml -o x.csv",
        f"{TWIN} s.csv -o s.csv",
        f"{TWIN} bag -o bag/new.csv",
        "batch s.csv --array a.yaml --out bag",
        "batch s.csv --array a.yaml --out into/results",
        "blind inject s.csv --array a.yaml --effect bias_jump -o hard.csv",
        "blind make bag/cases --seed 1",
        "demo --output-dir bag",
        "reproduce li2018a --output-dir bag",
        "export c.yaml --to px4 -o c.yaml",
        "export c.yaml --to json -o bag/new.json",
        "recover bag -o bag",
        "recover into -o bag/new",
        "recover bag -o other.mcap",
        "inspect s.csv --write-map s.csv",
        "compare s.csv bag --array a.yaml --mend s.csv",
        "compare s.csv bag --array a.yaml --mend bag/new.yaml",
        "compare s.csv bag --array a.yaml --mend a.yaml",
        f"{CALIBRATE} -o new.yaml --json new.yaml",
    ],
)  # fmt: skip
def test_no_output_costs_what_is_stored(stored, monkeypatch, command):
    """One sentence, exit 2, and every byte as it was."""
    monkeypatch.chdir(stored)
    before = content(stored)
    result = CliRunner().invoke(main, command.split())
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert len(result.stderr.splitlines()) == 1 and result.stderr.startswith("tam: ")
    assert any(words in result.stderr for words in ("would be overwritten", "lies inside", "exists already"))
    assert content(stored) == before


def test_a_batch_keeps_what_it_reads(stored, tmp_path, monkeypatch):
    """A calibration of an earlier batch is none of its results while it is used, nor is a summary."""
    monkeypatch.chdir(tmp_path)
    for name in ("out/recordings/auv/run/calibration.yaml", "out/summary.json"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes((stored / "c.yaml").read_bytes())
        before = content(tmp_path)
        words = ["batch", str(stored / "s.csv"), "--array", str(stored / "a.yaml"), "--out", "out"]
        result = CliRunner().invoke(main, [*words, "--calibration", name])
        assert result.exit_code == 2 and "would be overwritten" in result.stderr
        assert content(tmp_path) == before


@pytest.mark.parametrize("taken", ["x.csv", "x.array.yaml", "x.truth.yaml"])
def test_a_simulation_appears_whole_or_not_at_all(tmp_path, monkeypatch, taken):
    """A folder stands where one of its three files should go."""
    monkeypatch.chdir(tmp_path)
    Path(taken).mkdir()
    result = CliRunner().invoke(main, ["simulate", "wu_table_1", "-o", "x.csv"])
    assert result.exit_code == 2 and f"{taken} is a folder that exists already" in result.stderr
    assert os.listdir() == [taken]


def test_a_dead_scheduler_leaves_nothing(stored, tmp_path, monkeypatch):
    """Neither a lock nor the folders that were made for the results."""
    pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tam_calibration.fleet.batch.CONNECT_S", 0.5)
    words = ["batch", str(stored / "s.csv"), "--array", str(stored / "a.yaml"), "--scheduler", "tcp://127.0.0.1:1"]
    result = CliRunner().invoke(main, [*words, "--out", "new/out"])
    assert result.exit_code == 2 and "no scheduler answers" in result.stderr
    assert os.listdir() == []


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)], ids=lambda each: each
)
@pytest.mark.parametrize("is_lost", [False, True])
def test_a_signal_ends_a_command_with_its_code_and_leaves_nothing(tmp_path, monkeypatch, number, code, is_lost):
    """Also where a library takes it for a failure of its own."""
    monkeypatch.chdir(tmp_path)
    before = {each: signal.getsignal(each) for each in ENDING}
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which nohup has it ignored

    def simulate(scenario):
        try:
            signal.raise_signal(number)
        except SystemExit:
            if is_lost:
                raise RuntimeError("it is not as it should be") from None
            raise

    monkeypatch.setattr("tam_calibration.cli.simulate.simulate", simulate)
    result = CliRunner().invoke(main, ["simulate", "wu_table_1", "-o", "x.csv"])
    assert (result.exit_code, result.output, os.listdir()) == (code, "", [])
    for each, handler in before.items():
        signal.signal(each, handler)


def test_a_signal_in_the_callback_of_an_object_that_goes_ends_the_command(tmp_path, monkeypatch, capsys):
    """Python cannot raise it there: it is raised a moment later, and nothing is told but the exit code."""
    monkeypatch.chdir(tmp_path)
    before = {each: signal.getsignal(each) for each in (*ENDING, signal.SIGALRM)}

    class Thing:
        pass

    def simulate(scenario):
        thing = Thing()
        reference = weakref.ref(thing, lambda _: signal.raise_signal(signal.SIGTERM))
        del thing
        limit = time.monotonic() + 5
        while reference() is None and time.monotonic() < limit:
            pass

    monkeypatch.setattr("tam_calibration.cli.simulate.simulate", simulate)
    result = CliRunner().invoke(main, ["simulate", "wu_table_1", "-o", "x.csv"])
    assert (result.exit_code, result.output, os.listdir()) == (143, "", [])
    assert capsys.readouterr().err == ""
    for each, handler in before.items():
        signal.signal(each, handler)


def test_a_command_that_ends_by_itself_leaves_the_signals_as_they_were():
    """A program that calls a command keeps its own handlers."""
    before = [signal.getsignal(number) for number in ENDING] + [sys.unraisablehook]
    assert CliRunner().invoke(main, ["simulate", "none", "-o", "x.csv"]).exit_code == 2
    assert [signal.getsignal(number) for number in ENDING] + [sys.unraisablehook] == before
