"""`tam calibrate`: from a recording to a calibration."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from rich.progress import Progress

from tam_calibration.cli import terminal
from tam_calibration.cli.streams import say
from tam_calibration.correction.calibration import AmbientGradientEstimate, Calibration
from tam_calibration.files.text_files import to_json
from tam_calibration.fit import DEFAULT_METHOD, METHODS, calibrate
from tam_calibration.fit.doubts import is_unexplained
from tam_calibration.fit.recorded_attitude import as_if_uniform
from tam_calibration.integrity import ACCEPTABLE
from tam_calibration.messages.usage import Usage
from tam_calibration.model.array import OUTPUT_NAMES, Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import field_at
from tam_calibration.model.recording import SKETCH, Recording, SampleSource
from tam_calibration.model.units import FloatArray, from_degrees, to_nanotesla
from tam_calibration.recordings import provenance, read_array
from tam_calibration.recordings.bag_transforms import transforms_in
from tam_calibration.recordings.fit_with_usage import fit_with_usage
from tam_calibration.recordings.reading import AS_IT_IS, Reading
from tam_calibration.recordings.recording_file import read_source
from tam_calibration.report.blocks import Block, Text
from tam_calibration.report.calibration_rows import (
    known_source_blocks,
    parameter_blocks,
    quality_blocks,
    summary_blocks,
)
from tam_calibration.report.formatting import sentence, with_error
from tam_calibration.report.update_rows import update_blocks, update_sentences
from tam_calibration.results import FORMULA, calibration_to_mapping, calibration_to_yaml, read_calibration

if TYPE_CHECKING:
    from tam_calibration.gap.delays import Delays


def _summary(calibration: Calibration, remarks: Sequence[str]) -> list[Block]:
    """Return further reasons to doubt, what was done to the recording, the residuals and the size of the errors."""
    reasons = [Text(f"Also: {reason}.", "doubt") for reason in calibration.quality.reasons[1:]]
    update = [] if calibration.update is None else update_sentences(calibration.update)
    words = [Text(sentence(each)) for each in (*update, *calibration.notes, *remarks)]
    return [*reasons, *words, *summary_blocks(calibration)]


def _tables(calibration: Calibration, remarks: Sequence[str]) -> list[Block]:
    """Return parameters, residuals, coverage, what to know, and how to apply the calibration by hand."""
    words = [sentence(each) for each in (*calibration.notes, *remarks)]
    if calibration.ambient_gradient is not None:
        words.append(_gradient(calibration.ambient_gradient))
    return [
        *(Text(f"Warning: {sentence(warning)}", "doubt") for warning in calibration.warnings),
        *parameter_blocks(calibration),
        *quality_blocks(calibration),
        *([] if calibration.update is None else update_blocks(calibration.update)),
        *known_source_blocks(calibration),
        *(Text(each) for each in (*words, *calibration.statements, f"By hand: {FORMULA}")),
    ]


def _remarks(calibration: Calibration, recording: Recording, usage: Usage | None, delays: "Delays | None") -> list[str]:
    """Return what the recording leaves badly determined, what was used of it, and the delays that were found."""
    from tam_calibration.fit.identifiability import find_weakness

    weakness = "" if calibration.update else str(find_weakness(recording, calibration))
    return [
        *([weakness] if weakness else []),
        *([] if usage is None else [str(usage)]),
        *([] if delays is None else [_delays_in_words(delays)]),
    ]


def _gradient(gradient: AmbientGradientEstimate) -> str:
    values, errors = to_nanotesla(gradient.tensor_T_per_m), to_nanotesla(gradient.standard_errors_T_per_m)
    parts = (
        f"{name} {with_error(float(values[place]), float(errors[place]), 2)}"
        for name, place in zip(OUTPUT_NAMES[3:], zip(*np.triu_indices(3), strict=True), strict=True)
    )
    return f"Gradient of the field in the world of the attitude (nT/m): {', '.join(parts)}."


_Fit = Callable[[SampleSource, Array], Calibration]


@click.command()
@click.argument("recording", type=terminal.PATH)
@click.option("--array", type=terminal.PATH, required=True, help="Array YAML: positions and noise of the sensors.")
@click.option("-o", "--output", type=terminal.PATH, help="Calibration YAML to write.")
@click.option("--method", default=DEFAULT_METHOD, show_default=True, help=f"One of {', '.join(METHODS)}.")
@click.option(
    "--place",
    help="LAT,LON,DATE: take the intensity from IGRF if the recording has no scalar; with --prior or "
    "--attitude-noise-deg use the field of IGRF with its error.",
)
@click.option(
    "--prior",
    "prior_path",
    type=terminal.PATH,
    help="Earlier calibration YAML of the same array, used with allowance for changes since then.",
)
@click.option(
    "--attitude-noise-deg",
    type=terminal.NumberOrEstimate(1e-4, 28),
    help="Use the recorded attitude in the fit: its standard deviation about each axis, or estimate. It must come from "
    "gyroscope and accelerometer; the heading of an AHRS with a magnetometer is left out.",
)
@click.option(
    "--ambient-gradient",
    is_flag=True,
    help="Also fit a gradient of the site's field, using the recorded attitude.",
)
@click.option(
    "--effects",
    help="Also fit effects and keep them in the calibration: names such as temperature_drift,current_interference, or "
    "auto for those that tam diagnose finds.",
)
@click.option(
    "--source",
    type=terminal.PATH,
    help="YAML of a known source and its recording: also fit baselines, common frame and places of the axes.",
)
@click.option(
    "--estimate-delays",
    is_flag=True,
    help="First estimate the delays of the other sensors' stamps against sensor 1, and remove them.",
)
@terminal.reading_options
@terminal.answer_options
@click.option(
    "--json", "json_path", type=terminal.PATH, help="Write the result as JSON; - is stdout, instead of the tables."
)
@click.option("--report", type=terminal.PATH, help="Write an HTML page with residuals, coverage and parameters.")
@click.option(
    "--accept", multiple=True, metavar="NAME", help=f"Overrule a finding; may be repeated: {', '.join(ACCEPTABLE)}."
)
@click.pass_context
def command(
    ctx: click.Context,
    recording: Path,
    array: Path,
    output: Path | None,
    method: str,
    place: str | None,
    prior_path: Path | None,
    attitude_noise_deg: float | None,
    ambient_gradient: bool,
    effects: str | None,
    source: Path | None,
    estimate_delays: bool,
    how: Reading,
    detail: terminal.Detail,
    json_path: Path | None,
    report: Path | None,
    accept: tuple[str, ...],
) -> None:
    """Estimate the errors of an array's sensors from RECORDING, of any format.

    The first line says whether the calibration is good, doubtful or bad, and why. Exits 0 when it is good or doubtful,
    1 when it is bad (nothing is written, unless --accept names the finding), 2 on bad input.
    """
    to_stdout = json_path == Path("-")
    outputs = {"yaml": output, "json": None if to_stdout else json_path, "report": report}
    inputs = [recording, array, *([prior_path] if prior_path else []), *_files_of(source), *how.files]
    with terminal.graded(to_stdout), terminal.write_together(outputs, inputs) as beside:
        is_joint = prior_path is not None or attitude_noise_deg is not None
        model_T = field_at(place) if place is not None and is_joint else None
        fit = _fit_of(method, ambient_gradient, effects, accept, prior_path, model_T)
        if attitude_noise_deg is not None:
            fit = _with_attitude(fit)
        with terminal.showing_progress() as progress:
            found = read_array(array, transforms_in(recording))
            if attitude_noise_deg is not None:
                found = replace(found, attitude_noise=from_degrees(attitude_noise_deg))
            delays = _delays(recording, found, place, how, progress) if estimate_delays else None
            if delays is not None:
                found = replace(found, delay_s=delays.delay_s)
            taken = None if is_joint else place
            calibration, data, usage = _calibrate(recording, found, fit, taken, how, accept, progress)
            if source is not None:
                calibration = _complete(calibration, source, how, progress)
        if "yaml" in beside:
            beside["yaml"].write_text(calibration_to_yaml(calibration), encoding="utf-8")
        if "json" in beside:
            beside["json"].write_text(to_json(_to_mapping(calibration, delays)), encoding="utf-8")
        if "report" in beside:
            from tam_calibration.report.calibration_report import write_calibration_report

            write_calibration_report(beside["report"], calibration, data)
    if to_stdout:
        say(to_json(_to_mapping(calibration, delays)))
    else:
        remarks = _remarks(calibration, data, usage, delays)
        advice = f"tam correct {recording} --calibration {output} -o corrected.csv" if output else ""
        terminal.print_answer(
            f"{calibration.quality}.",
            _summary(calibration, remarks),
            _tables(calibration, remarks),
            detail,
            outputs.values(),
            advice,
        )
    if calibration.quality.grade == "bad":
        ctx.exit(1)


def _to_mapping(calibration: Calibration, delays: "Delays | None") -> dict[str, Any]:
    content = calibration_to_mapping(calibration)
    if delays is not None:
        content["delays"] = {"delay_s": delays.delay_s.tolist(), "standard_error_s": delays.standard_error_s.tolist()}
    return content


def _delays(path: Path, array: Array, place: str | None, how: Reading, progress: Progress) -> "Delays":
    """Return the delays of the sensors after sensor 1, whatever the array file states of them."""
    from tam_calibration.gap.delays import estimate_delays

    array = replace(array, delay_s=None)
    recording = read_source(path, array, how, terminal.reading(progress))[0].whole()
    progress.add_task("estimating delays", total=None)
    return estimate_delays(recording if place is None else _with_intensity(recording, place), array)


def _delays_in_words(delays: "Delays") -> str:
    milliseconds = zip(1e3 * delays.delay_s[1:], 1e3 * delays.standard_error_s[1:], strict=True)
    words = ", ".join(
        f"sensor {sensor} {with_error(float(value), float(error), 4)} ms"
        for sensor, (value, error) in enumerate(milliseconds, start=2)
    )
    stated = ", ".join(f"{round(value, 6) + 0.0:.6f}" for value in delays.delay_s.tolist())
    return f"Stamped after sensor 1: {words}. For the array file, live too: delay_s: [{stated}]."


def _fit_of(
    method: str,
    ambient_gradient: bool,
    effects: str | None,
    accept: Collection[str],
    prior_path: Path | None,
    main_field_T: FloatArray | None,
) -> _Fit:
    """Return the fit that the options ask for: of the errors alone, with a prior, or together with effects."""
    if effects is None:
        prior = None if prior_path is None else read_calibration(prior_path)
        return partial(
            calibrate,
            method=method,
            ambient_gradient=ambient_gradient,
            accept=accept,
            prior=prior,
            main_field_T=main_field_T,
        )
    if prior_path is not None or main_field_T is not None:
        raise InputError("--prior and --attitude-noise-deg do not go with --effects: take one after the other")
    if method != DEFAULT_METHOD:
        raise InputError(f"{method} cannot fit effects: {DEFAULT_METHOD} can")
    if ambient_gradient:
        raise InputError("name the gradient among the effects instead: --effects ambient_gradient")
    names = [name.strip() for name in effects.split(",") if name.strip()]
    if not names:
        raise InputError("--effects names none: give names such as temperature_drift, or auto")
    from tam_calibration.gap.calibration_with_effects import calibrate_with_effects

    return lambda samples, array: calibrate_with_effects(samples.whole(), array, names, accept=accept)


def _with_attitude(fit: _Fit) -> _Fit:
    def fit_with_attitude(samples: SampleSource, array: Array) -> Calibration:
        if samples.whole().attitude is None:
            raise InputError("the recording has no attitude: leave out --attitude-noise-deg")
        return fit(samples, array)

    return fit_with_attitude


def _calibrate(
    path: Path, array: Array, fit: _Fit, place: str | None, how: Reading, accept: Collection[str], progress: Progress
) -> tuple[Calibration, Recording, Usage | None]:
    """Return the calibration, what is shown of the recording, without the gradient that was fitted, and the usage.

    A large recording is kept in files and read anew for each pass; every n-th of its samples is shown.
    """
    samples, usage = read_source(path, array, how, terminal.reading(progress))
    if place is not None:
        samples = _with_intensity(samples.whole(), place)
    progress.add_task(f"fitting {samples.sample_count} samples", total=None)
    calibration = fit_with_usage(samples, usage, lambda seen: fit(seen, array))
    if is_unexplained(calibration):
        from tam_calibration.gap.explained import explained  # takes as long to load as a calibration

        going_on = terminal.progress_of(progress, "diagnosing")
        calibration = explained(calibration, samples, array, progress=going_on, accept=accept)
    calibration = replace(calibration, source=provenance(path))
    shown = samples if isinstance(samples, Recording) else samples.thinned(SKETCH)
    return calibration, as_if_uniform(shown, calibration.errors, array, calibration.ambient_gradient).whole(), usage


def _files_of(source: Path | None) -> list[Path]:
    """Return the files that a known source is read from."""
    if source is None:
        return []
    from tam_calibration.recordings.known_source import read_known_source

    return [source, read_known_source(source).recording]


def _complete(calibration: Calibration, path: Path, how: Reading, progress: Progress) -> Calibration:
    """Return the calibration with what the recording of a known source shows."""
    from tam_calibration.fit.source_completion import complete
    from tam_calibration.recordings.known_source import read_known_source

    stated = read_known_source(path)
    array = calibration.array
    given = stated.recording, array, replace(how, channel_map=None, window=AS_IT_IS.window), terminal.reading(progress)
    seen, usage = read_source(*given)
    if usage is not None:
        usage.require_enough()
    completed = complete(calibration, seen.whole(), stated.source, stated.frequency_hz)
    return completed if usage is None else replace(completed, warnings=(*completed.warnings, *usage.warnings()))


def _with_intensity(recording: Recording, place: str) -> Recording:
    if recording.scalar_T is not None:
        raise InputError("--place is for recordings without a scalar reference; this one has its own")
    intensity = np.linalg.norm(field_at(place))
    return replace(recording, scalar_T=np.full(recording.sample_count, intensity))
