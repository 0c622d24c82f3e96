"""`tam correct`: from raw readings to the centre vector and the gradient tensor."""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np

from tam_calibration.cli import terminal
from tam_calibration.cli.streams import say
from tam_calibration.correction.acceptance import ScalarAgreement
from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import Corrected
from tam_calibration.correction.streaming import sensors_of
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.units import IntArray, to_nanotesla
from tam_calibration.recordings import read_array, transforms_in
from tam_calibration.recordings.channel_map import Reading
from tam_calibration.results import read_calibration, write_corrected_pieces
from tam_calibration.results.data_files import OUTPUT_COLUMNS, correct_file
from tam_calibration.results.overwriting import require_separate

Pieces = Iterator[tuple[Corrected, IntArray | None]]

RESIDUAL = "residual"
"""Name that accepts a scalar magnetometer that contradicts the corrected field."""


@click.command()
@click.argument("recording", type=terminal.PATH)
@terminal.path_option("--calibration", "Calibration YAML of this array.", required=True)
@terminal.path_option("--array", "Array YAML, to check that the calibration belongs to it.")
@click.option("-o", "--output", type=terminal.PATH, required=True, help="A .csv or .mcap file, or the folder of a bag.")
@terminal.reading_options
@click.option("--accept", type=click.Choice([RESIDUAL]), multiple=True, help="Overrule the refusal of this name.")
@terminal.answering
def command(
    recording: Path,
    calibration_path: Path,
    array_path: Path | None,
    output: Path,
    how: Reading,
    accept: tuple[str, ...],
    answer: terminal.Answer,
) -> None:
    """Correct RECORDING, of any format. From bag to bag, other topics are copied."""
    inputs = [path for path in (recording, calibration_path, array_path, *how.files) if path is not None]
    require_separate([output], inputs)
    with answer.files([*inputs, output]):
        calibration = read_calibration(calibration_path)
        if array_path is not None and not calibration.is_of(read_array(array_path, transforms_in(recording))):
            raise InputError(
                f"the calibration is of another array than {array_path}: use the calibration of this array"
            )
        intensity, agreement = _correct(recording, calibration, output, how, accept)
        if agreement.is_doubtful(calibration):
            say(f"warning: {agreement.sentence(calibration)}", err=True)
        summary = _summarise(intensity, agreement, calibration, output)
        answer.give(summary, _sentence(summary))


def _correct(
    recording: Path, calibration: Calibration, output: Path, how: Reading, accept: tuple[str, ...]
) -> tuple["_Intensity", ScalarAgreement]:
    """Write the corrected samples, and return their intensities, and how far these are from the scalar."""
    intensity, agreement = _Intensity(), ScalarAgreement()
    with terminal.showing_progress() as progress:
        corrected = correct_file(recording, calibration, how, terminal.reading(progress))
        written = terminal.working(progress, f"writing {output}")
        counted = _counted(corrected, intensity, agreement, calibration, RESIDUAL in accept)
        write_corrected_pieces(output, counted, recording, written, how, calibration.array)
    return intensity, agreement


@dataclass
class _Intensity:
    """Number, mean and variance of the intensities of each piece whose field is determined, T and T².

    ``without`` counts the samples that lack sensors, by what they lack; ``remarks`` tell which readings are missing and
    why.
    """

    samples: int = 0
    without: Counter[int] = field(default_factory=Counter)
    pieces: list[tuple[float, float, float]] = field(default_factory=list)
    remarks: tuple[str, ...] = ()

    def add(self, corrected: Corrected) -> None:
        """Add the intensities of a correction; the last one says what is missing."""
        self.remarks = corrected.remarks or self.remarks
        if corrected.missing is not None:
            self.without.update(corrected.missing[corrected.missing > 0].tolist())
        self.samples += len(corrected.outputs)
        intensity = np.linalg.norm(corrected.outputs[:, :3], axis=1)
        intensity = intensity[np.isfinite(intensity)]
        if len(intensity):
            self.pieces.append((len(intensity), float(intensity.mean()), float(intensity.var())))

    def mean_and_deviation_T(self) -> tuple[float, float]:
        """Return mean and standard deviation of all intensities, tesla; NaN where there is none."""
        if not self.pieces:
            return math.nan, math.nan
        counts, means_T, variances_T2 = np.transpose(self.pieces)
        mean_T = np.average(means_T, weights=counts)
        return float(mean_T), math.sqrt(np.average(variances_T2 + (means_T - mean_T) ** 2, weights=counts))


def _counted(
    pieces: Pieces, intensity: _Intensity, agreement: ScalarAgreement, calibration: Calibration, is_accepted: bool
) -> Pieces:
    """Yield the corrected pieces, their intensities and the residuals from the scalar added up.

    At the end, before they are put in their place, they are refused where the residuals are wrong and not accepted.
    """
    for corrected, stamps_ns in pieces:
        intensity.add(corrected)
        if corrected.scalar_T is not None:
            agreement.add(corrected.outputs, corrected.scalar_T)
        yield corrected, stamps_ns
    if agreement.is_wrong and not is_accepted:
        raise Refused(f"nothing is written, {agreement.sentence(calibration)}; where that is so, accept {RESIDUAL}")


def _summarise(
    intensity: _Intensity, agreement: ScalarAgreement, calibration: Calibration, output: Path
) -> dict[str, Any]:
    errors = to_nanotesla(calibration.output_standard_errors).tolist()
    mean_T, deviation_T = intensity.mean_and_deviation_T()
    return {
        "output": str(output),
        "samples": intensity.samples,
        "without_sensors": {
            " and ".join(map(str, sensors_of(code))): count for code, count in sorted(intensity.without.items())
        },
        "missing": list(intensity.remarks),
        "intensity_mean_nT": to_nanotesla(mean_T),
        "intensity_standard_deviation_nT": to_nanotesla(deviation_T),
        "scalar_residual_nT": to_nanotesla(agreement.residual_T),
        "standard_errors": dict(zip(OUTPUT_COLUMNS, errors, strict=True)),
    }


def _sentence(summary: dict[str, Any]) -> str:
    without = "".join(f"{count} of them without sensor {name}, " for name, count in summary["without_sensors"].items())
    return (
        f"{summary['output']}: {summary['samples']} samples corrected, {without}"
        f"|B| {summary['intensity_mean_nT']:.1f} ± {summary['intensity_standard_deviation_nT']:.1f} nT"
        + "".join(f"; {remark}" for remark in summary["missing"])
    )
