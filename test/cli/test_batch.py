"""`tam batch`: tables and exit codes, bad input in one sentence, and no loss when it is killed."""

import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial
from importlib import import_module

import numpy as np
import pytest
from click.testing import CliRunner
from commands import tam
from inspected import fields, numbers, write_bag
from matplotlib.figure import Figure

from tam_calibration.cli.main import main
from tam_calibration.fit import calibrate
from tam_calibration.fleet.task import process, read_result
from tam_calibration.model.array import Array
from tam_calibration.recordings import write_array
from tam_calibration.results import write_calibration, write_recording

HOSTILE = "dive\x1b[31m\u202e.csv"
KILLS = int(os.environ.get("KILLS", "3"))
PATIENCE_S = 300
MOMENT_S = 0.01


@pytest.fixture(scope="module")
def cross(cross):
    """Return an array of two sensors, whose calibrations are written in a quarter of the time that four take."""
    return Array(cross.positions_m[:2], cross.vector_noise_T[:2], cross.scalar_noise_T)


@pytest.fixture(scope="module")
def recording(recording):
    """Return the recording of the two."""
    return replace(recording, readings_T=recording.readings_T[:, :2])


@pytest.fixture(scope="module")
def files(tmp_path_factory, recording, cross):
    """Return a folder with five short missions in all formats, one of them damaged, and the array file."""
    folder = tmp_path_factory.mktemp("batch")
    recording = recording.take(slice(0, 150))
    for place, platform in enumerate(("auv_1", "auv_2", "auv_1", "auv_2")):
        (folder / "missions" / platform).mkdir(parents=True, exist_ok=True)
        mission = replace(recording, time_s=recording.time_s + 86400.0 * place)
        ending, storage = [(".csv", ""), (".mcap", ""), ("", "sqlite3"), ("", "mcap")][place]
        write_recording(folder / "missions" / platform / f"dive_{place}{ending}", mission, storage)
    (folder / "missions/auv_2/damaged.mcap").write_text("no bag")
    write_array(folder / "array.yaml", cross)
    return folder


@pytest.fixture
def asked(monkeypatch, gap):
    """Work in this process with stand-ins for the diagnosis, which is dear, and for what test_summary.py sees drawn.

    Return what the diagnosis shall answer, and the jobs asked for.
    """
    asked = {"answer": gap}

    def run_here(tasks, jobs):
        asked["jobs"] = jobs
        for task in tasks:
            process(task)
            yield task, ""

    monkeypatch.setattr(import_module("tam_calibration.fleet.batch"), "run_here", run_here)
    task = import_module("tam_calibration.fleet.task")
    monkeypatch.setattr(task, "diagnose", lambda recording, array: asked["answer"])
    summary = import_module("tam_calibration.fleet.summary")
    monkeypatch.setattr(summary, "plot_missions", lambda missions, group: Figure())
    return asked


run = partial(tam, "batch", "--array", "array.yaml", "-o", "out")


def test_the_first_line_is_the_answer(folder, asked):
    """How many are settled, and the first that is not; few lines follow."""
    first, *others = run("missions/**", code=1).stdout.splitlines()
    assert first.startswith(
        "4 of 5 recordings are settled; the first of the others: auv_2/damaged.mcap: failed; read: "
    )
    assert len(others) < 20 and others[-1] == "written: out/summary.json"
    assert run("missions/**", "--quiet", code=1).stdout == f"{first}\n"


def test_people_see_counts_drifts_and_failures(folder, asked):
    """By platform; the failure in its own sentence; where the summaries are."""
    out = run("missions/**", "--jobs", "3", code=1).stdout
    assert asked["jobs"] == 3
    for words in ("auv_1", "auv_2", "temperature_drift 2", "drift per day", "auv_2/damaged.mcap: failed; read: "):
        assert words in out
    assert out.endswith("written: out/summary.html\nwritten: out/summary.csv\nwritten: out/summary.json\n")


@pytest.mark.parametrize(
    ("verdict", "code"),
    [("no_gap", 0), ("explained", 0), ("partly_explained", 1), ("unexplained", 1), ("not_identifiable", 1)],
)
def test_the_exit_code_tells_whether_something_is_open(folder, asked, gap, verdict, code):
    """A gap that stays open in one recording is exit 1, and its statement is told."""
    asked["answer"] = replace(gap, verdict=verdict, causes=gap.causes if "explained" in verdict else ())
    out = run("missions/auv_1/*", code=code).stdout
    assert ("dive_0.csv: done; The readings of sensor 2 drift" in out) == bool(code)


def test_every_core_works_by_default(folder, asked):
    """As many processes as this one may use cores."""
    run("missions/auv_1/*.csv")
    assert asked["jobs"] == len(os.sched_getaffinity(0))


def test_recordings_of_strange_names_are_read_by_a_map(folder, asked, recording):
    """What one map names is read of each; without it sensors of two kinds are ambiguous."""
    stamps_ns = np.round(recording.time_s * 1e9).astype(np.int64)
    topics = {
        f"/{name}_{n}": (fields(recording.readings_T[:, n], stamps_ns), stamps_ns)
        for name in ("fine", "coarse")
        for n in range(2)
    }
    scalar = numbers(recording.scalar_T * 1e9), stamps_ns
    write_bag(folder / "strange", {**topics, "/overhauser": scalar})
    picks = ", ".join(f"{{topic: /fine_{n}}}" for n in range(2))
    (folder / "map.yaml").write_text(f"sensors: [{picks}]\nscalar: {{topic: /overhauser, field: data, unit: nT}}\n")
    assert "several sets of sensors may be meant" in " ".join(run("strange", code=1).stdout.split())
    assert "strange: failed" not in run("strange", "--map", "map.yaml").stdout


def refuse(folder, arguments, *words, code=2):
    """Check that the command ends with one sentence, and writes nothing."""
    before = sorted(folder.rglob("*"))
    result = CliRunner().invoke(main, ["batch", *arguments])
    assert result.exit_code == code and result.stdout == "", result.output
    assert len(result.stderr.splitlines()) == 1 and result.stderr.startswith("tam: ")
    for word in words:
        assert word in result.stderr
    assert sorted(folder.rglob("*")) == before


def test_bad_input_is_one_sentence(folder, asked, recording, cross):
    """No recording, no array, a calibration that is none or of another array, two places to work at once."""
    array, out = ["--array", "array.yaml"], ["-o", "out"]
    refuse(folder, ["missions/**/*.bag", *array, *out], "no recording is found by missions/**/*.bag")
    refuse(folder, ["none.csv", *array, *out], "none.csv")
    refuse(folder, ["missions/**", "--array", "none.yaml", *out], "none.yaml cannot be read")
    refuse(folder, ["missions/**", *array, *out, "--calibration", "array.yaml"], "array.yaml")
    refuse(folder, ["missions/**", *array, "-o", "array.yaml"], "array.yaml cannot be written")
    refuse(folder, ["missions/**", *array, *out, "--jobs", "2", "--scheduler", "tcp://a:1"], "either --jobs")
    write_calibration(folder / "c.yaml", calibrate(recording, cross))
    write_array(folder / "far.yaml", replace(cross, positions_m=3 * cross.positions_m))
    refuse(folder, ["missions/**", "--array", "far.yaml", *out, "--calibration", "c.yaml"], "of another array")


def test_recordings_that_do_not_fit_the_array_fail_each_with_its_sentence(folder, asked, recording):
    """Another number of sensors, a table that is none, an empty bag: told, and the good ones are done."""
    write_recording(
        folder / "missions/auv_1/three.csv", replace(recording, readings_T=recording.readings_T[:, [0, 1, 0]])
    )
    (folder / "missions/auv_1/words.csv").write_text("time_s,b1x_nT\n1,two\n")
    (folder / "missions/auv_1/empty.mcap").write_bytes(b"")
    out = " ".join(run("missions/auv_1/*", code=1).stdout.split())
    assert "three.csv: failed; read:" in out and "has 3 sensors, not 2" in out
    assert "words.csv: failed; read:" in out and "empty.mcap: failed; read:" in out
    told = json.loads((folder / "out/summary.json").read_text())["platforms"][0]
    assert (told["recordings"], told["done"], told["failed"]) == (5, 2, 3)


WITH_STAND_INS = """
import pickle
from importlib import import_module
from pathlib import Path

with Path("gap.pickle").open("rb") as file:
    gap = pickle.load(file)
import_module("tam_calibration.fleet.task").diagnose = lambda recording, array: gap

if __name__ == "__main__":
    from matplotlib.figure import Figure

    from tam_calibration.__main__ import run

    import_module("tam_calibration.fleet.summary").plot_missions = lambda missions, group: Figure()
    run()
"""
"""The command with what the fixture asked has: its processes load this file too."""


def start(folder):
    """Start the command on two processes, which share its output with it."""
    command = [sys.executable, "with_stand_ins.py", "batch", "missions/**", "--array", "array.yaml", "-o", "out"]
    return subprocess.Popen([*command, "--jobs", "2"], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


def paths(out):
    """Return the paths of all that is below a folder while others write there."""
    return {os.path.join(place, name) for place, folders, files in os.walk(out) for name in (*folders, *files)}


def has_ended(child):
    """Wait a moment for a process to end, so that looking does not take the core that it works on."""
    try:
        child.wait(MOMENT_S)
    except subprocess.TimeoutExpired:
        return False
    return True


def kill_after(folder, steps):
    """Kill the command when so many files and folders have appeared; return whether it was still at work."""
    child, seen = start(folder), paths(folder / "out")
    before = len(seen)
    while len(seen) < before + steps and not has_ended(child):
        seen |= paths(folder / "out")
    child.send_signal(signal.SIGKILL)
    child.communicate(timeout=PATIENCE_S)  # ends when its processes have ended too: they hold the same pipe
    return child.returncode == -signal.SIGKILL


def finish(folder):
    """Run the command to its end."""
    child = start(folder)
    output, _ = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 1, output  # the damaged bag


def content(folder):
    """Return the bytes of all files of the results."""
    return {path.relative_to(folder): path.read_bytes() for path in (folder / "out").rglob("*") if path.is_file()}


def done(folder):
    """Return the files of the recordings that were done, with what a file that is written again does not keep."""
    finished = [path.parent for path in folder.glob("out/recordings/*/*/result.json")]
    kept = [each for each in finished if (result := read_result(each)) and result.status == "done"]
    return {path: (path.stat().st_ino, path.stat().st_mtime_ns) for each in kept for path in each.iterdir()}


def test_killed_at_random_moments_it_gives_the_same(folder, gap):
    """With SIGKILL, resumed each time: the same bytes, nothing lost, nothing twice, no process left behind."""
    rng = np.random.default_rng(2026)
    shutil.rmtree(folder / "missions/auv_2/dive_3")
    (folder / "with_stand_ins.py").write_text(WITH_STAND_INS)
    (folder / "gap.pickle").write_bytes(pickle.dumps(gap))
    finish(folder)
    expected = content(folder)
    (folder / "out").rename(folder / "uninterrupted")
    kills, before = 0, {}
    while kills < KILLS:
        if not kill_after(folder, int(rng.integers(1, 12))):
            assert content(folder) == expected
            (folder / "out").rename(folder / f"finished_{kills}")
            before = {}
            continue
        kills += 1
        after = done(folder)
        assert before.items() <= after.items()
        before = after
    finish(folder)
    assert before.items() <= done(folder).items()
    assert content(folder) == expected


def test_names_of_recordings_send_no_command_to_the_terminal(folder, asked):
    """Neither in the tables, nor in what is open, nor in the summaries for spreadsheets and programs."""
    platform = folder / "missions" / "auv\x1b[2J"
    platform.mkdir()
    (platform / HOSTILE).write_text("time_s\n")
    result = run(str(platform / HOSTILE), code=1)
    summaries = [(folder / "out" / name).read_text() for name in ("summary.csv", "summary.json")]
    for text in (result.output, *summaries):
        assert "\x1b" not in text and "\u202e" not in text
    assert "auv\\u001b[2J/dive\\u001b[31m\\u202e.csv: failed" in " ".join(result.output.split())
