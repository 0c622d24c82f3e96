"""A batch does what is left to do, loses nothing, and sums up."""

import csv
import fcntl
import json
from dataclasses import replace

import pytest
from matplotlib.figure import Figure

from tam_calibration.fleet.batch import find_recordings, run_batch
from tam_calibration.fleet.task import Task, process
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.results import write_recording


@pytest.fixture(autouse=True)
def plain_figures(monkeypatch):
    """Leave the figures of the pages empty: they take most of the time."""
    monkeypatch.setattr("tam_calibration.fleet.summary.plot_missions", lambda missions, group: Figure())


class Crew:
    """Does tasks in this process, and remembers which; ``lost`` names one whose result is not written."""

    def __init__(self, lost=None):
        self.done, self.told, self.lost = [], [], lost

    def __call__(self, tasks):
        """Do tasks one after another."""
        for task in tasks:
            self.done.append(task.path.name)
            if task.path.name != self.lost:
                process(task)
            yield task, "its process was killed" if task.path.name == self.lost else ""

    def tell(self, done, total):
        """Remember the progress."""
        self.told.append((done, total))


def batch(folder, options, crew):
    """Run the batch of all missions and return its results."""
    recordings = find_recordings(["missions/**"], folder / "out")
    return run_batch(recordings, folder / "out", options, crew, crew.tell)


def content(folder):
    """Return every file of the results with its bytes."""
    return {path: path.read_bytes() for path in (folder / "out").rglob("*") if path.is_file()}


def test_what_is_done_is_not_done_again(folder, options, asked):
    """A second batch does what has failed only, and leaves the same bytes."""
    first = Crew()
    results = batch(folder, options, first)
    assert sorted(first.done) == ["damaged.mcap", "dive_0.csv", "dive_1.mcap", "dive_2", "dive_3"]
    assert first.told == [(done, 5) for done in range(6)]
    assert [result.status for result in results] == ["done", "done", "failed", "done", "done"]
    before = content(folder)
    second = Crew()
    assert batch(folder, options, second) == results
    assert second.done == ["damaged.mcap"] and second.told == [(4, 5), (5, 5)]
    assert content(folder) == before


def test_what_has_changed_or_is_new_is_done(folder, options, asked, mission):
    """A recording with another content, and one more."""
    batch(folder, options, Crew())
    write_recording(folder / "missions/auv_1/dive_0.csv", mission(7))
    write_recording(folder / "missions/auv_1/dive_8.csv", mission(8))
    (folder / "missions/auv_2/damaged.mcap").unlink()
    crew = Crew()
    results = batch(folder, options, crew)
    assert sorted(crew.done) == ["dive_0.csv", "dive_8.csv"]
    assert [result.recording for result in results] == ["dive_1.mcap", "dive_0.csv", "dive_8.csv", "dive_2", "dive_3"]


def test_other_options_do_all_again(folder, options, asked):
    """Every recording, and what an older run left of it is gone."""
    batch(folder, options, Crew())
    stale = Task.of(folder / "missions/auv_2/dive_2", folder / "out", options).folder / "stale"
    stale.write_text("of an older run")
    crew = Crew()
    batch(folder, replace(options, digest="other"), crew)
    assert len(crew.done) == 5 and not stale.exists()


def test_a_lost_recording_is_told_and_done_the_next_time(folder, options, asked):
    """One whose process was killed leaves no result; the summary says so, and the others are there."""
    result = next(each for each in batch(folder, options, Crew("dive_2")) if each.recording == "dive_2")
    assert (result.status, result.trouble) == ("failed", "run: its process was killed")
    assert '"auv_2","dive_2",' in (folder / "out/summary.csv").read_text()
    again = Crew()
    batch(folder, options, again)
    assert "dive_2" in again.done and "dive_1.mcap" not in again.done


def test_a_result_that_is_not_there_is_told(folder, options, asked):
    """Workers of a cluster that write elsewhere are found out."""
    results = run_batch(
        [folder / "missions/auv_1/dive_0.csv"],
        folder / "out",
        options,
        lambda tasks: [(task, "") for task in tasks],
        lambda done, total: None,
    )
    assert results[0].status == "failed" and "its result is not in" in results[0].problems["run"]


def test_what_a_killed_batch_left_unfinished_is_removed(folder, options, asked):
    """Folders of unfinished recordings and summaries; nothing else."""
    batch(folder, options, Crew())
    before = content(folder)
    for name in ("recordings/auv_1/.dive_0.csv-0123.abc", ".summary.csv.xyz"):
        (folder / "out" / name).mkdir()
        (folder / "out" / name / "half").write_text("half")
    batch(folder, options, Crew())
    assert content(folder) == before


def test_a_batch_that_fails_leaves_nothing(folder, options, asked):
    """Neither a lock nor folders that are empty; one that ends well leaves no lock either."""

    def fail(tasks):
        raise InputError("no scheduler answers")

    before = sorted(folder.rglob("*"))
    with pytest.raises(InputError):
        run_batch([folder / "missions/auv_1/dive_0.csv"], folder / "new/out", options, fail, lambda done, total: None)
    assert sorted(folder.rglob("*")) == before
    batch(folder, options, Crew())
    assert sorted(path.name for path in (folder / "out").iterdir()) == [
        "recordings", "summary.csv", "summary.html", "summary.json",
    ]  # fmt: skip


def test_an_older_result_is_there_until_the_newer_one_is(folder, options, asked, monkeypatch):
    """Where the newer one cannot be moved to its place the older one stays."""
    task = Task.of(folder / "missions/auv_1/dive_0.csv", folder / "out", options)
    process(task)
    before = content(folder)
    seen = []

    def note(folder, result):
        seen.append(content(task.folder.parents[3]))
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tam_calibration.fleet.task.write_result", note)
    with pytest.raises(OSError, match="No space left"):
        process(task)
    assert before.items() <= seen[0].items() and content(folder) == before


def test_one_batch_writes_into_a_folder_at_a_time(folder, options, asked):
    """A second one is refused and changes nothing."""
    (folder / "out").mkdir()
    with (folder / "out/.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(Refused, match="another batch is writing into"):
            batch(folder, options, Crew())
    assert list((folder / "out").iterdir()) == [folder / "out/.lock"]


def test_a_folder_that_cannot_be_made_is_told(folder, options):
    """A file stands in its place."""
    (folder / "out").write_text("a file")
    with pytest.raises(InputError, match=r"out cannot be written"):
        run_batch([], folder / "out", options, Crew(), lambda done, total: None)


def test_the_summaries_tell_the_same(folder, options, asked):
    """One row a recording, drifts of 2 nT a day by platform, counts that add up; names are shown as text."""
    (folder / "missions/auv_2/damaged.mcap").rename(folder / "missions/auv_2/<i>.mcap")
    batch(folder, options, Crew())
    told = json.loads((folder / "out/summary.json").read_text())
    assert [each["platform"] for each in told["platforms"]] == ["auv_1", "auv_2"]
    assert told["platforms"][1] | {"causes": {}} == {
        "platform": "auv_2", "recordings": 3, "done": 2, "refused": 0, "failed": 1,
        "no_gap": 0, "explained": 2, "open": 0, "causes": {},
    }  # fmt: skip
    assert told["platforms"][0]["causes"] == {"temperature_drift": 2}
    biases = [drift for drift in told["drifts"] if drift["parameter"].startswith("bias")]
    assert len(biases) == 2 * 2 * 3
    for drift in biases:
        assert abs(drift["drift_nT_per_day"] - 2) < 1e-3 and 0 < drift["drift_standard_error_nT_per_day"] < 0.2
    with (folder / "out/summary.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert len(rows) == 6 and len(set(map(len, rows))) == 1
    page = (folder / "out/summary.html").read_text()
    assert "&lt;i&gt;.mcap" in page and "<i>.mcap" not in page
    assert page.count("data:image/svg+xml") == 2 * 4 and "Drift of auv_2: 2 missions" in page


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


def test_recordings_that_lie_where_results_go_are_named(folder):
    """They are there, but are not looked for."""
    with pytest.raises(InputError, match=r"csv lies in .*auv_1, where the results go: name another folder with -o"):
        find_recordings(["missions/auv_1/*.csv"], folder / "missions/auv_1")


def test_a_pattern_finds_the_names_that_end_as_it_does(folder):
    """Whatever the format; the pattern of all files finds no texts and logs, which may be anything."""
    log = folder / "missions/auv_1/log.txt"
    log.write_text("1 2 3")
    assert find_recordings(["missions/**/*.txt"], folder / "out") == [log.resolve()]
    assert log.resolve() not in find_recordings(["missions/**"], folder / "out")


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
