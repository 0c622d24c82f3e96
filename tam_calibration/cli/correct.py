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
    """Number, sum and sum of squares of the intensities, tesla, the sums of differences from the first.

    ``without`` counts the samples that lack sensors, by what they lack; ``known`` those whose field is determined;
    ``remarks`` tell which readings are missing and why.
    """

    samples: int = 0
    known: int = 0
    without: Counter[int] = field(default_factory=Counter)
    first_T: float = 0.0
    sum_T: float = 0.0
    squares_T2: float = 0.0
    remarks: tuple[str, ...] = ()

    def add(self, corrected: Corrected) -> None:
        """Add the intensities of a correction; the last one says what is missing."""
        self.remarks = corrected.remarks or self.remarks
        if corrected.missing is not None:
            self.without.update(corrected.missing[corrected.missing > 0].tolist())
        self.samples += len(corrected.outputs)
        intensity = np.linalg.norm(corrected.outputs[:, :3], axis=1)
        intensity = intensity[np.isfinite(intensity)]
        if not len(intensity):
            return
        self.first_T = self.first_T if self.known else float(intensity[0])
        difference = intensity - self.first_T
        self.known += len(difference)
        self.sum_T += float(difference.sum())
        self.squares_T2 += float((difference**2).sum())

    @property
    def mean_T(self) -> float:
        """Mean, tesla."""
        return self.first_T + self.sum_T / self.known if self.known else math.nan

    @property
    def standard_deviation_T(self) -> float:
        """Standard deviation, tesla."""
        if not self.known:
            return math.nan
        return math.sqrt(max(0.0, self.squares_T2 / self.known - (self.sum_T / self.known) ** 2))


def _counted(
    pieces: Pieces, intensity: _Intensity, agreement: ScalarAgreement, calibration: Calibration, is_accepted: bool
) -> Pieces:
    """Yield the corrected pieces, their intensities and the residuals from the scalar added up.

    At the end, before they are put in their place, they are refused where the residuals are wrong and not accepted.
    """
    for corrected, stamps_ns in pieces:
        intensity.add(corrected)
        if corrected.scalar_T is not None:
            agreement.add(corrected.outputs[:, :3], corrected.scalar_T)
        yield corrected, stamps_ns
    if agreement.is_wrong and not is_accepted:
        raise Refused(f"nothing is written, {agreement.sentence(calibration)}; where that is so, accept {RESIDUAL}")


def _summarise(
    intensity: _Intensity, agreement: ScalarAgreement, calibration: Calibration, output: Path
) -> dict[str, Any]:
    errors = to_nanotesla(calibration.output_standard_errors).tolist()
    return {
        "output": str(output),
        "samples": intensity.samples,
        "without_sensors": {
            " and ".join(map(str, sensors_of(code))): count for code, count in sorted(intensity.without.items())
        },
        "missing": list(intensity.remarks),
        "intensity_mean_nT": to_nanotesla(intensity.mean_T),
        "intensity_standard_deviation_nT": to_nanotesla(intensity.standard_deviation_T),
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
