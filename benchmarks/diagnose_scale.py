"""What ``tam diagnose`` costs by the rows of a recording: processor time and peak memory, and whether it stays right.

Run ``python benchmarks/diagnose_scale.py``; a million rows take 300 MB of disk. The shipped scenario ``warming_up`` is
made longer, at 100 Hz, by ``tam simulate``; without ``--bare`` attitude and current are recorded too, so that every
effect is tried. Each command is a process of its own; its time and the peak of its resident set are those that
``wait4`` tells, reading and printing included. Linear is a growth of time no faster than that of rows. The cause is
sensor 2's drift with temperature; its distance from the truth is that of the offset of axis x, in its standard errors.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import yaml
from asked import Figure, show

from tam_calibration.files.text_files import write_whole
from tam_calibration.results.scenario import shipped_scenarios

SIZES = (100_000, 300_000, 1_000_000)
RATE_HZ = 100
ASKED_MIB = 400.0
"""Peak memory that is asked of a million rows: what a small computer on board has left."""

ASKED_ERRORS = 4.0
"""Deviation from the truth, at most: four standard errors of a sound answer come once in 16 000."""

TAM = (sys.executable, "-m", "tam_calibration")
RESULTS = Path(__file__).parent / "results" / "diagnose_scale.csv"


@click.command(help=__doc__)
@click.option("--rows", type=click.IntRange(min=1000), multiple=True, default=SIZES, show_default=True)
@click.option("--bare", is_flag=True, help="Without attitude and current.")
@click.option("--folder", type=click.Path(path_type=Path, file_okay=False), help="Where the recordings may lie.")
def main(rows: tuple[int, ...], bare: bool, folder: Path | None) -> None:
    """Run the benchmark."""
    channels = "temperature" if bare else "all channels"
    figures, seconds = [], {}
    with TemporaryDirectory(dir=folder) as name:
        for count in rows:
            write_recording(Path(name), count, bare)
            seconds[count], mebibytes, distance = diagnosed(Path(name))
            case = f"{count} rows"
            figures.append(Figure(case, channels, "processor time [s]", seconds[count]))
            figures.append(Figure(case, channels, "peak memory [MiB]", mebibytes, asked=(0.0, ASKED_MIB)))
            figures.append(Figure(case, channels, "from the truth [errors]", distance, asked=(0.0, ASKED_ERRORS)))
    first, last = min(rows), max(rows)
    growth = seconds[last] / seconds[first]
    figures.append(Figure(f"{last} rows", channels, f"time over {first}", growth, asked=(0.0, last / first)))
    show(figures, "tam diagnose by rows", "recorded")
    with write_whole(RESULTS) as path:
        header = "case,recorded,figure,value,standard_error,asked,met"
        lines = [f"# python benchmarks/diagnose_scale.py{' --bare' * bare}", header, *(each.line for each in figures)]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_recording(folder: Path, count: int, bare: bool) -> None:
    """Simulate a recording."""
    scenario = yaml.safe_load(shipped_scenarios()["warming_up"].read_text(encoding="utf-8"))
    scenario |= {"samples": count, "rate_hz": RATE_HZ}
    if not bare:
        scenario |= {"attitude": {"noise_deg": 0.01}, "current": {"low_A": 0.0, "high_A": 2.0, "period_s": 70.0}}
    (folder / "long.yaml").write_text(json.dumps(scenario), encoding="utf-8")
    subprocess.run([*TAM, "simulate", folder / "long.yaml", "-o", folder / "run.csv"], check=True, capture_output=True)


def diagnosed(folder: Path) -> tuple[float, float, float]:
    """Return processor time, peak memory in MiB, and how far from the truth the drift is, in standard errors."""
    command: list[str | Path] = [
        *TAM,
        "diagnose",
        folder / "run.csv",
        "--array",
        folder / "run.array.yaml",
        "--json",
        folder / "gap.json",
    ]
    with (folder / "printed").open("wb") as printed:
        process = subprocess.Popen(command, stdout=printed, stderr=printed)
        _, status, usage = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status):
        raise RuntimeError((folder / "printed").read_text(encoding="utf-8"))
    gap = json.loads((folder / "gap.json").read_text(encoding="utf-8"))
    if [(cause["effect"], cause["sensors"]) for cause in gap["causes"]] != [("temperature_drift", [2])]:
        raise RuntimeError(gap["statement"])
    told = gap["causes"][0]["parameters"]["sensor 2 x offset"]
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, abs(told["value"] - 1.5) / told["standard_error"]


if __name__ == "__main__":
    main()
