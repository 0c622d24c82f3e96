"""`tam diagnose`: a verdict for people and programs, told by the exit code too."""

import json
from dataclasses import replace
from functools import partial
from importlib import import_module

import pytest
from commands import tam

from tam_calibration.effects.effect import Limit, Sized
from tam_calibration.fit import calibrate
from tam_calibration.gap.checks import checks_of
from tam_calibration.results import write_calibration, write_recording


@pytest.fixture
def asked(monkeypatch, gap):
    """Put a stand-in in the place of the diagnosis; return what it was asked, and what it shall answer."""
    asked = {"answer": gap}

    def diagnose(recording, array, *, without=(), progress=None, accept=()):
        asked.update(recording=recording, array=array, without=without)
        progress("searching", 0.5)
        return asked["answer"]

    monkeypatch.setattr(import_module("tam_calibration.cli.diagnose"), "diagnose", diagnose)
    return asked


run = partial(tam, "diagnose", "--array", "array.yaml")


@pytest.mark.parametrize("name", ["run.csv", "run"])
def test_people_see_the_verdict_and_what_it_rests_on(folder, asked, name):
    """Verdict, size before and after, where, causes with parameters ± errors, every hypothesis, next recording."""
    out = run(name, "-v").stdout
    assert out.startswith("Explained: The readings of sensor 2 drift")
    for words in ("1.90", "0.0800", "5.40", "Where: sensor 2; at 0 to 0.500 Hz", "99.8 %", "98 %", "bias_jump"):
        assert words in out
    for words in ("sensor 2 x offset", "1.000 ± 0.020", "nT/°C", "time constant", "60.0 ± 5.0"):
        assert words in out
    for words in (
        "hysteresis: not supported, explains 2 %",
        "flexure: channel missing, needs",
        "Next recording: Record",
    ):
        assert words in out
    assert asked["recording"].sample_count == 600 and asked["array"].sensor_count == 4


def test_the_first_line_is_the_answer(folder, asked):
    """By default a line for each cause follows, and the command that takes them off."""
    first, *others = run("run.csv").stdout.splitlines()
    assert first == "Explained: The readings of sensor 2 drift with its temperature, which explains the gap."
    assert len(others) < 20 and others[-1].endswith("--effects temperature_drift -o calibration.yaml")
    assert "temperature_drift: sensor 2; probability 98 %, explains 97 % out of sample" in others[1]
    assert run("run.csv", "-q").stdout == f"{first}\n"


def test_people_see_what_is_left_and_what_it_means(folder, asked, gap):
    """A drift, sizes, the unknown part, the set that holds the truth, and what departs from the twin."""
    residue = gap.residue
    cause = replace(
        gap.causes[0],
        is_drift=True,
        sizes=(Sized("offset", 2e-9, Limit(1e-6, "a book", "T")),),
    )
    checks = checks_of(residue.time_s, residue.direction, residue.before, residue.floor_T)
    asked["answer"] = replace(gap, causes=(cause,), checks=checks, remainder="It drifts.", set_95=("unknown",))
    out = run("run.csv", "-v").stdout
    for words in (
        "  The channel hardly does more than rise or fall",
        "  Its offset is 2.00 nT; the largest known is 1000 nT (a book).",
        "What no cause explains: It drifts.",
        "the truth is among: unknown.",
        "What remains with the causes, and the simulated twin does not have:",
        f"  {checks.sentences[0]}",
    ):
        assert words in out
    asked["answer"] = replace(gap, verdict="no_gap", causes=(), checks=checks, smallest_gap=0.1, channel_count=1e4)
    out = run("run.csv", "-v").stdout
    assert "A gap of less than 0.10 noise floors" in out and "What the simulated twin does not have:" in out


def test_programs_get_json(folder, asked):
    """JSON goes to a file beside the tables, or alone to stdout, and names the recording."""
    out = run("run.csv", "--json", "gap.json").stdout
    assert "written: gap.json\n" in out
    alone = json.loads(run("run.csv", "--json", "-").stdout)
    assert json.loads((folder / "gap.json").read_text()) == alone
    assert alone["schema"] == "tam_calibration/gap/1"
    assert alone["recording"]["name"] == "run.csv"


@pytest.mark.parametrize(
    ("verdict", "code"),
    [("no_gap", 0), ("explained", 0), ("partly_explained", 1), ("unexplained", 1), ("not_identifiable", 1)],
)
def test_the_exit_code_tells_whether_something_is_open(folder, asked, gap, verdict, code):
    """What stays unexplained, even in part, is exit 1; the files are written all the same."""
    asked["answer"] = replace(gap, verdict=verdict, causes=gap.causes if "explained" in verdict else ())
    assert run("run.csv", "--json", "gap.json", code=code).stdout.startswith(verdict.replace("_", " ").capitalize())
    assert json.loads((folder / "gap.json").read_text())["verdict"] == verdict


def test_a_report_is_written(folder, asked, undrawn):
    """The page is HTML of its own."""
    assert "written: page.html" in run("run.csv", "--report", "page.html").stdout
    assert (folder / "page.html").read_text().startswith("<!DOCTYPE html>")


def test_effects_are_left_out(folder, asked):
    """Effects of the library can be withheld; others are bad input."""
    run("run.csv", "--without", "hysteresis", "--without", "flexure")
    assert set(asked["without"]) == {"hysteresis", "flexure"}
    assert "there is no effect 'magic'" in run("run.csv", "--without", "magic", code=2).stderr


def diagnosed(folder, recording, field="", options=(), code=0, scale=1.0):
    """Diagnose two seconds of so many times 50 µT without scalar; return the result of the command."""
    recording = recording.take(slice(0, 200))
    steady = scale * 50e-6 / recording.scalar_T[:, None, None] * recording.readings_T
    write_recording("other.csv", replace(recording, readings_T=steady, scalar_T=None))
    (folder / "array.yaml").write_text(f"baseline_m: 0.5\n{field}")
    return run("other.csv", "--json", "-", *options, code=code)


def test_a_laboratory_states_its_field(folder, recording):
    """In a coil of 500 µT, with bounds in the array file, there is a verdict and no refusal."""
    gap = json.loads(diagnosed(folder, recording, "intensity_nT: [400000, 600000]\n", scale=10.0).stdout)
    assert gap["verdict"] == "no_gap"
    assert not any("refuse" in remark for remark in gap["remarks"])


def test_a_field_that_no_laboratory_states_is_no_verdict(folder, recording):
    """In a shield of 2 µT nothing but bounds in the array file would tell it from a wrong unit."""
    gap = json.loads(diagnosed(folder, recording, code=1, scale=0.04).stdout)
    assert gap["verdict"] == "not_identifiable"
    assert "where the Earth's has 15 to 100" in gap["statement"]


def test_a_place_bounds_the_field(folder, recording):
    """At Boulder 50 µT are right; with 20 µT there is no verdict, and why and when is said."""
    gap = json.loads(diagnosed(folder, recording, options=("--place", "40.1,-105.2,2020-01-01")).stdout)
    assert gap["verdict"] == "no_gap"
    gap = json.loads(
        diagnosed(folder, recording, options=("--place", "40.1,-105.2,2020-01-01"), scale=0.4, code=1).stdout
    )
    assert gap["verdict"] == "not_identifiable" and "No verdict on the recording of" in gap["statement"]
    assert "outside the 34.63 to 77.91 µT of the place's field" in gap["remarks"][0]


def test_a_scalar_that_contradicts_the_place_or_the_file_is_bad_input(folder):
    """One sentence tells both; a place of the right field lets the scalar pass, which then tells the intensity."""
    run("run.csv", "--place", "40.1,-105.2,2020-01-01")
    stderr = run("run.csv", "--place", "-25,-55,2020-01-01", code=2).stderr
    assert "the scalar intensity is 50 µT, but the place's field has" in stderr and len(stderr.splitlines()) == 1
    (folder / "array.yaml").write_text("baseline_m: 0.5\nintensity_nT: [1500, 2500]\n")
    stderr = run("run.csv", code=2).stderr
    assert "the scalar intensity is 50 µT, but the array's field has 1.5 to 2.5 µT" in stderr


def test_a_calibration_of_another_array_is_bad_input(folder, recording, cross):
    """What it takes off would be that of other sensors."""
    write_calibration("other.yaml", calibrate(recording, replace(cross, positions_m=2 * cross.positions_m)))
    stderr = run("run.csv", "--calibration", "other.yaml", code=2).stderr
    assert "other.yaml is the calibration of another array" in stderr and len(stderr.splitlines()) == 1


def test_place_and_file_do_not_both_tell_the_field(folder, asked):
    """Neither is preferred: the sentence names both."""
    (folder / "array.yaml").write_text("baseline_m: 0.5\nintensity_nT: [1500, 2500]\n")
    stderr = run("run.csv", "--place", "40.1,-105.2,2020-01-01", code=2).stderr
    assert "--place and intensity_nT in array.yaml both tell the field: leave one of them out" in stderr
