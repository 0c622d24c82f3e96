"""The processes of a batch, some of which are killed."""

import os
from dataclasses import replace

import pytest

from tam_calibration.fleet.batch import run_here
from tam_calibration.fleet.task import Task, read_result


class Deadly:
    """Ends the process that receives it, as the system does where memory runs out."""

    def __reduce__(self):
        """Name the function that makes it anew."""
        return os._exit, (1,)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_process_that_is_killed_loses_its_own_task_only(folder, options, jobs):
    """All others are done, and the one that was lost is told."""
    names = ["one.mcap", "deadly.mcap", "two.mcap"]
    for name in names:  # a damaged recording is a result like others, without a fit
        (folder / name).write_text("no bag")
    tasks = [Task.of(folder / name, folder / "out", options) for name in names]
    tasks[1] = replace(tasks[1], options=Deadly())
    told = {task.path.name: sentence for task, sentence in run_here(tasks, jobs)}
    assert [bool(told[name]) for name in names] == [False, True, False]
    assert "its process was killed: did memory run out?" in told["deadly.mcap"]
    assert [read_result(task.folder) is not None for task in tasks] == [True, False, True]


def test_what_cannot_be_written_is_told(folder, options):
    """A file stands where the results should go."""
    (folder / "out").write_text("a file")
    task = Task.of(folder / "missions/auv_1/dive_0.csv", folder / "out", options)
    ((_, sentence),) = run_here([task], 1)
    assert sentence.startswith(("NotADirectoryError", "FileExistsError"))
