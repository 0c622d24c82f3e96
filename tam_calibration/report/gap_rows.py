"""A gap as paragraphs, tables and sentences, for the page and for the terminal."""

import math
from collections.abc import Iterable, Mapping, Sequence

from tam_calibration.effects.effect import Sized
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.gap.result import Cause, Considered, Gap, Size, Where
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.units import for_people, to_nanotesla
from tam_calibration.report.blocks import Block, Points, Table, Text
from tam_calibration.report.formatting import fixed, join, number, sentence, with_error
from tam_calibration.results.results_json import numbers_of


def verdict_blocks(gap: Gap) -> list[Block]:
    """Return whether there is a gap, how large it is, and which part of it is explained."""
    emphasis = "good" if gap.verdict in ("no_gap", "explained") else "doubt"
    return [Text(gap.headline, emphasis), *size_blocks(gap)]


def summary_blocks(gap: Gap) -> list[Block]:
    """Return remarks behind the first, the size of the gap, its causes and what to record next, in a few lines."""
    size, sensor_count = gap.size, len(gap.residue.floor_T) // 3
    blocks: list[Block] = [Text(remark, "doubt") for remark in gap.remarks[1:]]
    if gap.verdict != "not_identifiable":
        before, after = (number(to_nanotesla(value)) for value in (size.before_T, size.after_T))
        blocks.append(
            Text(
                f"Gap out of sample: {number(size.before)} noise floors, {before} nT at one axis of a sensor; "
                f"after its causes are added: {number(size.after)} noise floors, {after} nT."
            )
        )
    for cause in gap.causes:
        others = cause.indistinguishable_from
        like = f"; cannot be told from {join([name.replace('_', ' ') for name in others])}" if others else ""
        where = sensors_in_words(cause.sensors, sensor_count, cause.axes)
        found = f"probability {percent(cause.probability)}, explains {percent(cause.r2_cv)} out of sample"
        blocks.append(Text(f"{cause.fitted.effect}: {where}; {found}{like}."))
    return [*blocks, *_remainder(gap), *next_blocks(gap)]


def next_blocks(gap: Gap) -> list[Block]:
    """Return what to record next, where there is something."""
    return [Text(f"Next recording: {sentence(gap.next_recording)}")] if gap.next_recording else []


def _remainder(gap: Gap) -> list[Block]:
    return [Text(f"What no cause explains: {gap.remainder}", "doubt")] if gap.remainder else []


def size_blocks(gap: Gap) -> list[Block]:
    """Return remarks, how large the gap is, and which part of it is explained."""
    blocks: list[Block] = [Text(remark, "doubt") for remark in gap.remarks]
    if gap.verdict != "not_identifiable":
        blocks.append(_size_table(gap.size))
    if gap.noise:
        blocks.append(_noise_table(gap.noise))
    if gap.causes:
        blocks.append(Text(sentence(closed_words(gap.size))))
    return [*blocks, *_remainder(gap), *map(Text, (*set_words(gap), *unseen_words(gap)))]


def cause_blocks(gap: Gap, sensor_count: int) -> list[Block]:
    """Return the causes, ranked, with their parameters, the first block a table of all.

    Parameters
    ----------
    gap : Gap
        With a cause at least.
    sensor_count : int
        Number of sensors of the array.
    """
    header = ("cause", "where", "probability", "share", "explains out of sample", "ΔBIC", "cannot be told from")
    rows = [_cause_row(cause, sensor_count) for cause in gap.causes]
    blocks: list[Block] = [Table(header, rows, numeric=False)]
    for cause in gap.causes:
        effect = effect_named(cause.fitted.effect)
        blocks.append(Text(f"{cause.fitted.effect}: {effect.title}. {effect.physics}"))
        if rows := number_rows(cause.fitted, cause.units):
            where = sensors_in_words(cause.sensors, sensor_count, cause.axes)
            columns = ("parameter", "value ± standard error", "unit")
            blocks.append(Table(columns, rows, f"{cause.fitted.effect}: {where}", numeric=False))
        if words := cause_words(cause):
            blocks.append(Points(words))
    return blocks


def hypotheses(considered: Iterable[Considered]) -> Points:
    """Return what became of the effects that were tried, or could not be, those of one reason together."""
    names: dict[str, list[str]] = {}
    for each in considered:
        names.setdefault(f"{each.status.replace('_', ' ')}, {each.why}", []).append(each.effect)
    return Points([f"{join(own)}: {why}" for why, own in names.items()])


def cause_words(cause: Cause) -> list[str]:
    """Return sentences on a cause that any drift resembles, and on its size beside the largest known."""
    return [_DRIFT] * cause.is_drift + [_sized_words(sized) for sized in cause.sizes]


_DRIFT = (
    "The channel hardly does more than rise or fall, so that any other slow drift explains as much; the probability is "
    "that among the effects of the library."
)


def _sized_words(sized: Sized) -> str:
    """Return the size of a cause beside the largest known in words, with the source of the latter."""
    factor, unit = for_people(sized.limit.unit)
    unit = "" if unit == "1" else f" {unit}"
    found, largest = (f"{number(factor * value)}{unit}" for value in (abs(sized.value), sized.limit.largest))
    return f"Its {sized.name} is {found}; the largest known is {largest} ({sized.limit.source})."


def set_words(gap: Gap) -> list[str]:
    """Return the set of answers that contains the true one in 95 of 100 recordings, where it is known."""
    names = [name.replace("_", " ") for name in gap.set_95]
    return [f"In 95 of 100 such recordings the truth is among: {join(names)}."] if names else []


def unseen_words(gap: Gap) -> list[str]:
    """Return the smallest detectable gap, and the largest error of the calibration that a smaller one causes."""
    if gap.verdict != "no_gap" or math.isnan(gap.smallest_gap):
        return []
    words = f"A gap of less than {number(gap.smallest_gap, 2)} noise floors would not have been seen."
    if math.isfinite(gap.most_unseen_errors):
        words += (
            f" In the worst case such a gap would shift a parameter of the calibration by "
            f"{number(gap.most_unseen_errors, 2)} of its standard errors."
        )
    return [words]


def _size_table(size: Size) -> Table:
    """Return the size before and after, in noise floors, nT and nT/m."""
    at_axis = (number(to_nanotesla(value)) for value in (size.before_T, size.after_T, size.floor_T))
    rows = [
        ["in noise floors", number(size.before), number(size.after), "1"],
        ["at one axis of a sensor (nT)", *at_axis],
    ]
    if math.isfinite(size.before_T_per_m):
        gradients = (number(to_nanotesla(value)) for value in (size.before_T_per_m, size.after_T_per_m))
        rows.append(["gradient tensor (nT/m)", *gradients, ""])
    return Table(("size of the gap, out of sample", "before", "after its causes are added", "noise floor"), rows)


def _noise_table(noise: Sequence[AxisNoise]) -> Table:
    """Return the noise of each row with its standard error, its colour, and as the array file states it."""
    rows = [
        [
            f"sensor {one.sensor} {one.axis}" if one.sensor else "scalar",
            with_error(to_nanotesla(one.level_T), to_nanotesla(one.level_error_T), 3),
            one.colour,
            number(to_nanotesla(one.stated_T)) if math.isfinite(one.stated_T) else "–",
        ]
        for one in noise
    ]
    return Table(("noise of", "standard deviation (nT)", "colour", "stated (nT)"), rows, numeric=False)


def closed_words(size: Size) -> str:
    """Say which part of the gap above the floor is closed, with its confidence interval."""
    if not math.isfinite(size.closed):
        return ""
    low, high = (percent(bound) for bound in size.closed_interval)
    return f"{percent(size.closed)} of the gap's energy is closed (95 % confidence: {low} to {high})"


def where_words(where: Where, sensor_count: int) -> str:
    """Say in which sensors, axes, times and frequencies the gap lies.

    Parameters
    ----------
    where : Where
        Place of the gap.
    sensor_count : int
        Number of sensors of the array: all of them are not named one by one.
    """
    parts = [sensors_in_words(where.sensors, sensor_count, where.axes)]
    if where.time_s is not None:
        parts.append(f"from {fixed(where.time_s[0], 2)} to {fixed(where.time_s[1], 2)} s")
    if where.frequency_hz is not None:
        parts.append(f"at {number(where.frequency_hz[0])} to {number(where.frequency_hz[1])} Hz")
    return "; ".join(parts)


def _cause_row(cause: Cause, sensor_count: int) -> list[str]:
    """Return what a cause is, where, and the evidence for it."""
    return [
        cause.fitted.effect,
        sensors_in_words(cause.sensors, sensor_count, cause.axes),
        percent(cause.probability),
        percent(cause.share),
        percent(cause.r2_cv),
        fixed(cause.delta_bic, 0),
        join(list(cause.indistinguishable_from)) or "–",
    ]


def number_rows(fitted: FittedEffect, units: Mapping[str, str]) -> list[list[str]]:
    """Return name, value ± standard error and unit of each number of an effect.

    Parameters
    ----------
    fitted : FittedEffect
        Shape and coefficients, SI.
    units : mapping of str to str
        SI unit of each parameter of the shape and each coefficient, by name; the rows have the units of files, such as
        nT for T.
    """
    return [
        [name, valued(parameter["value"], parameter["standard_error"]), parameter["unit"]]
        for name, parameter in numbers_of(fitted, units).items()
    ]


def percent(part: float) -> str:
    """Format a part of one."""
    is_near_an_end = 0.0005 <= part < 0.1 or 0.99 < part < 0.9995
    return "–" if math.isnan(part) else f"{fixed(100 * part, 1 if is_near_an_end else 0)} %"


def valued(value: float, standard_error: float) -> str:
    """Format a value with its standard error, where that is known."""
    is_known = standard_error > 0 and math.isfinite(value)
    return with_error(value, standard_error, 4) if is_known else number(value, 4)
