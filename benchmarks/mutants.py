"""Whether a test fails when the fits, the localisation, the shared core or the diagnosis is changed in one place.

    python benchmarks/mutants.py                    # of every module: hours; writes benchmarks/results/mutants.csv
    python benchmarks/mutants.py fit/ellipsoid core     # of some modules and rooms: replaces their lines in it
    python benchmarks/mutants.py gap --most 6       # fewer of each module than twelve, the first of the same
    python benchmarks/mutants.py --since HEAD~10    # of lines changed since, for 45 seconds; writes nothing

cosmic-ray, which ``make mutants`` installs, changes a number or an operator in a copy of the repository, and the tests
of the module run until one fails: those of the file that mirrors it, then of those that name it, then of those that
mirror a module which imports it. What lives is printed. What ``benchmarks/mutants.md`` lists with the reason is not
tried. After ``--since`` the exit code is 1 where so few are killed as would be one time in a hundred if nine of ten
mutants of these lines were: a sample of twenty that misses three proves nothing.
"""

import argparse
import csv
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path

import hypothesis  # noqa: F401  a fork has it then
import pytest
from mutant_choice import PACKAGE, ROOMS, ROOT, SAMPLE, Mutant, changed_since, modules_of, mutants_of, tests_of
from scipy.stats import binom

TABLE = ROOT / "benchmarks" / "results" / "mutants.csv"
OUTCOMES = ["killed", "timeout", "survived", "listed"]
CI_S, MUTANT_S = 45.0, 20.0
"""Longest time of all mutants with ``--since``, and of one, which then is not counted."""

DAY_S = 86400.0
"""As good as no limit, of tests without a mutant: how long they take is what is measured."""
KILLED, CHANCE = 0.9, 0.01
"""Part that shall be killed, and the chance by which a sample of a room that good may show less."""


def outcome(copy: Path, tests: list[str], limit_s: float) -> str:
    """Return whether tests in a copy of the repository all pass, "survived", one fails, "killed", or "timeout"."""
    process = get_context("fork").Process(target=_run_tests, args=(copy, tests))
    process.start()
    process.join(limit_s)
    is_late = process.is_alive()
    assert process.pid is not None
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.join()
    return "timeout" if is_late else "killed" if process.exitcode else "survived"


def _run_tests(copy: Path, tests: list[str]) -> None:
    os.setsid()
    os.chdir(copy)
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    sys.path.insert(0, str(copy))
    loaded = ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # of hypothesis, which is there already
    os._exit(pytest.main(["--exitfirst", "--hypothesis-profile=ci", "-p", "no:cacheprovider", *loaded, *tests]))


def outcomes(
    mutants: Iterable[Mutant], copy: Path, limit_of: Callable[[str], float], is_nearest: bool = False
) -> Counter[str]:
    """Return how many mutants had which outcome, and print those that live; without time a module is left out."""
    listed, counts = set((ROOT / "benchmarks" / "mutants.md").read_text("utf-8").splitlines()), Counter[str]()
    for mutant in mutants:
        path, tests = copy / PACKAGE / f"{mutant.module}.py", tests_of(mutant.module, is_nearest)
        if mutant.change in listed:
            counts["listed"] += 1
        elif (limit_s := limit_of(mutant.module)) > 0:
            path.write_text(mutant.source, "utf-8")
            found = outcome(copy, tests, limit_s)
            shutil.copy(ROOT / PACKAGE / f"{mutant.module}.py", path)
            if found == "survived":
                print(mutant.change, flush=True)
            counts[found] += 1
    return counts


@cache
def measured_limit(copy: Path, module: str) -> float:
    """Return the seconds after which a mutant counts as one that never ends; 0 where the tests fail without any."""
    start_s = time.monotonic()
    if outcome(copy, tests_of(module), DAY_S) == "survived":
        return 10 + 3 * (time.monotonic() - start_s)
    print(f"{module} is left out: its tests fail without any mutant")
    return 0.0


def write(module: str, counts: Counter[str]) -> None:
    """Write the line of a module into the table."""
    known = list(csv.reader(TABLE.open(encoding="utf-8")))[1:] if TABLE.exists() else []
    own = [module, *map(str, (counts.total(), *(counts[name] for name in OUTCOMES)))]
    rows = sorted([own, *(row for row in known if row[0] != module)], key=lambda row: row[0])
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([["module", "mutants", *OUTCOMES], *rows])


def run_all(names: list[str], most: int, copy: Path) -> None:
    """Run the mutants of rooms and modules, and write each module's line of the table."""
    for module in modules_of(names):
        counts = outcomes(mutants_of(module, most=most), copy, partial(measured_limit, copy))
        write(module, counts)
        print(f"{module}: {counts['killed'] + counts['timeout']} of {counts.total()} killed", flush=True)


def run_changed(commit: str, copy: Path) -> None:
    """Run mutants of the lines that changed since a commit, while there is time; exit where too few are killed."""
    changed = changed_since(commit)
    if changed is None:
        print(f"Mutants are left out: this clone does not have the commit {commit}")
        return
    mutants = [mutant for module, lines in changed.items() for mutant in mutants_of(module, lines)]
    random.Random(commit).shuffle(mutants)
    end_s = time.monotonic() + CI_S
    counts = outcomes(mutants, copy, lambda _: min(MUTANT_S, end_s - time.monotonic()), is_nearest=True)
    tried = counts["killed"] + counts["survived"]
    told = f"{counts['timeout']} took longer than {MUTANT_S:.0f} s"
    print(f"{counts['killed']} of {tried} mutants were killed, {told}; of {len(mutants)} on changed lines")
    if binom.cdf(counts["killed"], tried, KILLED) < CHANCE:
        sys.exit(f"That is less than {KILLED:.0%}: tests must say what the changed lines do")


def main() -> None:
    """Run what is asked for, in a copy of the repository."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=ROOMS)
    parser.add_argument("--since", metavar="COMMIT")
    parser.add_argument("--most", type=int, default=SAMPLE, metavar="NUMBER")
    asked = parser.parse_args()
    sys.dont_write_bytecode = True  # of two files of one second the one's bytecode would be taken for the other's
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / ROOT.name
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".*", "build", "install", "log", "demo_output"))
        os.environ |= {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
        run_changed(asked.since, copy) if asked.since else run_all(asked.names, asked.most, copy)


if __name__ == "__main__":
    main()
