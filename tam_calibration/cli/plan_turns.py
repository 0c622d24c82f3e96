"""The part of `tam plan` that starts from a prior: the turns of a vehicle, by what they buy per minute."""

from pathlib import Path
from time import time
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from tam_calibration.cli.terminal import stdout
from tam_calibration.files import read_calibration
from tam_calibration.files.text_files import to_json
from tam_calibration.fit.plan_turns import Turn, Vehicle, best_turns, excess_of
from tam_calibration.fit.prior import Prior, prior_of
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import to_degrees
from tam_calibration.report.formatting import number
from tam_calibration.report.update_rows import age_in_words

_MOST_SHOWN = 8
"""Turns that are told: those after them buy less."""


def plan_turns(path: Path, array: Array, vehicle: Vehicle, inclination: float, as_json: bool) -> None:
    """Print which turns buy most, beside a calibration that is as old as it is now.

    Raises
    ------
    InputError
        When the calibration is of another array, or is no prior.
    """
    calibration = read_calibration(path)
    if not calibration.is_of(array):
        raise InputError(f"{path} is of another array: use the calibration of this array")
    prior = prior_of(calibration, time(), None, array.change_rates)
    turns = best_turns(prior, vehicle, inclination)
    before = excess_of(prior, prior.covariance)
    if as_json:
        click.echo(to_json({"excess_before": before, "turns": [_to_mapping(turn) for turn in turns]}))
        return
    _print(stdout(), prior, before, turns[:_MOST_SHOWN])


def _print(console: Console, prior: Prior, before: float, turns: list[Turn]) -> None:
    console.print(
        f"Now, beside a prior {age_in_words(prior.elapsed_s)}: what is not known of the calibration adds "
        f"{_percent(before)} to the variance of field and tensor that the noise makes."
    )
    table = Table(title="Turns, the one that buys most per minute first")
    for name in ("heading turns by (°)", "pitch (°)", "roll (°)", "takes (s)", "adds then", "less per minute"):
        table.add_column(name, justify="right")
    for turn in turns:
        yaw, pitch, roll = (to_degrees(angle) for angle in (turn.yaw, turn.pitch, turn.roll))
        swings = (f"±{number(angle)}" if angle else "level" for angle in (pitch, roll))
        gain = _percent(turn.gain_per_minute)
        table.add_row(number(yaw), *swings, number(turn.duration_s), _percent(turn.excess), gain)
    console.print(table)


def _percent(part: float) -> str:
    return f"{number(100 * part)} %"


def _to_mapping(turn: Turn) -> dict[str, Any]:
    return {
        "yaw_deg": to_degrees(turn.yaw),
        "pitch_deg": to_degrees(turn.pitch),
        "roll_deg": to_degrees(turn.roll),
        "duration_s": turn.duration_s,
        "excess_after": turn.excess,
        "gain_per_minute": turn.gain_per_minute,
    }
