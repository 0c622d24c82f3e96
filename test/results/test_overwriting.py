"""No output costs what is stored, by whatever path, link or case it is named."""

import os
import shutil
from pathlib import Path

import pytest

from tam_calibration.model.exceptions import InputError
from tam_calibration.results import write_recording
from tam_calibration.results.overwriting import require_outside_bags, require_separate


@pytest.fixture
def folder(tmp_path, monkeypatch, recording):
    """Give a working folder with an input, links to it, two bags and a folder that leads into one."""
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("time_s\n")
    Path("sub").mkdir()
    Path("soft.csv").symlink_to("run.csv")
    Path("twice.csv").symlink_to("soft.csv")
    os.link("run.csv", "hard.csv")
    write_recording("bag", recording.take(slice(4)))
    write_recording("alone.mcap", recording.take(slice(4)))
    Path("into").symlink_to("bag")
    Path("bag/leads_out.yaml").symlink_to("../new.yaml")
    Path("leads_in.yaml").symlink_to("bag/new.yaml")
    return tmp_path


@pytest.mark.parametrize(
    "output",
    ["run.csv", "sub/../run.csv", "soft.csv", "twice.csv", "hard.csv", "RUN.csv", "sub/../Run.CSV"],
)
def test_an_input_is_known_by_every_name(folder, output):
    """Another path, links of both kinds, and another case, which on some disks is the same file."""
    for path in (Path("run.csv"), folder / "run.csv"):
        with pytest.raises(InputError, match="would be overwritten: choose another name"):
            require_separate([Path(output)], [path])


def test_a_link_that_is_read_is_not_replaced(folder):
    """Neither it, nor one on the way, nor what it leads to."""
    for output in ("twice.csv", "soft.csv", "run.csv"):
        with pytest.raises(InputError, match="would be overwritten"):
            require_separate([Path(output)], [Path("twice.csv")])


@pytest.mark.parametrize(
    "output",
    [
        "bag/metadata.yaml", "bag/bag.db3", "bag/new.yaml", "bag/deep/new.yaml", "bag/../bag/new.yaml",
        "into/new.yaml", "bag/leads_out.yaml", "leads_in.yaml",
    ],
)  # fmt: skip
@pytest.mark.parametrize("inputs", [[], ["bag"], ["into"]])
def test_nothing_is_written_into_a_bag(folder, output, inputs):
    """Whether it is read or not."""
    with pytest.raises(InputError, match=r"lies inside the bag .*: choose a place outside it"):
        require_separate([Path(output)], list(map(Path, inputs)))


def test_nothing_is_written_into_a_folder_that_is_read(folder):
    """A recorder that was killed leaves a bag without metadata.yaml."""
    Path("bag/metadata.yaml").unlink()
    require_outside_bags(Path("bag/new.yaml"))
    with pytest.raises(InputError, match="lies inside bag, which is read"):
        require_separate([Path("into/new.yaml")], [Path("bag")])


def test_a_bag_that_exists_is_not_replaced(folder):
    """A single file is kept as a folder is, also under another name; what is none may be replaced."""
    Path("alone.mcap").rename("alone")
    Path("empty.db3").touch()
    for output in ("alone", "empty.db3"):
        with pytest.raises(InputError, match=f"{output} is a recording that exists already"):
            require_separate([Path(output)], [])
    require_separate([Path("run.csv"), Path("new.mcap")], [])


def test_a_recording_of_others_is_not_replaced(folder):
    """A table of readings stays; what this package wrote may be written anew, and so may a table of another kind."""
    readings = "time_s,b1x_nT,b1y_nT,b1z_nT\n0,1,2,3\n"
    for name, header in {"a.csv": readings, "b.csv": "x;y;z;t\n", "d.csv": "Time [s]\tx\ty\tz\n"}.items():
        Path(name).write_text(header)
        with pytest.raises(InputError, match=f"{name} is a recording that exists already: choose another name"):
            require_separate([Path(name)], [])
    Path("a.truth.yaml").touch()
    for name, header in {"b.csv": "time_s,bx_nT,by_nT,bz_nT\n", "d.csv": "number,x_m,y_m,z_m\n"}.items():
        Path(name).write_text(header)
    require_separate([Path("a.csv"), Path("b.csv"), Path("d.csv")], [])


def test_outputs_are_told_apart(folder):
    """Two of one name, or of names that are one on some disks."""
    require_separate([Path("a.yaml"), Path("b.yaml")], [])
    for other in ("a.yaml", "sub/../a.yaml", "A.yaml"):
        with pytest.raises(InputError, match="would be overwritten"):
            require_separate([Path("a.yaml"), Path(other)], [])


def test_a_folder_that_is_written_holds_no_input(folder):
    """What is written may stand beside an input, not around it."""
    require_separate([Path("sub/results")], [Path("sub/a.yaml")])
    with pytest.raises(InputError, match=r"run\.csv would be overwritten: it lies inside \., which is written"):
        require_separate([Path(".")], [Path("run.csv")])


def test_a_folder_of_data_is_no_bag(folder):
    """Many tools call a file metadata.yaml: only beside the data of a bag it is that of one."""
    Path("metadata.yaml").touch()
    require_outside_bags(Path("sub/new.yaml").resolve().parent.parent.parent / "beside.yaml")
    Path("alone.mcap").unlink()
    require_separate([Path("sub/new.yaml")], [Path("run.csv")])


def test_links_in_a_circle_are_names_like_others(folder):
    """They lead nowhere, and are told apart."""
    Path("one").symlink_to("other")
    Path("other").symlink_to("one")
    require_separate([Path("new.csv")], [Path("one"), Path("no\0name")])
    with pytest.raises(InputError, match="would be overwritten"):
        require_separate([Path("one")], [Path("one")])


def test_a_link_to_a_file_of_a_bag_that_is_read_is_known(folder):
    """It lies outside, and yet it is that file."""
    os.link("bag/metadata.yaml", "linked.json")
    with pytest.raises(InputError, match=r"linked\.json would be overwritten"):
        require_separate([Path("linked.json")], [Path("bag")])


def test_the_folder_of_an_unfinished_bag_is_one(folder):
    """A recorder that was killed has written no metadata; it names its files after the folder."""
    for name, is_bag in (("night_0.mcap", True), ("night_1.db3.zstd", True), ("other.mcap", False)):
        Path("night").mkdir()
        Path("night", name).touch()
        if is_bag:
            with pytest.raises(InputError, match="lies inside the bag"):
                require_outside_bags(Path("night/new.yaml"))
        else:
            require_outside_bags(Path("night/new.yaml"))
        shutil.rmtree("night")
