"""The laws of a gap in words: what a disturbance does, where and when, and what could do that."""

import numpy as np

from tam_calibration.gap.laws.law import Signature, causes_of, in_words
from tam_calibration.gap.result import Gap
from tam_calibration.model.units import to_nanotesla
from tam_calibration.report.blocks import Block, Text
from tam_calibration.report.formatting import number
from tam_calibration.report.gap_rows import percent

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


def law_sentence(law: Signature, sensor_count: int, is_caused: bool = False) -> str:
    """Return a law in a sentence or two: where, what, how much, when, its share, and what it goes with.

    Parameters
    ----------
    law : Signature
        Of a gap.
    sensor_count : int
        Number of sensors K.
    is_caused : bool
        Whether a cause of the gap was found, which may go with a channel.
    """
    words = (
        f"{_place(law, sensor_count)}: {_DOES[law.law]}{_size(law)}{_course(law)}, {percent(law.energy)} of the gap."
    )
    if not is_caused and law.course in ("step", "episodes", "slow", "random") and law.law in ("offset", "gain"):
        words += " No recorded channel goes with it."
    others = "" if law.is_common else in_words(law.places[1:], sensor_count, False)
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


def _course(law: Signature) -> str:
    if law.course in ("step", "episodes") and law.times_s:
        times = [f"{number(time, 4)} s" for time in law.times_s[:_MOST_TIMES]]
        more = ", …" if len(law.times_s) > _MOST_TIMES else ""
        if law.course == "step":
            return f" in {'one step' if len(law.times_s) == 1 else f'{len(law.times_s)} steps'} (at {', '.join(times)})"
        return f" in {(len(law.times_s) + 1) // 2} episodes (from and until {', '.join(times)}{more})"
    if law.course == "channel":
        return f" with the recorded {law.follows}"
    if law.course == "tone":
        return f" with a tone of {law.follows}"
    return {
        "slow": " slowly",
        "step": " in steps",
        "episodes": " in episodes",
        "random": " irregularly" if law.law not in ("noise", "samples") else "",
        "constant": ", the same throughout",
        "motion": " in some directions or turns" if law.law == "noise" else "",
    }[law.course]


def causes_sentence(law: Signature) -> str:
    """Return what could make a law, the likeliest first, with what would prove the first ones."""
    causes = causes_of(law)
    if not causes:
        return ""
    named = [f"{one.title} ({one.proof})" for one in causes[:4]]
    return f"Causes with this signature: {'; '.join(named)}."


def law_blocks(gap: Gap, sensor_count: int, is_short: bool = False) -> list[Block]:
    """Return what could make the strongest law, then the other laws, of which the short form leaves out the causes.

    Parameters
    ----------
    gap : Gap
        Whose strongest law ``first_sentence`` says.
    sensor_count : int
        Number of sensors K.
    is_short : bool
        Whether to leave out the causes of the other laws.
    """
    words = [causes_sentence(law) for law in gap.signature[:1]]
    for law in gap.signature[1:]:
        causes = "" if is_short else causes_sentence(law)
        words.append(" ".join(filter(None, (law_sentence(law, sensor_count, bool(gap.causes)), causes))))
    left = [f"What its causes leave: {law_sentence(law, sensor_count)}" for law in gap.remaining]
    return [*(Text(one) for one in words if one), *(Text(one, "doubt") for one in left)]


def first_sentence(gap: Gap, sensor_count: int) -> str:
    """Return the strongest law in words; empty without one."""
    return law_sentence(gap.signature[0], sensor_count, bool(gap.causes)) if gap.signature else ""
