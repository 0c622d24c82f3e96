"""A calibration, and what it took from the one before it, as tables and sentences for the page and the terminal."""

from itertools import groupby

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import KnownSource, Moved, Update, in_words
from tam_calibration.effects.library import units_of
from tam_calibration.model.array import OUTPUT_NAMES, TENSOR_OUTPUTS
from tam_calibration.model.data_sheet import DAY_S
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.fitted_effect import ALL, SCALAR, FittedEffect
from tam_calibration.model.sensor_errors import PARAMETER_NAMES, Residuals, orientation_to_axes
from tam_calibration.model.units import ERROR_KINDS, to_degrees, to_nanotesla
from tam_calibration.report.blocks import Block, Table, Text, count, join, number, ratio, with_error, with_errors

_MODEL = (
    "Value ± standard error. The model is yᵢ = Dᵢ Λᵢ bᵢ + oᵢ: D contains scale factors and non-orthogonality, "
    "Λ the misalignment, o the bias."
)
_EFFECTS = (
    "Effects, fitted together with the errors of the sensors, whose standard errors hold what is not known of them."
)
_SIZES = "Root mean square, over the recording, of what the effects add to each output, and what is taken off it."


def parameter_blocks(calibration: Calibration) -> list[Block]:
    """Return the errors of the sensors and the effects, with standard errors."""
    sensors = [f"sensor {sensor + 1}" for sensor in range(calibration.errors.sensor_count)]
    blocks: list[Block] = [Table(["parameter", *sensors], parameter_rows(calibration), _MODEL)]
    if calibration.effects:
        from tam_calibration.report.gap_rows import number_rows  # takes as long to load as a calibration

        numbers = [
            [fitted.effect, *row]
            for fitted in calibration.effects
            for row in number_rows(fitted, units_of(fitted, calibration.errors, calibration.array))
        ]
        blocks.append(Table(["effect", "parameter", "value ± standard error", "unit"], numbers, _EFFECTS))
    sized = zip(calibration.effects, calibration.effect_sizes, strict=True)
    if rows := [[each.effect, *map(number, to_nanotesla(size.rms).tolist())] for each, size in sized if size.rms.any()]:
        units = ("nT" if name.startswith("b") else "nT/m" for name in OUTPUT_NAMES)
        header = ["effect", *(f"{name} ({unit})" for name, unit in zip(OUTPUT_NAMES, units, strict=True))]
        blocks.append(Table(header, rows, _SIZES))
    return blocks


def parameter_rows(calibration: Calibration) -> list[list[str]]:
    """Return a row for each parameter: its name with the unit, then value ± standard error of each sensor."""
    values, standard_errors = calibration.errors.to_vector(), calibration.standard_errors
    rows = []
    for index, name in enumerate(PARAMETER_NAMES):
        if not (values[:, index].any() or standard_errors[:, index].any()):
            continue  # of one sensor alone, whose axes are the array's
        kind = ERROR_KINDS[index // 3]
        cells = with_errors(values[:, index] * kind.factor, standard_errors[:, index] * kind.factor, kind.decimals)
        rows.append([f"{name} ({kind.sign})".removesuffix(" ()"), *cells])
    mounted = [" ".join(orientation_to_axes(orientation)) for orientation in calibration.errors.orientation]
    if set(mounted) != {"x y z"}:
        rows.append(["mounted with its axes along the array's", *mounted])
    return rows


def _residual_figures(residuals: Residuals) -> dict[str, float]:
    """Return residuals in nT and nT/m by name: of each sensor, of the centre of several sensors, of the tensor."""
    sensors = residuals.sensor_intensity_T
    figures = {f"|B|, sensor {sensor} (nT)": value for sensor, value in enumerate(sensors, start=1)}
    if len(sensors) > 1:
        figures["|B|, centre (nT)"] = residuals.center_intensity_T
    if np.isfinite(residuals.tensor_rmse_T_per_m):
        names = (f"{OUTPUT_NAMES[index]} (nT/m)" for index in TENSOR_OUTPUTS)
        figures |= dict(zip(names, residuals.tensor_T_per_m, strict=True))
        figures["tensor, root of the sum of squares (nT/m)"] = residuals.tensor_rmse_T_per_m
    return {name: to_nanotesla(float(value)) for name, value in figures.items()}


def summary_blocks(calibration: Calibration) -> list[Block]:
    """Return the residuals of the worst sensor, centre and tensor, and the largest standard errors, in a few lines."""
    states = {"before": calibration.before, "after": calibration.best_residuals, "noise floor": calibration.floor}
    figures = [_residual_figures(state) for state in states.values()]
    worst = np.argmax(calibration.best_residuals.sensor_intensity_T / calibration.floor.sensor_intensity_T)
    names = [name for name in figures[0] if name.startswith((f"|B|, sensor {worst + 1} ", "|B|, centre", "tensor"))]
    rows = [[name, *(number(values[name]) for values in figures)] for name in names]
    largest = calibration.standard_errors.reshape(-1, 4, 3).max(axis=(0, 2))
    errors = [
        f"{kind.name} {number(kind.factor * float(error), 2)}{kind.sign.replace('nT', ' nT')}"
        for kind, error in zip(ERROR_KINDS, largest, strict=True)
        if error
    ]
    effects = [f"{one.effect} in {_sensors(one, calibration.errors.sensor_count)}" for one in calibration.effects]
    return [
        *([Text(f"Effects fitted too: {'; '.join(effects)}.")] if effects else []),
        Table(["RMS residual", *states], rows),
        *([Text(f"Largest standard errors: {join(errors)}.")] if errors else []),
        Text(_field(calibration)),
    ]


def _sensors(fitted: FittedEffect, count: int) -> str:
    """Return in words where an effect acts on an array of some sensors."""
    found = {one.sensor for one in fitted.contributions}
    numbers = range(count) if ALL in found else sorted(found - {SCALAR})
    return sensors_in_words([*(number + 1 for number in numbers), *["scalar"] * (SCALAR in found)], count)


def _field(calibration: Calibration) -> str:
    intensity = number(to_nanotesla(calibration.intensity_T), 6)
    known = f"from {calibration.reference or 'the scalar reference'}"
    reference = known if calibration.has_scalar_reference else "fitted, on an unknown scale"
    seen = f"{count(calibration.samples)} samples; {calibration.coverage:.0%} of the sphere seen"
    return f"Field: {intensity} nT, {reference}; {seen}."


def quality_blocks(calibration: Calibration) -> list[Block]:
    """Return the residuals in and out of sample against the noise floor."""
    return [_residuals(calibration), *(Text(words(calibration)) for words in (_chi_square, _noise, _field))]


def _residuals(calibration: Calibration) -> Table:
    after = {"in sample": calibration.in_sample}
    caption = "Root mean square residuals. No samples were held out."
    if calibration.held_out is not None:
        after["held out"] = calibration.held_out
        caption = "Root mean square residuals. Held out: samples that the fit did not see."
    states = {"before": calibration.before, **after, "noise floor": calibration.floor}
    columns = {name: _residual_figures(state) for name, state in states.items()}
    rows = []
    for quantity, floor in columns["noise floor"].items():
        ratios = [ratio(columns[name][quantity] / floor) for name in after]
        rows.append([quantity, *(number(column[quantity]) for column in columns.values()), *ratios])
    return Table(["residual", *columns, *(f"{name} / floor" for name in after)], rows, caption)


def _chi_square(calibration: Calibration) -> str:
    if not calibration.reduced_chi_square:
        return "There is no redundancy, hence no reduced χ²."
    values = []
    for name, value in calibration.reduced_chi_square.items():
        many = " in sums over many samples" if name.startswith("slow_") else ""
        values.append(f"{number(value)} {calibration.channels_in_words[name.removeprefix('slow_')]}{many}")
    return f"Reduced χ²: {join(values)}; it is 1 for noise alone."


def _noise(calibration: Calibration) -> str:
    array = calibration.array
    noises = [number(to_nanotesla(float(value))) for value in array.vector_noise_T]
    vector = f"{noises[0]} nT for every sensor" if len(set(noises)) == 1 else f"{join(noises)} nT, sensor by sensor"
    scalar = ""
    if calibration.has_scalar_reference and not calibration.reference:
        scalar = f"; of the scalar magnetometer: {number(to_nanotesla(array.scalar_noise_T))} nT"
    origin = "estimated from this recording where it was not" if calibration.noise_is_estimated else "as"
    return f"Noise per axis: {vector}{scalar}; {origin} stated for the array."


_INTRODUCTION = (
    "A uniform field sees neither the length of the baselines, nor a turn of all sensors together, nor where the "
    "elements of the axes sit. The field of a known source did; array and matrices hold what it showed."
)
_COMMON = "Value ± standard error, of the noise of the source's amplitudes; the source itself counts as exact."
_PLACES = "Place of the element of each axis relative to its sensor (mm), array frame ± standard error."


def known_source_blocks(calibration: Calibration) -> list[Block]:
    """Return what a known source showed of the array; empty where none was recorded."""
    found = calibration.known_source
    if found is None:
        return []
    blocks: list[Block] = [Text(_INTRODUCTION), _common(found)]
    if found.reduced_chi_square > 2.0:
        doubt = (
            f"Reduced χ² is {number(found.reduced_chi_square)} where 1 is expected. The source is not quite where or "
            "what it was stated to be, or the array has an error of another kind. The standard errors are too small."
        )
        blocks.append(Text(doubt, "doubt"))
    return [*blocks, _places(calibration, found)]


def _common(found: KnownSource) -> Table:
    turns = with_errors(to_degrees(found.rotation), to_degrees(found.rotation_standard_errors), 4)
    rows = [
        ["true baselines over stated", with_error(found.baseline_scale, found.baseline_scale_standard_error, 4)],
        *([f"turn of the frame about {axis} (°)", turn] for axis, turn in zip("xyz", turns, strict=True)),
        ["reduced χ²", number(found.reduced_chi_square)],
    ]
    return Table(["quantity", "value"], rows, _COMMON)


def _places(calibration: Calibration, found: KnownSource) -> Table:
    offsets = calibration.array.axis_offsets_m
    assert offsets is not None
    errors = found.axis_offsets_standard_errors_m
    rows = [
        [f"{sensor + 1} {'xyz'[axis]}", *with_errors(1e3 * offsets[sensor, axis], 1e3 * errors[sensor, axis], 2)]
        for sensor, axis in np.ndindex(*offsets.shape[:2])
    ]
    return Table(["sensor, axis", "x", "y", "z"], rows, _PLACES)


def update_sentences(update: Update) -> list[str]:
    """Return where the prior came from, whether the data contradict it, and what moved, one sentence each."""
    chance = f"χ² {number(update.chi_square)} for {update.freedom} degrees of freedom"
    if update.rates is None:
        return ["Prior: the tolerances that the array file states.", f"Data against tolerances: {chance}."]
    verdict = "Data and prior agree" if not update.moved else "The data contradict the prior"
    warming = "temperatures unknown, assumed equal"
    if update.warming_K is not None:
        warming = f"warmer by {number(update.warming_K)} K since"
    changes = groupby(update.moved, key=lambda moved: (_change_of(moved), moved.since_s))
    return [
        f"Prior: {update.prior}, {age_in_words(update.elapsed_s)}; {warming}.",
        f"{verdict}: {chance}.",
        *(_told(list(parts)) for _, parts in changes),
    ]


_SHARES = (
    "Share of the recording in the knowledge of each parameter: one minus the ratio of the variances after and before. "
    "The rest comes from the prior."
)


def update_blocks(update: Update) -> list[Block]:
    """Return where the prior came from, what moved since, and what the data tell of each parameter."""
    first, *others = update_sentences(update)
    rows = [
        [name, *("–" if np.isnan(share) else f"{100 * share:.0f} %" for share in update.data_share[:, index].tolist())]
        for index, name in enumerate(PARAMETER_NAMES)
    ]
    sensors = [f"sensor {sensor + 1}" for sensor in range(len(update.data_share))]
    told = [Text(words, "doubt" if update.moved else "good") for words in others]
    return [Text(first), *told, Table(["parameter", *sensors], rows, _SHARES)]


def age_in_words(elapsed_s: float | None) -> str:
    """Return how old a prior is; of unknown age it counts as a day old."""
    if elapsed_s is None:
        return "of unknown age (one day assumed)"
    days = elapsed_s / DAY_S
    return f"{number(days)} days old" if days >= 1 else f"{number(24 * days)} h old"


def _change_of(moved: Moved) -> tuple[str, int]:
    """Return kind and sensor of the change that one is a part of."""
    return moved.together or (moved.kind, moved.sensor)


def _told(parts: list[Moved]) -> str:
    """Return the sentence of what moved in one piece."""
    moved = parts[0]
    words = f"The {in_words(*_change_of(moved))} moved"
    if moved.together is None:
        words += f" by {_change(moved)}"
    elif len(parts) <= 8:  # of more the table of errors says more
        words += " together: " + "; ".join(f"{in_words(part.kind, part.sensor)} by {_change(part)}" for part in parts)
    if moved.since_s is not None:
        words += f", at {moved.since_s:.1f} s of the recording; the calibration is that of the sensors since then"
    if moved.rivals:
        others = join([f"the {in_words(*rival)}" for rival in moved.rivals])
        words += f"; with probability {number(1 - moved.probability, 2)} it was {others}"
    return f"{words}. It was estimated again."


def _change(moved: Moved) -> str:
    kind = next(each for each in ERROR_KINDS if each.name == moved.kind).of_changes
    values = with_errors(kind.factor * moved.change, kind.factor * moved.standard_errors, 2)
    return f"{', '.join(values)} {kind.sign} ({' '.join(kind.axes)})"
