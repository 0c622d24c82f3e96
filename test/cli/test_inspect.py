"""`tam inspect`: what it prints and writes, and how it ends."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from commands import tam as run
from inspected import columns_of, fields, numbers, times, turned, write_bag, write_text

from tam_calibration import inspect
from tam_calibration.recordings.channel_map import map_to_mapping


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Give a working folder with a bag of strange names, a text without names, an array, and a file of no numbers."""
    monkeypatch.chdir(tmp_path)
    stamps_ns = times()
    topics = {
        f"/sensor_{name}/b_field": (fields(turned(sensor=n), stamps_ns), stamps_ns) for n, name in enumerate("ab")
    }
    write_bag(Path("bag"), {**topics, "/overhauser": (numbers(48_000 + np.arange(400) % 3), stamps_ns)})
    readings = columns_of("1", turned(48_000)) | columns_of("2", turned(48_000, sensor=1))
    write_text(Path("unnamed.csv"), {"time_s": stamps_ns / 1e9, **readings})
    table = Path("unnamed.csv").read_text()
    Path("unnamed.csv").write_text(table.partition("\n")[2])
    Path("array.yaml").write_text("positions_m: [[0.25, 0, 0], [-0.25, 0, 0]]\nvector_noise_nT: 5\n")
    Path("letter.txt").write_text("Dear reader,\nthere are no numbers here.\n")
    return tmp_path


def test_a_bag_of_strange_names_is_shown_and_calibrated(folder):
    """Two commands, without renaming anything: the map that one writes is read by the other."""
    told = run("inspect", "bag", "--array", "array.yaml", "--write-map", "map.yaml").stdout
    for words in (
        "bag: bag, 19.95 s",
        r"/sensor_b/b_field +│ MagneticField +│ +400 │ +20.0 │ header stamps",
        r"  magnetic_field .* T +│ sensor 2",
        r"  data .* nT \(detected\) │ scalar",
        "sensor 1: /sensor_a/b_field, magnetic_field, by type MagneticField; field ",
        "written: map.yaml",
        "A choice can be made.",
        "next: tam calibrate bag --array array.yaml -o calibration.yaml --map map.yaml",
    ):
        assert re.search(words, told), (words, told)
    run("calibrate", "bag", "--array", "array.yaml", "--map", "map.yaml", "-o", "c.yaml", "--accept", "residual")


def test_json_holds_everything(folder):
    """Of the file or on stdout: tables, channels with units in the keys, what is odd, and the choice with its map."""
    run("inspect", "bag", "--json", "found.json")
    content = json.loads(Path("found.json").read_text())
    assert content == json.loads(run("inspect", "bag", "--json", "-").stdout)
    found = inspect("bag")
    assert content["duration_s"] == found.duration_s and content["schema"] == "tam_calibration/inspection/1"
    assert content["is_certain"] and content["channel_map"] == map_to_mapping(found.channel_map)
    assert content["reasons"] == list(found.reasons)
    assert [table["name"] for table in content["tables"]] == ["/overhauser", "/sensor_a/b_field", "/sensor_b/b_field"]
    (channel,) = content["tables"][1]["channels"]
    assert channel["taken_as"] == "sensor 1" and channel["unit"] == channel["stated_unit"] == "T"
    assert channel["size_nT"] == pytest.approx(48_000, rel=0.01)
    assert channel["low_nT"] == pytest.approx([1e9 * value for value in channel["low"]])


def test_what_is_not_certain_exits_1(folder):
    """It says what to add, writes the best guess, and with that added a choice can be made."""
    told = run("inspect", "unnamed.csv", "--write-map", "map.yaml", code=1).stdout
    assert "To settle in a map:" in told and "name the sensors in a map, or give --array" in told
    assert "# To settle: no name or type says" in Path("map.yaml").read_text()
    run("inspect", "unnamed.csv", "--array", "array.yaml")


@pytest.mark.parametrize("name", ["letter.txt", "absent.csv", "."])
def test_what_is_no_recording_exits_2(folder, name):
    """One sentence that names it, and nothing is written."""
    told = run("inspect", name, "--write-map", "map.yaml", "--json", "found.json", code=2).output
    assert told.count("\n") == 1 and name in told
    assert not Path("map.yaml").exists() and not Path("found.json").exists()


def test_the_page_shows_every_channel(folder):
    """It is complete in itself, with a picture of each topic, what is odd, and the map."""
    run("inspect", "bag", "--report", "page.html")
    page = Path("page.html").read_text()
    assert page.count('<img src="data:image/svg+xml;base64,') == 3
    assert "/sensor_b/b_field over time" in page and "topic: /sensor_b/b_field" in page
    assert "http" not in re.sub(r"http://www\.w3\.org\S*", "", page)


def test_the_page_of_rubbish_is_drawn(folder):
    """Sentinels, NaN, and a column without a number give a page, and no warning."""
    readings = turned(48_000)
    readings[3], readings[9] = 1e300, np.nan
    write_text(Path("bad.csv"), {"time_s": times() / 1e9, **columns_of("mag_", readings), "empty": ["nan"] * 400})
    run("inspect", "bad.csv", "--report", "page.html")
    assert "1 of 400 readings is a sentinel" in Path("page.html").read_text()
