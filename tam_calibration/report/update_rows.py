"""What a calibration took from the one before it, in words and rows, for the page and for the terminal."""

from itertools import groupby

import numpy as np

from tam_calibration.correction.parts import Moved, Update, in_words
from tam_calibration.model.data_sheet import DAY_S
from tam_calibration.model.sensor_errors import PARAMETER_NAMES
from tam_calibration.report.blocks import Block, Table, Text
from tam_calibration.report.formatting import KINDS, join, number, with_error

_KINDS = {kind.name: kind for kind in KINDS} | {"scale factor": KINDS[0]._replace(factor=1e6, sign="ppm")}
"""Kinds of errors by name; changes of scale factors are told in ppm."""


def update_sentences(update: Update) -> list[str]:
    """Return where the prior came from, whether the data contradict it, and what moved, one sentence each."""
    chance = f"χ² {number(update.chi_square)} for {update.freedom} degrees of freedom"
    if update.rates is None:
        return ["Prior: the tolerances that the array file states.", f"Data against tolerances: {chance}."]
    verdict = "Data and prior agree" if not update.moved else "The data contradict the prior"
    return [
        f"Prior: {update.prior}, {age_in_words(update.elapsed_s)}; {_warming(update)}.",
        f"{verdict}: {chance}.",
        *(_told(list(parts)) for _, parts in groupby(update.moved, key=_change_of)),
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


def _warming(update: Update) -> str:
    if update.warming_K is None:
        return "temperatures unknown, assumed equal"
    return f"warmer by {number(update.warming_K)} K since"


def _change_of(moved: Moved) -> tuple[str, int, float | None]:
    """Return what a part of a change is of: kind, sensor, and since when."""
    return *(moved.together or (moved.kind, moved.sensor)), moved.since_s


def _told(parts: list[Moved]) -> str:
    """Return the sentence of what moved in one piece."""
    moved, kind, sensor = parts[0], *(parts[0].together or (parts[0].kind, parts[0].sensor))
    words = f"The {in_words(kind, sensor)} moved"
    if moved.together is None:
        words += f" by {_values(moved)}"
    elif len(parts) <= 8:  # of more the table of errors says more
        words += " together: " + "; ".join(f"{in_words(part.kind, part.sensor)} by {_values(part)}" for part in parts)
    if moved.since_s is not None:
        words += f", at {moved.since_s:.1f} s of the recording; the calibration is that of the sensors since then"
    if moved.rivals:
        others = join([f"the {in_words(*rival)}" for rival in moved.rivals])
        words += f"; with probability {number(1 - moved.probability, 2)} it was {others}"
    return f"{words}. It was estimated again."


def _values(moved: Moved) -> str:
    kind = _KINDS[moved.kind]
    pairs = zip(kind.factor * moved.change, kind.factor * moved.standard_errors, strict=True)
    values = (with_error(float(value), float(error), 2) for value, error in pairs)
    return f"{', '.join(values)} {kind.sign} ({' '.join(kind.axes)})"
