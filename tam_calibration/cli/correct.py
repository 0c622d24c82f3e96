"""`tam correct`: from raw readings to the centre vector and the gradient tensor."""

from pathlib import Path

import click
import numpy as np

from tam_calibration.array import OUTPUT_NAMES
from tam_calibration.calibration import Calibration, Corrected
from tam_calibration.cli.terminal import PATH, reading, showing_progress, tolerance_option
from tam_calibration.files import read_array, read_calibration, read_samples, write_corrected
from tam_calibration.files.json_text import to_json
from tam_calibration.problems import InputError
from tam_calibration.units import to_nanotesla


@click.command()
@click.argument("recording", type=PATH)
@click.option("--calibration", "calibration_path", type=PATH, required=True, help="Calibration YAML of this array.")
@click.option("--array", "array_path", type=PATH, help="Array YAML, to make sure that the calibration is of it.")
@click.option("-o", "--output", type=PATH, required=True, help="A .csv or .mcap file, or the folder of a bag.")
@tolerance_option
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def command(
    recording: Path,
    calibration_path: Path,
    array_path: Path | None,
    output: Path,
    tolerance_s: float,
    as_json: bool,
) -> None:
    """Correct RECORDING, a CSV file or a bag; a bag keeps its other topics when a bag is written."""
    calibration = read_calibration(calibration_path)
    if array_path is not None:
        _check_array(calibration, array_path)
    inputs = [path for path in (recording, calibration_path, array_path) if path is not None]
    if output.resolve() in (path.resolve() for path in inputs):
        raise InputError(f"{output} would be overwritten: choose another name for the output")
    with showing_progress() as progress:
        samples = read_samples(recording, calibration.errors.sensor_count, tolerance_s, reading(progress))
        corrected = calibration.correct(samples.recording)
        progress.add_task(f"writing {output}", total=None)
        write_corrected(output, corrected, samples.stamps_ns, recording)
    summary = _summarise(corrected, output)
    click.echo(to_json(summary) if as_json else _sentence(summary))


def _check_array(calibration: Calibration, array_path: Path) -> None:
    if not calibration.array.has_geometry_of(read_array(array_path)):
        raise InputError(f"the calibration is of another array than {array_path}: use the calibration of this array")


def _summarise(corrected: Corrected, output: Path) -> dict[str, object]:
    intensity = np.linalg.norm(corrected.outputs[:, :3], axis=1)
    errors = to_nanotesla(corrected.standard_errors)
    units = ["nT" if name.startswith("b") else "nT_per_m" for name in OUTPUT_NAMES]
    return {
        "output": str(output),
        "samples": len(corrected.outputs),
        "intensity_mean_nT": to_nanotesla(float(intensity.mean())),
        "intensity_standard_deviation_nT": to_nanotesla(float(intensity.std())),
        "standard_errors": {
            f"{name}_{unit}": float(error) for name, unit, error in zip(OUTPUT_NAMES, units, errors, strict=True)
        },
    }


def _sentence(summary: dict[str, object]) -> str:
    return (
        f"{summary['output']}: {summary['samples']} samples corrected, "
        f"|B| {summary['intensity_mean_nT']:.1f} ± {summary['intensity_standard_deviation_nT']:.1f} nT"
    )
