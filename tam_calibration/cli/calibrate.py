"""`tam calibrate`: from a recording to a calibration."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import numpy as np
from rich.progress import Progress

from tam_calibration.cli import terminal
from tam_calibration.cli.terminal import Answer, answering
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import DEFAULT_METHOD, METHODS, calibrate
from tam_calibration.fit.consistency import naming_causes
from tam_calibration.messages.samples import Usage
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import OF_IGRF, field_at
from tam_calibration.model.recording import SKETCH, Recording, SampleSource
from tam_calibration.model.units import from_degrees
from tam_calibration.recordings import provenance, read_array, transforms_in
from tam_calibration.recordings.channel_map import AS_IT_IS, Reading
from tam_calibration.recordings.fit_input import StatedSource, fit_with_usage, read_known_source, read_source
from tam_calibration.report import calibration_rows
from tam_calibration.report.blocks import Block, Text, sentence, with_errors
from tam_calibration.results import FORMULA, calibration_to_mapping, calibration_to_yaml, read_calibration

if TYPE_CHECKING:
    from tam_calibration.gap.delays import Delays


@dataclass(frozen=True)
class Wanted:
    """What the options ask of a calibration, each as it was given."""

    method: str
    place: str | None
    prior_path: Path | None
    attitude_noise_deg: float | None
    effects: tuple[str, ...]
    estimate_delays: bool
    accept: tuple[str, ...]

    @property
    def is_joint(self) -> bool:
        """Whether the fit uses a field or attitude with its error: the place then gives that field."""
        return self.prior_path is not None or self.attitude_noise_deg is not None


class Found(NamedTuple):
    """A calibration, the samples to show, how many were used, and the delays found."""

    calibration: Calibration
    shown: Recording
    usage: Usage
    delays: "Delays | None"


def _summary(calibration: Calibration, remarks: Sequence[str]) -> list[Block]:
    """Return further reasons to doubt, what was done to the recording, the residuals and the size of the errors."""
    reasons = [Text(f"Also: {reason}.", "doubt") for reason in calibration.quality.reasons[1:]]
    update = [] if calibration.update is None else calibration_rows.update_sentences(calibration.update)
    words = [Text(sentence(each)) for each in (*update, *calibration.notes, *remarks)]
    return [*reasons, *words, *calibration_rows.summary_blocks(calibration)]


def _tables(calibration: Calibration, remarks: Sequence[str]) -> list[Block]:
    """Return parameters, residuals, coverage, what to know, and how to apply the calibration by hand."""
    words = [sentence(each) for each in (*calibration.notes, *remarks)]
    return [
        *(Text(f"Warning: {sentence(warning)}", "doubt") for warning in calibration.warnings),
        *calibration_rows.parameter_blocks(calibration),
        *calibration_rows.quality_blocks(calibration),
        *([] if calibration.update is None else calibration_rows.update_blocks(calibration.update)),
        *calibration_rows.known_source_blocks(calibration),
        *(Text(each) for each in (*words, *calibration.statements, f"By hand: {FORMULA}")),
    ]


def _remarks(found: Found) -> list[str]:
    """Return what the recording leaves badly determined, what was used of it, and the delays that were found."""
    from tam_calibration.fit.identifiability import find_weakness

    weakness = "" if found.calibration.update else str(find_weakness(found.shown, found.calibration))
    delays = "" if found.delays is None else _delays_in_words(found.delays)
    return [each for each in (weakness, str(found.usage), delays) if each]


@click.command()
@click.argument("recording", type=terminal.PATH)
@terminal.array_option
@click.option("-o", "--output", type=terminal.PATH, help="Calibration YAML to write.")
@click.option(
    "--method",
    default=DEFAULT_METHOD,
    show_default=True,
    shell_complete=terminal.completed(lambda: METHODS),
    help=f"One of {', '.join(METHODS)}.",
)
@click.option(
    "--place",
    help="LAT,LON,DATE: take the intensity from IGRF if the recording has no scalar; with --prior or "
    "--attitude-noise-deg use the field of IGRF with its error.",
)
@terminal.path_option(
    "--prior", "Earlier calibration YAML of the same array, used with allowance for changes since then."
)
@click.option(
    "--attitude-noise-deg",
    type=terminal.NumberOrEstimate(1e-4, 28),
    help="Use the recorded attitude in the fit: its standard deviation about each axis, or estimate. It must come from "
    "gyroscope and accelerometer; the heading of an AHRS with a magnetometer is left out.",
)
@terminal.effects_option
@terminal.path_option(
    "--source", "YAML of a known source and its recording: also fit baselines, common frame and places of the axes."
)
@click.option(
    "--estimate-delays",
    is_flag=True,
    help="First estimate the delays of the other sensors' stamps against sensor 1, and remove them.",
)
@terminal.reading_options
@answering
@click.option("--report", type=terminal.PATH, help="Write an HTML page with residuals, coverage and parameters.")
@terminal.accept_option
def command(
    recording: Path,
    array_path: Path,
    output: Path | None,
    source_path: Path | None,
    how: Reading,
    answer: Answer,
    report: Path | None,
    **asked: Any,
) -> None:
    """Estimate the errors of an array's sensors from RECORDING, of any format.

    The first line says whether the calibration is good, doubtful or bad, and why. Exits 0 when it is good or doubtful,
    1 when it is bad (nothing is written, unless --accept names the finding), 2 on bad input.
    """
    wanted = Wanted(**asked)
    source = None if source_path is None else read_known_source(source_path)
    inputs = [recording, array_path, wanted.prior_path, source_path, *how.files]
    if source is not None:
        inputs.append(source.recording)
    with terminal.graded(answer.is_json, output=output), answer.files(inputs, yaml=output, report=report) as places:
        with terminal.showing_progress() as progress:
            found = _calibrate(recording, array_path, wanted, how, progress)
            if source is not None:
                found = found._replace(calibration=_complete(found.calibration, source, how, progress))
        if "yaml" in places:
            places["yaml"].write_text(calibration_to_yaml(found.calibration), encoding="utf-8")
        if "report" in places:
            from tam_calibration.report.calibration_report import write_calibration_report

            write_calibration_report(places["report"], found.calibration, found.shown)
        remarks = _remarks(found)
        delays = {}
        if found.delays is not None:
            from tam_calibration.results.results_json import attributes

            delays = {"delays": attributes(found.delays, "delay_s", "standard_error_s")}
        words = ("correct", recording, "--calibration", output, "-o", "corrected.csv")
        answer.give(
            calibration_to_mapping(found.calibration) | delays,
            f"{found.calibration.quality}.",
            _summary(found.calibration, remarks),
            _tables(found.calibration, remarks),
            terminal.next_command(*words) if output else "",
        )
    if found.calibration.quality.grade == "bad":
        raise click.exceptions.Exit(1)


def _delays(path: Path, array: Array, place: str | None, how: Reading, progress: Progress) -> "Delays":
    """Return the delays of the sensors after sensor 1, whatever the array file states of them."""
    from tam_calibration.gap.delays import estimate_delays

    array = replace(array, delay_s=None)
    recording = read_source(path, array, how, terminal.reading(progress))[0].whole()
    progress.add_task("estimating delays", total=None)
    return estimate_delays(recording if place is None else _with_intensity(recording, place), array)


def _delays_in_words(delays: "Delays") -> str:
    milliseconds = with_errors(1e3 * delays.delay_s[1:], 1e3 * delays.standard_error_s[1:], 4)
    words = ", ".join(f"sensor {sensor} {delay} ms" for sensor, delay in enumerate(milliseconds, start=2))
    stated = ", ".join(f"{round(value, 6) + 0.0:.6f}" for value in delays.delay_s.tolist())
    return f"Stamped after sensor 1: {words}. For the array file, live too: delay_s: [{stated}]."


def _fit_of(wanted: Wanted) -> Callable[[SampleSource, Array], Calibration]:
    """Return the fit that the options ask for: of the errors alone, with a prior, or together with effects."""
    field_T = field_at(wanted.place) if wanted.place is not None and wanted.is_joint else None
    if not wanted.effects:
        return partial(
            calibrate,
            method=wanted.method,
            accept=wanted.accept,
            prior=None if wanted.prior_path is None else read_calibration(wanted.prior_path),
            main_field_T=field_T,
        )
    if wanted.prior_path is not None or field_T is not None:
        raise InputError("--prior and --attitude-noise-deg do not go with --effects: take one after the other")
    if wanted.method != DEFAULT_METHOD:
        raise InputError(f"{wanted.method} cannot fit effects: {DEFAULT_METHOD} can")
    from tam_calibration.gap.calibration_with_effects import calibrate_with_effects

    return lambda samples, array: calibrate_with_effects(samples.whole(), array, wanted.effects, accept=wanted.accept)


def _calibrate(path: Path, array_path: Path, wanted: Wanted, how: Reading, progress: Progress) -> Found:
    """Return the calibration of a recording.

    A large recording is kept in files and read anew for each pass; every n-th of its samples is shown.
    """
    fit = _fit_of(wanted)
    array, delays = read_array(array_path, transforms_in(path)), None
    if wanted.attitude_noise_deg is not None:
        array = replace(array, attitude_noise=from_degrees(wanted.attitude_noise_deg))
    if wanted.estimate_delays:
        delays = _delays(path, array, wanted.place, how, progress)
        array = replace(array, delay_s=delays.delay_s)
    samples, usage = read_source(path, array, how, terminal.reading(progress))
    if wanted.attitude_noise_deg is not None and samples.whole().attitude is None:
        raise InputError("the recording has no attitude: leave out --attitude-noise-deg")
    reference = ""
    if wanted.place is not None and not wanted.is_joint:
        samples, reference = _with_intensity(samples.whole(), wanted.place), OF_IGRF
    progress.add_task(f"fitting {samples.sample_count} samples", total=None)

    def explain(sentences: Sequence[str]) -> tuple[str, ...]:
        from tam_calibration.gap.calibration_with_effects import explained  # takes as long to load as a calibration

        going_on = terminal.progress_of(progress, "diagnosing")
        return explained(sentences, samples, array, progress=going_on, accept=wanted.accept)

    calibration = naming_causes(lambda: fit_with_usage(samples, usage, lambda seen: fit(seen, array)), explain)
    calibration = replace(calibration, source=provenance(path), reference=reference or calibration.reference)
    shown = samples if isinstance(samples, Recording) else samples.thinned(SKETCH)
    return Found(calibration, shown, usage, delays)


def _complete(calibration: Calibration, stated: StatedSource, how: Reading, progress: Progress) -> Calibration:
    """Return the calibration with what the recording of a known source shows."""
    from tam_calibration.fit.source_calibration import complete

    how = replace(how, channel_map=None, window=AS_IT_IS.window)
    seen, usage = read_source(stated.recording, calibration.array, how, terminal.reading(progress))
    usage.require_enough()
    completed = complete(calibration, seen.whole(), stated.source, stated.frequency_hz)
    return replace(completed, warnings=(*completed.warnings, *usage.warnings()))


def _with_intensity(recording: Recording, place: str) -> Recording:
    if recording.scalar_T is not None:
        raise InputError("--place is for recordings without a scalar reference; this one has its own")
    intensity = np.linalg.norm(field_at(place))
    return replace(recording, scalar_T=np.full(recording.sample_count, intensity))
