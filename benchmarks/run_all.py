"""Every figure of speed in one run: ``make bench``, or ``python benchmarks/run_all.py [NAME …]``.

The benchmarks of ``ALL`` run one after another, each in a process of its own with one thread of linear algebra; each
prints its table and keeps it under ``benchmarks/results/``. At the end all that is asked of them stands in one table,
and with it the test that kills ``tam batch`` at ten random moments. About a quarter of an hour on two cores.

Not here, as they take up to hours, or tell accuracy and not speed: ``large.py`` (ten million samples),
``diagnosis.py`` (an hour of data), ``diagnose_scale.py`` (a million rows), ``limit.py``, ``localization.py``,
``localization_fit.py``, ``localization_moving.py``, ``mission.py``, ``gyroscope.py``, ``changes_within.py``,
``live.py``, ``live_over_dds.py``,
``platform_field.py``, ``platform_field_named.py``, ``blind.py``, ``compare_pairs.py``, ``compare_recordings.py``,
``wu_table_1.py``, ``ambient_gradient.py``, ``gradient_truth.py``, ``slow_scalar.py``, ``clocks.py``, ``delays.py``,
``integrity.py``, ``dependent_channels.py`` and ``papers_gap.py``; ``count.py``, which ``make count`` runs; and
``mutants.py``: each is a command of its own, named in its docstring.
"""

import csv
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter

import click
from rich.console import Console
from rich.table import Table
from spread import RESULTS, machine

ALL: dict[str, list[str]] = {
    "imports": [],
    "streaming": [],
    "receivers": [],
    "localizer": ["--seconds", "20"],
    "bags": ["--large"],
    "speed": ["--seconds", "10"],
    "rivals": [],
    "batch": ["--seconds", "20"],
}
"""The benchmarks by the names of their files, in the order in which they run, each with its options."""

KILLED = "test/cli/test_batch.py::test_killed_at_random_moments_it_gives_the_same"
FOLDER = Path(__file__).parent


@click.command(help=__doc__)
@click.argument("names", nargs=-1, type=click.Choice(list(ALL)))
def main(names: tuple[str, ...]) -> None:
    """Run the benchmarks; exit code 1 where one of them failed, whatever its figures."""
    console = Console(width=140)
    console.print(machine())
    chosen = names or tuple(ALL)
    outcomes = {name: run(console, name, [str(FOLDER / f"{name}.py"), *ALL[name]]) for name in chosen}
    done = [name for name, is_done in outcomes.items() if is_done]
    table = Table("benchmark", "case", "figure", "value", "10 % to 90 %", "asked", "met", title="What is asked")
    for name in done:
        for row in asked(name):
            table.add_row(name, *row)
    if "batch" in done:
        os.environ["KILLS"] = "10"
        met = "yes" if run(console, "killed", ["-m", "pytest", "-q", KILLED]) else "NO"
        table.add_row("batch", "killed by SIGKILL at ten random moments, resumed", "outputs", "", "", "the same", met)
    console.print(table)
    if len(done) < len(chosen):
        console.print(f"failed: {', '.join(name for name in chosen if name not in done)}")
        sys.exit(1)


def run(console: Console, name: str, arguments: list[str]) -> bool:
    """Run Python with some arguments, and return whether it went well."""
    begin = perf_counter()
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "COLUMNS": "140"}
    done = subprocess.run([sys.executable, *arguments], cwd=FOLDER.parent, env=environment)
    console.print(f"{name}: {perf_counter() - begin:.0f} s\n")
    return done.returncode == 0


def asked(name: str) -> Iterator[tuple[str, ...]]:
    """Yield the rows of a benchmark's results of which something is asked."""
    lines = (RESULTS / f"{name}.csv").read_text(encoding="utf-8").splitlines()
    for row in csv.DictReader(line for line in lines if not line.startswith("#")):
        if row["asked"]:
            figure = f"{row['method']}: {row['figure']}" if "method" in row else row["figure"]
            spread = f"{row['10 %']} to {row['90 %']}" if "10 %" in row else ""
            yield row["case"], figure, row.get("median") or row["value"], spread, row["asked"], row["met"]


if __name__ == "__main__":
    main()
