"""What the evidence for a cause, and for no gap, means: sentences for the page and for the terminal."""

import math

from tam_calibration.effects.effect import Sized
from tam_calibration.gap.result import Cause, Gap
from tam_calibration.gap.standing import Standing
from tam_calibration.report.formatting import count, join, number
from tam_calibration.report.gap_rows import percent
from tam_calibration.units import for_people


def cause_words(cause: Cause) -> list[str]:
    """Say how a cause stands among its surrogates, and how large it is beside the largest known."""
    standing = [] if cause.standing is None else [standing_words(cause.standing)]
    return standing + [sized_words(sized) for sized in cause.sizes]


def standing_words(standing: Standing) -> str:
    """Say how a cause stands among its surrogates."""
    gains = f"its gain is {number(standing.gain)}, that of the best surrogate {number(standing.largest)}"
    if standing.gain <= standing.largest:
        return f"{percent(standing.rank)} of its surrogates explain as much or more: {gains}."
    others = round(1 / standing.rank) - 1
    return (
        f"It explains {number(standing.ratio, 2)} times as much as the best of its {count(others)} surrogates, which "
        f"have nothing to do with the residual: {gains}."
    )


def sized_words(sized: Sized) -> str:
    """Say how large a cause is beside the largest known, and who knows."""
    factor, unit = for_people(sized.limit.unit)
    unit = "" if unit == "1" else f" {unit}"
    found, largest = (f"{number(factor * value)}{unit}" for value in (abs(sized.value), sized.limit.largest))
    return f"Its {sized.name} is {found}; the largest known is {largest} ({sized.limit.source})."


def set_words(gap: Gap) -> list[str]:
    """Say which answers hold the true one in 95 of 100 recordings, where that is known."""
    names = [name.replace("_", " ") for name in gap.set_95]
    return [f"In 95 of 100 such recordings the truth is among: {join(names)}."] if names else []


def unseen_words(gap: Gap) -> list[str]:
    """Say which gap would not have been seen, and what it would do to the calibration's parameters at most."""
    if gap.verdict != "no_gap" or math.isnan(gap.smallest_gap):
        return []
    words = f"A gap of less than {number(gap.smallest_gap, 2)} noise floors would not have been seen."
    if math.isfinite(gap.most_unseen_errors):
        words += (
            f" With {count(round(gap.channel_count))} values beyond what the field takes, such a gap moves a parameter "
            f"of the calibration by at most {number(gap.most_unseen_errors, 2)} of its standard errors, which hold "
            "noise alone; the most where all of the gap has the course of that parameter."
        )
    return [words]
