"""The commands with bags: the time to correct an hour of data, and the peak memory with a bag of 1 GB."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from functools import partial
from io import StringIO
from pathlib import Path

from bag_making import RATE_HZ, make_recording
from bag_reading import iterate
from spread import Row, measure

from tam_calibration.cli.main import main as tam
from tam_calibration.fit import calibrate
from tam_calibration.model.array import Array
from tam_calibration.recordings import read_array
from tam_calibration.results import write_calibration, write_recording

HOUR = 3600 * RATE_HZ
LARGE = 1_250_000
"""Samples of four sensors and a scalar that make 1 GB."""

PEAK = """
import re, sys
from pathlib import Path
from tam_calibration.cli.main import main
main(sys.argv[1:], standalone_mode=False)
print(re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1], file=sys.stderr)
"""
"""Runs a command and prints the peak of its memory, KiB; what getrusage tells would include the parent's."""


def hour(folder: Path, repeats: int) -> Iterator[Row]:
    """Yield the time to correct an hour at 100 Hz of four sensors over what may be asked of it."""
    calibration, source, output = folder / "calibration.yaml", folder / "hour.mcap", folder / "corrected.mcap"
    write_calibration(calibration, calibrate(make_recording(600), read_array_of(folder)))
    write_recording(source, make_recording(HOUR, scalar=False))
    content = source.read_bytes()
    arguments = ["correct", str(source), "--calibration", str(calibration), "-o", str(output), "--json"]
    times = measure(
        {
            "raw": partial(iterate, source, False),
            "write": partial((folder / "bytes").write_bytes, content),
            "ours": partial(correct_anew, output, arguments),
        },
        repeats,
    )
    yield Row(
        "one hour at 100 Hz × 4, mcap",
        "correcting over 1.5 × iterating raw + writing its bytes",
        list(times["ours"] / (1.5 * times["raw"] + times["write"])),
        most=1,
    )


def correct_anew(output: Path, arguments: list[str]) -> None:
    """Correct into a bag that is not there: one that is would be refused."""
    output.unlink(missing_ok=True)
    run(arguments)


def run(arguments: list[str]) -> None:
    """Run the command line, its output unseen."""
    with redirect_stdout(StringIO()):
        tam(arguments, standalone_mode=False)


def read_array_of(folder: Path) -> Array:
    """Return the cross, and leave its file in a folder."""
    path = folder / "array.yaml"
    path.write_text("baseline_m: 0.5\nvector_noise_nT: 1.0\nscalar_noise_nT: 0.1\n")
    return read_array(path)


def memory(folder: Path) -> Iterator[Row]:
    """Yield the peak memory of the commands with a bag of 1 GB, each in a process of its own."""
    source, calibration = folder / "large.mcap", folder / "calibration.yaml"
    write_recording(source, make_recording(LARGE))
    size = f"mcap of {source.stat().st_size / 1e9:.2f} GB"
    for arguments in (
        [
            "correct",
            str(source),
            "--calibration",
            str(calibration),
            "-o",
            str(folder / "large_corrected.mcap"),
            "--json",
        ],
        ["calibrate", str(source), "--array", str(folder / "array.yaml"), "--json", "-"],
    ):
        done = subprocess.run([sys.executable, "-c", PEAK, *arguments], capture_output=True, text=True, check=True)
        yield Row(size, f"peak memory of tam {arguments[0]}, MiB", [int(done.stderr.split()[-1]) / 1024], most=500)
