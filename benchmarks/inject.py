"""Known effects in real recordings: which are named at 1, 3 and 10 times the recording's own residual, and how large.

Run ``python benchmarks/inject.py RECORDING ARRAY […] [--seed 0] [--effects NAME]… [--times 3]…``.
Each effect is put into each recording by ``tam blind inject`` and diagnosed by ``tam diagnose``. An effect counts as
named when it is the first cause, or among the causes in the second column of figures. A size is right when it is within
10 % or three standard errors of the true one: the temperature or current coefficient, the step, the delay, the
amplitude of the tone, each as the root of the sum of the squares over the axes.
"""

import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from tam_validation.blind.folder import read_json
from tam_validation.blind.injected import INJECTED

QUANTITIES = {
    "temperature_drift": (" offset",),
    "current_interference": (" field",),
    "bias_jump": (" offset",),
    "time_skew": (" delay",),
    "periodic_interference": (" cosine 1", " sine 1"),
}
"""What the names of comparable parameters in an answer end in."""

NEAR = 0.10
"""Part of the true size by which a right one may err, whatever its standard error."""

STANDARD_ERRORS = 3.0
"""By which a right size may err: more is one case in 370 of normal errors."""


@click.command()
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path))
@click.option("--seed", default=0, show_default=True)
@click.option("--effects", multiple=True, type=click.Choice(list(INJECTED)), default=list(INJECTED))
@click.option("--times", multiple=True, type=float, default=(1.0, 3.0, 10.0), show_default=True)
def main(paths: tuple[Path, ...], seed: int, effects: tuple[str, ...], times: tuple[float, ...]) -> None:
    """Inject, diagnose and print a table."""
    console = Console(width=140)
    pairs = list(zip(paths[::2], paths[1::2], strict=False))
    absent = [path for path in paths if not path.is_file()]
    if not pairs or absent or len(paths) % 2:
        why = f"{absent[0]} is absent" if absent else "name recordings, each with its array file"
        console.print(f"skipped: {why}")
        return
    results = defaultdict(list)
    for recording, array in pairs:
        for effect in effects:
            for multiple in times:
                outcome = run(recording, array, effect, multiple, seed)
                results[effect, multiple].append(outcome)
                console.print(f"{recording.name} {effect} {multiple:g}×: {outcome['words']}")
    table = Table("effect", *(f"{what} {multiple:g}×" for multiple in times for what in ("first", "named", "size")))
    for effect in effects:
        table.add_row(effect, *(cell for multiple in times for cell in cells(results[effect, multiple])))
    table.add_row("all", *(cell for m in times for cell in cells([one for e in effects for one in results[e, m]])))
    console.print(table)


def run(recording: Path, array: Path, effect: str, times: float, seed: int) -> dict[str, Any]:
    """Put an effect into a recording, diagnose it, and judge the answer."""
    with TemporaryDirectory() as folder:
        data, answer = Path(folder, "data.csv"), Path(folder, "answer.json")
        words = ["--effect", effect, "--times", str(times), "--seed", str(seed), "-o", str(data)]
        said = tam("blind", "inject", str(recording), "--array", str(array), *words)
        if not data.exists():
            return {"words": said}
        said = tam("diagnose", str(data), "--array", str(array), "--json", str(answer))
        if not answer.exists():
            return {"words": said, "first": False, "named": False}
        return judged(read_json(data.with_suffix(".key.json")), read_json(answer))


def tam(*words: str) -> str:
    """Run a command, and return the last line that it said."""
    command = [sys.executable, "-m", "tam_calibration", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return (done.stderr.strip() or done.stdout.strip()).splitlines()[-1]


def judged(key: dict[str, Any], answer: dict[str, Any]) -> dict[str, Any]:
    """Hold an answer against its key."""
    causes = answer.get("causes") or []
    named = [cause["effect"] for cause in causes]
    own = [cause for cause in causes if cause["effect"] == key["effect"]]
    outcome = {"first": named[:1] == [key["effect"]], "named": bool(own)}
    words = f"{answer['verdict']} {' + '.join(named)}"
    size = told_size(key["effect"], own[0].get("parameters") or {}) if own else None
    if size is not None and key["coefficients"]:
        value, error = size
        true = float(np.linalg.norm(list(key["coefficients"].values())))
        outcome["size"] = abs(value - true) <= max(NEAR * true, STANDARD_ERRORS * error)
        words += f", {value:.4g} ± {error:.2g} for {true:.4g}"
    return {**outcome, "words": words}


def told_size(effect: str, parameters: dict[str, Any]) -> tuple[float, float] | None:
    """Return the size that an answer tells, with its standard error; None where none can be compared."""
    told = [
        (float(one["value"]), float(one["standard_error"] or 0.0))
        for name, one in parameters.items()
        if name.endswith(QUANTITIES.get(effect, ())) and "quadratic" not in name
    ]
    if not told:
        return None
    values, errors = np.array(told).T
    size = float(np.linalg.norm(values))
    return size, float(np.linalg.norm(values * errors) / size) if size else 0.0


def cells(outcomes: list[dict[str, Any]]) -> list[str]:
    """Return of how many the effect came first, was named, and had its size."""
    return [
        f"{sum(one[what] for one in outcomes if what in one)} of {sum(what in one for one in outcomes)}"
        for what in ("first", "named", "size")
    ]


if __name__ == "__main__":
    main()
