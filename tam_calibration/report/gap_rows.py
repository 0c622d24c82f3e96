"""A gap and its laws as paragraphs, tables and sentences, for the page and for the terminal."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from tam_calibration.effects.effect import Sized
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.laws.law import SCALAR, Signature, causes_of, in_words
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.gap.result import Cause, Considered, Gap, Size
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.units import for_people, to_nanotesla
from tam_calibration.report.blocks import Block, Points, Table, Text, fixed, join, number, sentence, with_error
from tam_calibration.results.results_json import numbers_of


def verdict_blocks(gap: Gap) -> list[Block]:
    """Return whether there is a gap, how large it is, and which part of it is explained."""
    emphasis = "good" if gap.verdict in ("no_gap", "explained") else "doubt"
    return [Text(gap.headline, emphasis), *size_blocks(gap)]


def summary_blocks(gap: Gap) -> list[Block]:
    """Return remarks behind the first, the size of the gap, its causes and what to record next, in a few lines."""
    size = gap.size
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
        where = sensors_in_words(cause.sensors, gap.sensor_count, cause.axes)
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


def cause_blocks(gap: Gap) -> list[Block]:
    """Return the causes of a gap that has some, ranked, with their parameters, the first block a table of all."""
    header = ("cause", "where", "probability", "share", "explains out of sample", "ΔBIC", "cannot be told from")
    rows = [_cause_row(cause, gap.sensor_count) for cause in gap.causes]
    blocks: list[Block] = [Table(header, rows, numeric=False)]
    for cause in gap.causes:
        effect = effect_named(cause.fitted.effect)
        blocks.append(Text(f"{cause.fitted.effect}: {effect.title}. {effect.physics}"))
        if rows := number_rows(cause.fitted, cause.units):
            where = sensors_in_words(cause.sensors, gap.sensor_count, cause.axes)
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


def size_rows(size: Size) -> list[list[str]]:
    """Return a gap before and after in noise floors, nT and nT/m, as far as they are known."""
    sizes = [
        ("in noise floors", size.before, size.after),
        ("at one axis of a sensor (nT)", to_nanotesla(size.before_T), to_nanotesla(size.after_T)),
        ("gradient tensor (nT/m)", to_nanotesla(size.before_T_per_m), to_nanotesla(size.after_T_per_m)),
    ]
    return [[name, number(before), number(after)] for name, before, after in sizes if math.isfinite(before)]


def _size_table(size: Size) -> Table:
    """Return the size before and after, and the noise floor."""
    floors = ("1", number(to_nanotesla(size.floor_T)), "")
    rows = [[*row, floor] for row, floor in zip(size_rows(size), floors, strict=False)]
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


def where_words(gap: Gap) -> str:
    """Say in which sensors, axes, times and frequencies a gap lies; all sensors are not named one by one."""
    where = gap.where
    parts = [sensors_in_words(where.sensors, gap.sensor_count, where.axes)]
    if where.time_s is not None:
        first, last = (fixed(one - gap.origin_s, 2) for one in where.time_s)
        parts.append(f"from {first} to {last} s")
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


_DOES = {
    "offset": "its offset changes",
    "gain": "its gain, or what leaks into it, changes",
    "rate": "its error goes with the field's rate of change",
    "own_field": "its error is a function of its own reading",
    "attitude": "its error is a function of direction",
    "noise": "its noise is larger",
    "samples": "single readings are off",
}
"""What a law does to the readings of a place."""

_MOST_TIMES = 6
"""Times that a sentence lists."""


def law_sentence(law: Signature, gap: Gap, is_caused: bool = False) -> str:
    """Return a law in a sentence or two: where, what, how much, when, its share, and what it goes with.

    Parameters
    ----------
    law : Signature
    gap : Gap
        With the law.
    is_caused : bool
        Whether a cause of the gap was found, which may go with a channel.
    """
    does = _DOES[law.law].replace("its", "their") if len(law.sensors) > 1 and not law.is_common else _DOES[law.law]
    if law.law == "attitude" and law.course != "motion":
        is_gradient = len(law.sensors) > 1 and SCALAR[0] not in law.sensors
        does = "the field differs between them, and changes" if is_gradient else f"{does} that changes"
    place = _place(law, gap.sensor_count)
    words = f"{place}: {does}{_size(law)}{_course(law, gap.origin_s)}, {percent(law.energy)} of the gap."
    if not is_caused and law.course in ("step", "episodes", "slow", "random") and law.law in ("offset", "gain"):
        words += " No recorded channel goes with it."
    others = "" if law.is_common else in_words(law.places[1:], gap.sensor_count, False)
    return words + (f" As far as the data tell it may sit in {others} instead." if others else "")


def _place(law: Signature, sensor_count: int) -> str:
    where = in_words(law.places if law.is_common else law.places[:1], sensor_count, law.is_common)
    axes = f", axis {law.axes[0]}" if len(law.axes) == 1 else ""
    return where[:1].upper() + where[1:] + axes


def _size(law: Signature) -> str:
    if law.curve is None or law.course not in ("step", "episodes", "slow", "random", "channel", "tone"):
        return ""
    span = float(np.ptp(law.curve.size))
    if law.curve.unit == "1":
        return f" by {number(100 * span, 2)} %"
    return f" by {number(to_nanotesla(span), 2)} nT"


def _course(law: Signature, origin_s: float) -> str:
    if law.course in ("step", "episodes") and law.times_s:
        times = [f"{number(time - origin_s, 4)} s" for time in law.times_s[:_MOST_TIMES]]
        more = ", …" if len(law.times_s) > _MOST_TIMES else ""
        if law.course == "step":
            steps = "one step" if len(law.times_s) == 1 else f"{len(law.times_s)} steps"
            return f" in {steps} (at {', '.join(times)}{more})"
        return f" in {(len(law.times_s) + 1) // 2} episodes (from and until {', '.join(times)}{more})"
    if law.course == "channel":
        return f" with the recorded {law.follows}"
    if law.course == "tone":
        return f" with a tone of {law.follows}" if law.follows else " with a tone"
    return {
        "slow": " slowly",
        "step": " in steps",
        "episodes": " in episodes",
        "random": " irregularly" if law.law not in ("noise", "samples") else "",
        "constant": ", the same throughout",
        "motion": {"noise": " in some directions or turns", "rate": ", most in fast turns"}.get(law.law, ""),
    }[law.course]


def causes_sentence(law: Signature, named: Collection[str] = ()) -> str:
    """Return what could make a law, the likeliest first, with what would prove the first ones.

    Parameters
    ----------
    law : Signature
    named : collection of str
        Effects that the answer names.
    """
    causes = causes_of(law, named)
    if not causes:
        return ""
    named = [f"{one.title} ({one.proof})" for one in causes[:4]]
    return f"Causes with this signature: {'; '.join(named)}."


def law_blocks(gap: Gap, is_short: bool = False) -> list[Block]:
    """Return what could make the strongest law, then the other laws, of which the short form leaves out the causes.

    Parameters
    ----------
    gap : Gap
        Whose strongest law ``first_sentence`` says.
    is_short : bool
        Whether to leave out the causes of the other laws.
    """
    words = [causes_sentence(law, gap.named) for law in gap.signature[:1]]
    for law in gap.signature[1:]:
        causes = "" if is_short else causes_sentence(law, gap.named)
        words.append(" ".join(filter(None, (law_sentence(law, gap, bool(gap.causes)), causes))))
    left = [f"What its causes leave: {law_sentence(law, gap)}" for law in gap.remaining]
    return [*(Text(one) for one in words if one), *(Text(one, "doubt") for one in left)]


def first_sentence(gap: Gap) -> str:
    """Return the strongest law in words; empty without one."""
    return law_sentence(gap.signature[0], gap, bool(gap.causes)) if gap.signature else ""
