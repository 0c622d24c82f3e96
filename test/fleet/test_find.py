"""Patterns find recordings of every format, each once."""

import pytest

from tam_calibration.exceptions import InputError
from tam_calibration.fleet.find import find_recordings

ALL = ["auv_1/dive_0.csv", "auv_1/dive_1.mcap", "auv_2/damaged.mcap", "auv_2/dive_2", "auv_2/dive_3"]


def names(folder, *patterns):
    """Return what patterns find, below the missions."""
    found = find_recordings(patterns, folder / "out")
    return [str(path.relative_to(folder / "missions")) for path in found]


@pytest.mark.parametrize("patterns", [["missions/**"], ["missions/*/*"], ["missions/auv_1/*", "missions/auv_[23]/*"]])
def test_every_format_is_found(folder, patterns):
    """CSV files, single files and folders of bags; neither the array file nor what lies within a bag."""
    (folder / "missions/array.yaml").write_text("baseline_m: 0.5\n")
    assert names(folder, *patterns) == ALL


def test_a_part_of_a_bag_stands_for_the_bag(folder):
    """The files of a split bag are one recording; a table that lies beside them is one of its own."""
    bag = folder / "missions/auv_2/dive_3"
    (bag / "dive_3_1.mcap").write_bytes(b"")
    assert names(folder, "missions/**/*.mcap") == ["auv_1/dive_1.mcap", "auv_2/damaged.mcap", "auv_2/dive_3"]
    (bag / "exported.csv").write_text("time_s\n")
    assert "auv_2/dive_3/exported.csv" in names(folder, "missions/**/*.csv")


def test_each_is_found_once_however_often_it_is_named(folder):
    """Patterns may overlap, and paths may lead through links or be relative."""
    (folder / "link").symlink_to(folder / "missions/auv_1")
    assert names(folder, "missions/**", "link/*", "missions/auv_1/../auv_1/dive_0.csv") == ALL


def test_results_are_no_recordings(folder):
    """What a batch has written is not taken for a mission, where it lies among them."""
    (folder / "missions/auv_1/dive_0.csv").rename(folder / "missions/auv_1/kept.csv")
    (folder / "missions/out/recordings").mkdir(parents=True)
    (folder / "missions/out/recordings/corrected.csv").write_text("time_s\n")
    found = find_recordings(["missions/**/*.csv"], folder / "missions/out")
    assert [path.name for path in found] == ["kept.csv"]


def test_a_name_is_taken_as_it_is(folder):
    """A file whose name has no known ending, or has brackets, can be named."""
    for name in ("run", "run[1].csv"):
        (folder / "missions/auv_1" / name).write_text("time_s\n")
    assert names(folder, "missions/auv_1/run") == ["auv_1/run"]
    assert names(folder, "missions/auv_1/run[1].csv") == ["auv_1/run[1].csv"]


@pytest.mark.parametrize("pattern", ["missions/**/*.bag", "missions/none.csv", "out/*"])
def test_a_pattern_that_finds_nothing_is_named(folder, pattern):
    """Each pattern must find something, so that a slip of the pen is not overlooked."""
    with pytest.raises(InputError, match=r"no recording is found by .*with quotes"):
        names(folder, "missions/**", pattern)
