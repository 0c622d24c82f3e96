"""Environments, full disks, closed pipes and limits in which good commands run."""

import resource
from dataclasses import replace
from pathlib import Path

from numpy.random import Generator

from battery.recipes import Recipe
from battery.surroundings import PLAIN, Surroundings
from battery.trial import May, Trial, pick

_ASCII = {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def spoil_environment(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Run a good line where something about the process is unusual."""
    fresh = Surroundings(fresh=True)
    ways: dict[str, Surroundings] = {
        "ASCII locale": replace(fresh, variables=_ASCII),
        "POSIX locale": replace(fresh, variables={**_ASCII, "LC_ALL": "POSIX"}),
        "Latin 1": replace(fresh, variables={"PYTHONIOENCODING": "latin-1"}),
        "unknown locale": replace(fresh, variables={"LC_ALL": "xx_XX.none"}),
        "stdout closed": replace(fresh, stdout="closed"),
        "stderr closed": replace(fresh, stderr="closed"),
        "stdin closed": replace(fresh, stdin="closed"),
        "both closed": replace(fresh, stdout="closed", stderr="closed"),
        "stdout full": replace(fresh, stdout="/dev/full"),
        "stderr full": replace(fresh, stderr="/dev/full"),
        "no HOME": replace(fresh, variables={"HOME": None}),
        "HOME nowhere": replace(fresh, variables={"HOME": "/nowhere"}),
        "TMPDIR nowhere": replace(fresh, variables={"TMPDIR": "/nowhere"}),
        "ROS_LOG_DIR nowhere": replace(fresh, variables={"ROS_LOG_DIR": "/proc/nowhere"}),
        "ROS_DOMAIN_ID": replace(fresh, variables={"ROS_DOMAIN_ID": pick(rng, ("x", "-1", "233", "1e3", "9" * 30))}),
        "no variables": replace(fresh, variables=dict.fromkeys(("HOME", "PATH", "LANG", "USER", "TERM", "SHELL"))),
        "narrow terminal": Surroundings(variables={"COLUMNS": str(int(rng.integers(-1, 3))), "LINES": "1"}),
        "no terminal": Surroundings(variables={"TERM": "none"}),
        "few files": Surroundings(limits={resource.RLIMIT_NOFILE: int(rng.integers(12, 30))}),
        "no processes": Surroundings(limits={resource.RLIMIT_NPROC: 0}, is_nobody=True),
        "read-only folder": Surroundings(is_nobody=True),
        "unreadable inputs": Surroundings(is_nobody=True),
        "folder removed": Surroundings(within="empty", loses_folder=True),
    }
    way = pick(rng, sorted(ways))
    if way == "unreadable inputs":
        for name in recipe.reads:
            (folder / name).chmod(0)
    if way == "folder removed":
        (folder / "empty").mkdir()
    return Trial.of(recipe, way, May.DO_THE_SAME, ways[way])


def close_pipe(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Let the reader of the answer go."""
    count = int(pick(rng, (0, 1, 100, 5000)))
    around = Surroundings(fresh=True, stdout="broken", read_bytes=count)
    return Trial.of(recipe, f"stdout read for {count} bytes", May.DO_THE_SAME, around)


def fill_disk(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Let the disk of the outputs be full after some bytes, none among them."""
    count = int(pick(rng, (0, 10 ** rng.uniform(1, 6))))
    if rng.random() < 0.5:
        around = Surroundings(limits={resource.RLIMIT_FSIZE: count})
        return Trial.of(recipe, f"files of {count} bytes", May.DO_THE_SAME, around)
    size = max(4096, count // 4096 * 4096)
    moved = {word: f"disk/{word}" for word in recipe.writes}
    line = tuple(moved.get(word, word) for word in recipe.line)
    recipe = replace(recipe, line=line, writes=tuple(moved.values()))
    return Trial.of(recipe, f"a disk of {size} bytes", May.DO_THE_SAME, replace(PLAIN, disk_bytes=size))
