"""How soon the package is there: the time from the start of Python to the end of a statement or command.

Run ``python benchmarks/imports.py``. Each runs in a process of its own, in turn with a Python that does nothing. What
is asked is compared with the processor time of the process, that of the system included, which other work on the
machine disturbs least; beside it stands the time on the clock. That nothing heavy is loaded is tested in
``test/test_layers.py``.
"""

import subprocess
import sys
from resource import RUSAGE_CHILDREN, getrusage
from time import perf_counter

import click
from spread import Row, show

COMMANDS = {
    "python -c pass": ["-c", "pass"],
    "import tam_calibration": ["-c", "import tam_calibration"],
    "tam --help": ["-m", "tam_calibration", "--help"],
}
ASKED_S = 0.3
HEAVY = ("scipy", "matplotlib", "rclpy", "numpy", "rosbags", "pydantic", "rich")
LOADED = f"""
import atexit, sys
sys.argv = ["tam", "--help"]
atexit.register(lambda: print(len(set({HEAVY!r}) & set(sys.modules)), file=sys.stderr))
from tam_calibration.cli.main import main
main()
"""


@click.command(help=__doc__)
@click.option("--repeats", default=20, show_default=True, help="How often each is started.")
def main(repeats: int) -> None:
    """Run the benchmark."""
    cpu_s: dict[str, list[float]] = {name: [] for name in COMMANDS}
    clock_s: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(repeats):
        for name, arguments in COMMANDS.items():
            before, begin = _cpu_s(), perf_counter()
            subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
            clock_s[name].append(perf_counter() - begin)
            cpu_s[name].append(_cpu_s() - before)
    rows = []
    for name in COMMANDS:
        asked = {"most": ASKED_S} if name.startswith(("import", "tam")) else {}
        rows += [
            Row(name, "processor time, s", cpu_s[name], **asked),
            Row(name, "time on the clock, s", clock_s[name]),
        ]
    loaded = subprocess.run([sys.executable, "-c", LOADED], check=True, capture_output=True, text=True)
    rows.append(Row("tam --help", f"loaded of {', '.join(HEAVY)}", [float(loaded.stderr)], most=0.5))
    show("Start", f"python benchmarks/imports.py --repeats {repeats}", "imports.csv", rows)


def _cpu_s() -> float:
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
