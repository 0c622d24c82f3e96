"""`tam compare`: mistakes and verdict for people and programs, told by the exit code too."""

import json
from dataclasses import replace
from functools import partial
from importlib import import_module

import pytest
from commands import tam

from tam_calibration.recordings import read_recording, write_array
from tam_calibration.report import page
from tam_calibration.results import write_recording
from tam_calibration.results.comparison_json import read_mend


@pytest.fixture(scope="module")
def files(tmp_path_factory, recording, cross):
    """Return a folder with a simulation and a recording, as CSV and as a bag, and the array file."""
    folder = tmp_path_factory.mktemp("compare")
    for name in ("sim.csv", "real.csv", "real"):
        write_recording(folder / name, recording)
    write_array(folder / "array.yaml", cross)
    return folder


@pytest.fixture
def asked(monkeypatch, comparison):
    """Put a stand-in in the place of the comparison; return what it was asked, and what it shall answer."""
    asked = {"answer": comparison}

    def compare(simulation, recording, array, *, array_of_simulation=None, progress=None, seed=0):
        asked.update(sides=(simulation, recording), array=array, array_of_simulation=array_of_simulation)
        progress("judging", 0.5)
        return asked["answer"]

    monkeypatch.setattr(import_module("tam_calibration.cli.compare"), "compare", compare)
    return asked


run = partial(tam, "compare", "--array", "array.yaml")


@pytest.mark.parametrize("name", ["real.csv", "real"])
def test_people_see_what_differs_and_what_to_do(folder, asked, name):
    """The verdict, what is missing, surplus and otherwise, noise, gap before and after, source errors, what next."""
    out = run("sim.csv", name, "--verbose", code=1).stdout
    assert out.startswith("Different: The simulation lacks")
    assert "The recording: its noise is twice what its array states.\n" in out
    for words in (
        "temperature drift",
        "could not show it",
        "Temperature drift of sensor 2:",
        "1.000 ± 0.020",
        "The noise of 1 of 13 axes differs.",
        "band 10 to 14 Hz",
        "in noise floors",
        "99 % of the gap's energy is closed",
        "0.0800 to 0.120",
        "What stays open: A tenth of the drift of sensor 2 stays.",
        "next: Write the mend into the simulator",
    ):
        assert words in out, words
    assert [side.sample_count for side in asked["sides"]] == [600, 600]


def test_the_first_line_is_the_answer(folder, asked):
    """A summary of few lines follows, which ends with what to do."""
    first, *others = run("sim.csv", "real.csv", code=1).stdout.splitlines()
    assert first.startswith("Different: The simulation lacks")
    assert len(others) < 20 and others[-1].startswith("next: Write the mend into the simulator")
    assert run("sim.csv", "real.csv", "-q", code=1).stdout == f"{first}\n"


def test_mistakes_come_first(folder, asked, mistaken):
    """In words, with the mend, in the first line; nothing else was compared, and no mend is written."""
    asked["answer"] = mistaken
    (folder / "mend.yaml").write_text("of before\n")
    result = run("sim.csv", "real.csv", "--mend", "mend.yaml", "--json", "compare.json", code=1)
    first, *others = result.stdout.splitlines()
    assert first.startswith("Different: ") and "The simulation's field is 10⁴ times" in first
    assert "Mend: Divide the readings by 10 000." in first and others[-2].startswith("next: Mend that in the simulator")
    assert others[-3] == "written: compare.json"
    assert others[-1] == "not written: mend.yaml, as nothing was compared"
    assert (folder / "mend.yaml").read_text() == "of before\n"
    assert json.loads((folder / "compare.json").read_text())["mend"] is None


@pytest.mark.parametrize(("verdict", "code"), [("same", 0), ("differs", 1), ("not_identifiable", 1)])
def test_the_exit_code_tells_whether_they_are_the_same(folder, asked, comparison, verdict, code):
    """What differs, and what cannot be told, is exit 1; the files are written all the same."""
    asked["answer"] = replace(comparison, verdict=verdict)
    told = run("sim.csv", "real.csv", "--json", "compare.json", code=code).stdout
    assert ("next: " in told) == (verdict != "same")
    assert json.loads((folder / "compare.json").read_text())["verdict"] == verdict


def test_programs_get_json(folder, asked):
    """JSON goes to a file beside the tables, or alone to stdout, and names both recordings."""
    assert run("sim.csv", "real.csv", "--json", "compare.json", code=1).stdout.count("written: compare.json\n") == 1
    alone = json.loads(run("sim.csv", "real.csv", "--json", "-", code=1).stdout)
    assert json.loads((folder / "compare.json").read_text()) == alone
    assert alone["schema"] == "tam_calibration/compare/1"
    assert (alone["simulation"]["name"], alone["recording"]["name"]) == ("sim.csv", "real.csv")


def test_a_page_and_the_mend_are_written(folder, asked, monkeypatch):
    """Each in a file of its own."""
    picture = page.Image("data:image/svg+xml;base64,", "no picture", "")
    monkeypatch.setattr("tam_calibration.report.comparison_report.embed", lambda *words: picture)
    out = run("sim.csv", "real.csv", "--report", "page.html", "--mend", "mend.yaml", code=1).stdout
    assert "written: page.html" in out and "written: mend.yaml" in out
    assert (folder / "page.html").read_text().startswith("<!DOCTYPE html>")
    assert read_mend("mend.yaml").rate_hz == 100.0


def test_the_simulation_may_have_an_array_of_its_own(folder, asked, cross):
    """Else it has that of the recording."""
    write_array("other.yaml", replace(cross, positions_m=2 * cross.positions_m))
    run("sim.csv", "real.csv", code=1)
    assert asked["array_of_simulation"] is asked["array"]
    run("sim.csv", "real.csv", "--array-of-simulation", "other.yaml", code=1)
    assert asked["array"].positions_m[0, 0] == 0.25 and asked["array_of_simulation"].positions_m[0, 0] == 0.5


def test_a_recording_may_be_compared_with_itself(folder, asked):
    """It is no bad input."""
    run("real.csv", "real.csv", code=1)


@pytest.mark.parametrize(
    ("one", "other", "words"),
    [
        ("no.csv", "real.csv", "the simulation: there is no file or bag no.csv"),
        ("sim.csv", "no.csv", "no.csv"),
        ("sim.csv", "short.csv", "the recording: short.csv"),
        ("short.csv", "real", "the simulation: short.csv"),
        ("three.csv", "real", "the simulation: three.csv: the recording has 3 sensors, not 4"),
        ("sim.csv", "three.csv", "the recording: three.csv: the recording has 3 sensors, not 4"),
        ("array.yaml", "real.csv", "the simulation: array.yaml"),
        ("bag", "real.csv", "the simulation: bag"),
    ],
)
def test_bad_input_is_one_sentence_that_names_the_side(folder, asked, one, other, words):
    """A file that is not there, is empty, is none, has fewer sensors or no topics: exit 2, and no output is left."""
    (folder / "short.csv").write_text("time_s,b1x_nT\n")
    (folder / "bag").mkdir()
    whole = read_recording("real.csv")
    write_recording("three.csv", replace(whole, readings_T=whole.readings_T[:, :3]))
    stderr = run(one, other, "--json", "compare.json", code=2).stderr
    assert words in stderr and len(stderr.splitlines()) == 1
    assert not (folder / "compare.json").exists()
