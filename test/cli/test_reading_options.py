"""How a recording is read, as commands are asked: map, part, overflows and base station."""

import json
import shlex
from datetime import UTC, datetime, timedelta
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from commands import tam as run
from inspected import START_NS, fields, numbers, turned, write_bag, write_text
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration import calibrate
from tam_calibration.fleet.task import process
from tam_calibration.recordings import read_array, read_recording
from tam_calibration.results import read_calibration

COUNT, PERIOD_S = 1200, 0.05
START = datetime.fromtimestamp(START_NS // 10**9, UTC)
AXES = [f"{letter}{sensor}" for sensor in "pqrs" for letter in "uvw"]
PART = ["--from", "5", "--until", (START + timedelta(seconds=50)).isoformat()]
"""901 of the samples, from 5 to 50 s."""


def text(path, columns, **more):
    """Write a text with dates and times."""
    stamps = [(START + timedelta(seconds=PERIOD_S * index)).isoformat() for index in range(COUNT)]
    return write_text(path, {"when": stamps, **columns, **more}, ";")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder with a run of strange names, whose sensor 2 is a counter of 16 bits, and what it needs."""
    folder = tmp_path_factory.mktemp("strange")
    readings = np.stack([turned(48_000, COUNT, sensor) for sensor in range(4)], axis=1)
    readings[:, 1] = np.round(readings[:, 1])
    shown = readings.copy()
    shown[:, 1] = (readings[:, 1] + 2**15) % 2**16 - 2**15
    columns = dict(zip(AXES, np.round(shown.reshape(COUNT, 12), 2).T, strict=True))
    sound = dict(zip(AXES, np.round(readings.reshape(COUNT, 12), 2).T, strict=True))
    text(folder / "run.csv", columns, proton=np.full(COUNT, 48_000.0))
    text(folder / "sound.csv", sound, proton=np.full(COUNT, 48_000.0))
    text(folder / "bare.csv", sound)
    picks = "\n".join(f"  - {{columns: [u{sensor}, v{sensor}, w{sensor}], unit: nT}}" for sensor in "pqrs")
    (folder / "bare.yaml").write_text(f"sensors:\n{picks}\n")
    (folder / "map.yaml").write_text(f"sensors:\n{picks}\nscalar: {{column: proton, unit: nT}}\n")
    (folder / "array.yaml").write_text("{baseline_m: 0.5, vector_noise_nT: 5.0, scalar_noise_nT: 0.5}\n")
    return folder


MAPPED = ["--map", "map.yaml", "--unwrap"]


def expected(**more):
    """Return what is to be read of the run."""
    return read_recording("run.csv", map="map.yaml", unwrap=True, **more)


def test_python_reads_what_the_commands_read(folder):
    """All options of `read_recording` together: the truth of the part."""
    whole = read_recording("sound.csv", map="map.yaml")
    part = expected(start=PART[1], until=PART[3])
    assert_array_equal(part.readings_T, whole.readings_T[100:1001])
    assert part.sample_count == 901 and part.scalar_count == 901


def test_calibrate(folder):
    """The file is that of the part as it is read from Python."""
    told = run("calibrate", "run.csv", "--array", "array.yaml", *MAPPED, *PART, "-o", "c.yaml").output
    assert "; 901 samples; " in told and "taken by the map as sensor 1: " in told
    fit = calibrate(expected(start=PART[1], until=PART[3]), read_array(Path("array.yaml")))
    assert_allclose(read_calibration("c.yaml").errors.bias_T, fit.errors.bias_T, atol=1e-12)
    assert_allclose(fit.errors.bias_T, 48e-6 * 0.02 * np.arange(1, 5)[:, None] * np.ones(3), atol=5e-9)


def test_correct(folder):
    """Results of the part alone, in a text and, of a bag, in a bag beside its topics."""
    run("calibrate", "run.csv", "--array", "array.yaml", *MAPPED, "-o", "c.yaml")
    run("correct", "run.csv", "--calibration", "c.yaml", *MAPPED, *PART, "-o", "out.csv")
    table = np.loadtxt("out.csv", delimiter=",", skiprows=1)
    assert len(table) == 901
    assert_allclose(np.linalg.norm(table[:, 1:4], axis=1), 48_000, atol=15)
    recording = read_recording("sound.csv", map="map.yaml")
    stamps = START_NS + 50_000_000 * np.arange(COUNT)
    topics = {f"/adc/{sensor}": (fields(recording.readings_T[:, sensor], stamps), stamps) for sensor in range(4)}
    write_bag(folder / "bag", {**topics, "/proton": (numbers(np.full(COUNT, 48e3)), stamps)})
    run("correct", "bag", "--calibration", "c.yaml", *PART, "-o", "out")
    again = run("inspect", "out").output
    assert "/field_gradient" in again and "/adc/0" in again
    run("correct", "bag", "--calibration", "c.yaml", *PART, "-o", "again.csv")
    assert_allclose(np.loadtxt("again.csv", delimiter=",", skiprows=1)[:, 1:], table[:, 1:], atol=1)


def test_diagnose(folder, monkeypatch, gap):
    """What is diagnosed is the part."""
    asked = []
    module = import_module("tam_calibration.cli.diagnose")
    monkeypatch.setattr(module, "diagnose", lambda recording, array, **how: asked.append(recording) or gap)
    run("diagnose", "run.csv", "--array", "array.yaml", *MAPPED, *PART)
    assert_array_equal(asked[0].readings_T, expected(start=PART[1], until=PART[3]).readings_T)


def test_compare(folder, monkeypatch, comparison):
    """Either side has its own map; the part is that of the recording."""
    asked = []
    module = import_module("tam_calibration.cli.compare")
    monkeypatch.setattr(module, "compare", lambda *sides, **how: asked.extend(sides[:2]) or comparison)
    simulated = read_recording("sound.csv", map="map.yaml")
    names = [f"sim {axis}" for axis in AXES]
    columns = dict(zip(names, simulated.readings_T.reshape(COUNT, 12).T.tolist(), strict=True))
    write_text(Path("sim.csv"), {"time_s": simulated.time_s.tolist(), **columns})
    picks = [{"columns": names[first : first + 3], "unit": "T"} for first in range(0, 12, 3)]
    Path("sim.yaml").write_text(json.dumps({"sensors": picks}))
    maps = ["--map-of-simulation", "sim.yaml", *MAPPED, *PART]
    run("compare", "sim.csv", "run.csv", "--array", "array.yaml", *maps, code=1)
    assert [each.sample_count for each in asked] == [COUNT, 901]
    assert_array_equal(asked[0].readings_T, simulated.readings_T)
    told = run("compare", "sim.csv", "run.csv", "--array", "array.yaml", *maps, "--json", "sim.yaml", code=2).output
    assert "sim.yaml" in told and "sensors" in Path("sim.yaml").read_text()


def test_batch(folder, monkeypatch, gap):
    """Each recording of a campaign is read so, and corrected so."""

    def run_here(tasks, jobs):
        for task in tasks:
            process(task)
            yield task, ""

    monkeypatch.setattr(import_module("tam_calibration.fleet.batch"), "run_here", run_here)
    monkeypatch.setattr(import_module("tam_calibration.fleet.task"), "diagnose", lambda recording, array: gap)
    monkeypatch.setattr(
        import_module("tam_calibration.fleet.summary"), "plot_missions", lambda missions, group: Figure()
    )
    run("batch", "run.csv", "--array", "array.yaml", "--out", "out", *MAPPED, *PART)
    (corrected,) = Path("out").rglob("corrected.csv")
    assert len(corrected.read_text().splitlines()) == 902
    summary = json.loads(Path("out/summary.json").read_text())
    assert summary["platforms"][0]["done"] == 1


def test_a_base_station_gives_the_scale(folder):
    """Of a run without scalar; without it the scale is unknown."""
    stamps = [(START + timedelta(seconds=second)).strftime("%Y-%m-%d %H:%M:%S.000 %j") for second in range(-60, 120, 5)]
    rows = [f"{stamp}  99999.00  99999.00  99999.00  48000.00" for stamp in stamps]
    head = [
        " Format                 IAGA-2002                                    |",
        " IAGA CODE              TST                                          |",
        "DATE       TIME         DOY     TSTX      TSTY      TSTZ      TSTF   |",
    ]
    Path("tst.sec").write_text("\n".join([*head, *rows]) + "\n")
    asked = ["calibrate", "bare.csv", "--array", "array.yaml", "--map", "bare.yaml", "-o", "c.yaml"]
    assert "fitted, on an unknown scale" in run(*asked).output
    told = run(*asked, "--base-station", "tst.sec").output
    assert "Field: 48\u202f000.0 nT, from the scalar reference" in told
    refused = run(*asked[:-1], "tst.sec", "--base-station", "tst.sec", code=2).output
    assert "would be overwritten" in refused and "IAGA" in Path("tst.sec").read_text()


COMMANDS = {
    "calibrate": ["run.csv", "--array", "array.yaml", "-o", "c.yaml"],
    "correct": ["run.csv", "--calibration", "known.yaml", "-o", "out.csv"],
    "diagnose": ["run.csv", "--array", "array.yaml"],
    "compare": ["run.csv", "run.csv", "--array", "array.yaml"],
    "batch": ["run.csv", "--array", "array.yaml", "--out", "out"],
}


def test_the_next_command_reads_what_this_one_read(folder, monkeypatch, gap):
    """It repeats the options as a shell takes them; those of the part only where it concerns the same part."""
    Path("run.csv").rename("first run.csv")
    Path("map.yaml").rename("a map.yaml")
    monkeypatch.setattr(import_module("tam_calibration.cli.diagnose"), "diagnose", lambda *sides, **how: gap)
    asked = ["first run.csv", "--array", "array.yaml", "--map", "a map.yaml", "--unwrap", "--tolerance-s", "0.01"]
    how = "--map 'a map.yaml' --unwrap --tolerance-s 0.01"
    first, second = (
        run(name, *asked, *PART, *output).output.splitlines()[-1]
        for name, output in (("diagnose", []), ("calibrate", ["-o", "c.yaml"]))
    )
    assert second == f"next: tam correct 'first run.csv' --calibration c.yaml -o corrected.csv {how}"
    run(*shlex.split(second)[2:])
    pairs = set(pairwise(shlex.split(first)))
    assert pairs >= {("tam", "calibrate"), ("-o", "calibration.yaml"), ("--map", "a map.yaml"), *pairwise(PART)}
    assert "--unwrap" in first


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--map", "none.yaml"], "none.yaml"),
        (["--map", "array.yaml"], "array.yaml: "),
        (["--from", "noon"], "'noon' is no time: give seconds from the start"),
        (["--until", "-3"], "no time in a recording"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(folder, command, options, words):
    """Whatever the command; nothing is written."""
    before = sorted(folder.rglob("*"))
    told = run(command, *COMMANDS[command], *options, code=2).output
    assert words in told and "Traceback" not in told and told.splitlines()[-1].startswith("tam: ")
    assert sorted(folder.rglob("*")) == before


def test_an_overflow_is_named(folder):
    """And how it is read."""
    told = run("calibrate", "run.csv", "--array", "array.yaml", "--map", "map.yaml", "-o", "c.yaml", code=2).stderr
    assert "sensor 2 axis x jumps" in told and "its counter of 16 bits overflows; read it with --unwrap" in told


def test_no_input_is_overwritten(folder):
    """The map is one."""
    told = run("calibrate", "run.csv", "--array", "array.yaml", *MAPPED, "-o", "map.yaml", code=2).output
    assert "would be overwritten" in told and "proton" in Path("map.yaml").read_text()
