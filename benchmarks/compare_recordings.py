"""`tam compare` on recordings of an IMU, and on a simulation of that IMU in MuJoCo.

Run ``python benchmarks/compare_recordings.py RECORDINGS OUT``, where RECORDINGS has runs of the BROAD data set with the
magnetometer's own samples and attitude (broad_02.csv, broad_08.csv, broad_33.csv) and broad.yaml, which states the
noise of the data sheet. Each pair leaves a page and a JSON file in OUT. The extra ``compare`` holds MuJoCo.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import process_time

import click
import numpy as np

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.append(str(Path(__file__).parents[1] / "examples"))

from vehicle import VehicleRun, simulate_vehicle

from tam_calibration.comparison import compare
from tam_calibration.comparison.result import Comparison
from tam_calibration.files.text_files import to_json, write_text
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import provenance, read_array, read_recording
from tam_calibration.report.blocks import Table
from tam_calibration.report.comparison_report import write_comparison_report
from tam_calibration.report.comparison_rows import closing_blocks, difference_blocks, headline, noise_blocks
from tam_calibration.results import write_recording
from tam_calibration.results.comparison_json import comparison_to_mapping

PATH = click.Path(path_type=Path)

DATA_SHEET = "data_sheet"

PAIRS = (
    (DATA_SHEET, "broad_02", "the data sheet's IMU in MuJoCo, and a run"),
    ("broad_02", "broad_08", "two runs of one IMU"),
    ("broad_02", "broad_33", "a run, and one with a magnet attached"),
)
"""Names of simulation and recording, and what they are."""


@click.command(help=__doc__)
@click.argument("recordings", type=PATH)
@click.argument("output", type=PATH)
def main(recordings: Path, output: Path) -> None:
    """Compare each pair whose files are there."""
    wanted = [recordings / name for name in ("broad.yaml", *sorted({f"{recording}.csv" for _, recording, _ in PAIRS}))]
    if absent := [path.name for path in wanted if not path.exists()]:
        click.echo(f"not in {recordings}: {', '.join(absent)}; nothing is compared")
        return
    output.mkdir(parents=True, exist_ok=True)
    array = read_array(recordings / "broad.yaml")
    write_data_sheet(output, recordings, array)
    for simulation, recording, title in PAIRS:
        paths = [(output if name == DATA_SHEET else recordings) / f"{name}.csv" for name in (simulation, recording)]
        begin = process_time()
        try:
            told = compare_files(paths, array, output / f"{simulation}_{recording}")
        except (InputError, Refused) as problem:
            told = [f"refused: {problem}"]
        click.echo(f"{simulation} beside {recording}: {title} ({process_time() - begin:.0f} s of processor time)")
        click.echo("".join(f"  {line}\n" for line in told))


def compare_files(paths: Sequence[Path], array: Array, output: Path) -> list[str]:
    """Return what is told of a simulation and a recording, and write the page and the JSON file."""
    simulation, recording = paths
    comparison = compare(read_recording(simulation), read_recording(recording), array)
    sources = provenance(simulation), provenance(recording)
    write_text(output.with_suffix(".json"), to_json(comparison_to_mapping(comparison, *sources)))
    write_comparison_report(output.with_suffix(".html"), comparison, *sources)
    return list(lines(comparison))


def write_data_sheet(output: Path, recordings: Path, array: Array) -> None:
    """Write the run of the IMU in MuJoCo: one sensor and its attitude, as long and as fast as the recording."""
    recording = read_recording(recordings / "broad_02.csv")
    made, _ = simulate_vehicle(data_sheet_run(recording, array))
    write_recording(output / f"{DATA_SHEET}.csv", made)


def data_sheet_run(recording: Recording, array: Array) -> VehicleRun:
    """Return the run of a vehicle with an IMU alone, with the noise that its array file states."""
    assert array.vector_noise_T is not None
    return VehicleRun(
        seed=1,
        positions_m=array.positions_m,
        vector_noise_T=array.vector_noise_T,
        scalar_noise_T=None,
        sample_count=recording.sample_count,
        rate_hz=float(1 / np.median(np.diff(recording.time_s))),
        temperature=None,
        current=None,
    )


def lines(comparison: Comparison) -> Iterator[str]:
    """Yield verdict, differences, noise and closing."""
    yield headline(comparison)
    yield from (f"mistake: {mistake.what}" for mistake in comparison.mistakes)
    yield from comparison.remarks
    for block in (*difference_blocks(comparison), *noise_blocks(comparison), *closing_blocks(comparison)):
        if isinstance(block, Table):
            yield from ("  ".join(row) for row in block.rows)
    if comparison.closing is not None:
        yield f"left: {comparison.closing.left or 'nothing'}"


if __name__ == "__main__":
    main()
