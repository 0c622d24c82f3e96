"""The battery at the command line: ``PYTHONPATH=test:. python -m battery``; see ``--help``."""

import argparse
import os
import shutil
import signal
import sys
import time
from collections import Counter
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from battery.battery import Battery, Result
from battery.cases import CASES, FAMILIES
from battery.judge import Bad


def main() -> int:
    """Try cases, print what is bad and a table, and return 1 if any is bad."""
    parser = argparse.ArgumentParser(prog="python -m battery", description=__doc__)
    parser.add_argument("--seed", type=int, help="of what is spoiled; by default a new one")
    parser.add_argument("--case", type=int, nargs="*", help="numbers of cases; by default all")
    parser.add_argument("--family", choices=list(FAMILIES), nargs="*", help="only cases that are made like this")
    parser.add_argument(
        "--sample", type=int, help="only so many cases, drawn with the seed, none of those that take long"
    )
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="processes")
    parser.add_argument("--keep", type=Path, help="folder in which the folders of the cases stay")
    asked = parser.parse_args()
    seed = np.random.SeedSequence().entropy % 2**32 if asked.seed is None else asked.seed
    numbers = _numbers(asked, seed)
    folder = Path(mkdtemp(prefix="battery_")) if asked.keep is None else asked.keep.resolve()
    folder.mkdir(exist_ok=True)
    print(f"{len(numbers)} cases of seed {seed}; again: make battery SEED={seed}", flush=True)
    began = time.monotonic()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the folder goes
    try:
        battery = Battery(seed, folder)
        battery.begin()
        if asked.keep is None:
            results = [_told(result, seed) for result in battery.try_all(numbers, asked.jobs)]
        else:
            results = [_told(battery.try_case(number, keeps=True), seed) for number in numbers]
    finally:
        if asked.keep is None:
            shutil.rmtree(folder, ignore_errors=True)
    _print_table(results)
    print(f"{len(results)} cases of seed {seed} in {time.monotonic() - began:.0f} s")
    lost = len(numbers) - len(results)
    if lost:
        print(f"{lost} cases were not tried: see above")
    return int(bool(lost) or any(result.bad for result in results))


def _numbers(asked: argparse.Namespace, seed: int) -> list[int]:
    if asked.case:
        return asked.case
    numbers = [n for n, (family, _) in enumerate(CASES) if not asked.family or family in asked.family]
    if asked.sample is None:
        return numbers
    rng = np.random.default_rng(seed)
    quick = [n for n in numbers if CASES[n][1] not in _SLOW]
    families = sorted({CASES[n][0] for n in quick})
    drawn = {n for family in families for n in _drawn(rng, [n for n in quick if CASES[n][0] == family], asked.sample)}
    return sorted(rng.permutation(sorted(drawn))[: asked.sample].tolist())


def _drawn(rng: np.random.Generator, numbers: list[int], count: int) -> list[int]:
    """Return some of the cases of a family, as many of each."""
    return rng.permutation(numbers)[:count].tolist()


_SLOW = (
    *("diagnose", "diagnose a bag", "compare", "batch", "demo", "reproduce", "blind make", "locate at once"),
    *("locate a coil", "nodes", "nodes with parameters"),
)
"""Recipes that take seconds each."""


def _told(result: Result, seed: int) -> Result:
    """Print what is bad about a case."""
    for name, why in result.bad.items():
        print(f"{name}: {why!r}\n  {result.told!r}, exit {result.code}, {result.seconds:.1f} s")
        print(f"  again: python -m battery --seed {seed} --case {result.number} --keep FOLDER", flush=True)
    return result


def _print_table(results: list[Result]) -> None:
    """Print how many cases of each family and command there were, and how many of each class were bad."""
    counts = Counter((result.family, result.command) for result in results)
    bad = Counter((result.family, result.command, name) for result in results for name in list(result.bad)[:1])
    classes = [each.name for each in Bad]
    print(f"{'':30}{'cases':>7}" + "".join(f"{name.lower():>11}" for name in classes))
    for family, command in counts:
        figures = [bad[family, command, name] for name in classes]
        print(f"{family + ' ' + command:30}{counts[family, command]:>7}" + "".join(f"{n or '':>11}" for n in figures))
    sums = [sum(count for (_, _, each), count in bad.items() if each == name) for name in classes]
    print(f"{'sum':30}{counts.total():>7}" + "".join(f"{n:>11}" for n in sums))


if __name__ == "__main__":
    sys.exit(main())
