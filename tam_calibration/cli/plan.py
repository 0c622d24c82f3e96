"""`tam plan`: the attitudes to record next; with a prior the turns of a vehicle, by what they buy per minute."""

from dataclasses import dataclass, replace
from pathlib import Path
from time import time
from typing import Any

import click
import numpy as np
from rich.progress import Progress

from tam_calibration.cli import terminal
from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import Answer, answering, next_command
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import plan as planning
from tam_calibration.fit.coverage import ENOUGH_STANDARD_ERROR, describe
from tam_calibration.fit.prior import prior_of
from tam_calibration.fit.turns import Turn, Vehicle, best_turns, excess_of
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import field_at
from tam_calibration.model.sensor_errors import PARAMETER_NAMES
from tam_calibration.model.units import ERROR_KINDS, FloatArray, from_degrees, to_degrees, to_nanotesla
from tam_calibration.recordings import read_array
from tam_calibration.recordings.channel_map import Reading
from tam_calibration.recordings.fit_input import read_source
from tam_calibration.report.blocks import Block, Table, Text, number, sentence
from tam_calibration.report.calibration_rows import age_in_words
from tam_calibration.results import read_calibration

_MOST_SHOWN = 8
"""Turns that are shown: later ones gain less."""


def plan_turns(path: Path, array: Array, vehicle: Vehicle, inclination: float, answer: Answer) -> None:
    """Answer which turns add most to a calibration at its present age.

    Raises
    ------
    InputError
        When the calibration is of another array, or is no prior.
    """
    prior = prior_of(_read_calibration(path, array), time(), None, array.change_rates)
    turns = best_turns(prior, vehicle, inclination, array.gyroscope)
    before = excess_of(prior, prior.covariance)
    first = (
        f"Now, with a prior {age_in_words(prior.elapsed_s)}: the uncertainty of the calibration adds "
        f"{_percent(before)} to the noise variance of field and tensor."
    )
    content = {"excess_before": before, "turns": [_to_mapping(turn) for turn in turns]}
    advice = next_command("calibrate", "RECORDING", "--prior", path)
    answer.give(content, first, [_table_of(turns[:_MOST_SHOWN])], advice=advice)


def _read_calibration(path: Path, array: Array) -> Calibration:
    calibration = read_calibration(path)
    if not calibration.is_of(array):
        raise InputError(f"{path} is of another array: use the calibration of this array")
    return calibration


def _table_of(turns: list[Turn]) -> Table:
    rows = []
    for turn in turns:
        yaw, pitch, roll = (to_degrees(angle) for angle in (turn.yaw, turn.pitch, turn.roll))
        swings = (f"±{number(angle)}" if angle else "level" for angle in (pitch, roll))
        gain = _percent(turn.gain_per_minute)
        rows.append([number(yaw), *swings, number(turn.duration_s), _percent(turn.excess), gain])
    header = ("heading turns by (°)", "pitch (°)", "roll (°)", "takes (s)", "adds then", "less per minute")
    return Table(header, rows, "Turns, the one that gains most per minute first")


def _percent(part: float) -> str:
    return f"{number(100 * part)} %"


def _to_mapping(turn: Turn) -> dict[str, Any]:
    return {
        **_angles(turn.yaw, turn.pitch, turn.roll),
        "duration_s": turn.duration_s,
        "excess_after": turn.excess,
        "gain_per_minute": turn.gain_per_minute,
    }


def _angles(*radians: float) -> dict[str, float]:
    return dict(zip(("yaw_deg", "pitch_deg", "roll_deg"), map(to_degrees, radians), strict=True))


_HOW_TO_TURN = (
    "From level and facing magnetic north: yaw to the left, then pitch the nose down, then roll the right side down. "
    "The first pose helps most. Any other attitude in which the field points the same way serves as well."
)


@dataclass(frozen=True, eq=False)
class Proposal:
    """A plan and what it was made from.

    Parameters
    ----------
    plan : Plan
        The chosen attitudes and their promise.
    start : Start
        What was known before.
    reach : Reach
        The attitudes to choose from.
    inclination : float
        Of the field, radians.
    inclination_source : str
        Where that comes from.
    samples_per_pose : int
        Samples at each attitude.
    """

    plan: planning.Plan
    start: planning.PlanStart
    reach: planning.Reach
    inclination: float
    inclination_source: str
    samples_per_pose: int

    @property
    def is_enough(self) -> bool:
        """Whether every standard error will be small against the sensor noise."""
        return bool(self.plan.worst[-1] <= ENOUGH_STANDARD_ERROR)


def _give(proposal: Proposal, answer: Answer) -> None:
    """Answer with the poses, the standard errors before and after, and whether they are enough."""
    plan, start = proposal.plan, proposal.start
    field = f"{number(to_nanotesla(start.model.intensity_T), 6)} nT, {_angle(proposal.inclination)}° down"
    verdict = "enough" if proposal.is_enough else "not yet enough: plan more poses or samples, or allow larger angles"
    worst = f"{_size(start.worst)} before, {_size(plan.worst[-1])} after all poses"
    limit = number(ENOUGH_STANDARD_ERROR, 1)
    first = f"Worst standard error: {worst} (× the sensor noise, at most {limit} wanted): {verdict}."
    blocks: list[Block] = [Text(sentence(start.note))] if start.note else []
    blocks += (
        _poses(proposal),
        Text(_HOW_TO_TURN),
        _standard_errors(proposal),
        Text(f"Field: {field} ({proposal.inclination_source})."),
    )
    answer.give(_proposal_to_mapping(proposal), first, blocks, advice="record them, then tam calibrate RECORDING")


def _poses(proposal: Proposal) -> Table:
    plan, reach = proposal.plan, proposal.reach
    rows = [
        [str(order), *map(_angle, reach.angles[pose]), describe(reach.directions[pose]), _size(worst)]
        for order, (pose, worst) in enumerate(zip(plan.poses, plan.worst, strict=True), start=1)
    ]
    header = ("pose", "yaw (°)", "pitch (°)", "roll (°)", "field points", "worst standard error then (× noise)")
    return Table(header, rows, f"Poses to record, {proposal.samples_per_pose} samples each")


def _standard_errors(proposal: Proposal) -> Table:
    states = proposal.start.standard_errors, proposal.plan.standard_errors
    rows = [
        [f"{kind.name} ({kind.sign})".removesuffix(" ()"), *(_worst(errors, index, kind.factor) for errors in states)]
        for index, kind in enumerate(ERROR_KINDS)
    ]
    return Table(("worst of", "before", "after"), rows, "Standard errors")


def _worst(standard_errors: FloatArray | None, group: int, factor: float) -> str:
    if standard_errors is None:
        return "open"
    part = standard_errors[:, 3 * group : 3 * group + 3]
    sensor, axis = np.unravel_index(int(np.argmax(part)), part.shape)
    if part[sensor, axis] == 0:
        return "fixed"
    name = PARAMETER_NAMES[3 * group + int(axis)].rsplit(" ", 1)[1]
    return f"{number(factor * float(part[sensor, axis]))} ({name} of sensor {sensor + 1})"


def _angle(radians: float) -> str:
    return f"{round(to_degrees(float(radians)), 1) + 0.0:g}".replace("-", "−")


def _size(worst: float) -> str:
    return number(float(worst)) if np.isfinite(worst) else "open"


def _proposal_to_mapping(proposal: Proposal) -> dict[str, Any]:
    """Return the content of the JSON; what is open is null."""
    plan, start, reach = proposal.plan, proposal.start, proposal.reach
    errors = start.standard_errors
    poses = [
        {
            **{name: round(angle, 6) for name, angle in _angles(*reach.angles[pose].tolist()).items()},
            "field_direction": reach.directions[pose].tolist(),
            "worst_standard_error_in_noise": float(worst),
        }
        for pose, worst in zip(plan.poses, plan.worst, strict=True)
    ]
    return {
        "field": {
            "intensity_nT": to_nanotesla(start.model.intensity_T),
            "inclination_deg": to_degrees(proposal.inclination),
            "inclination_source": proposal.inclination_source,
        },
        "note": start.note,
        "samples_per_pose": proposal.samples_per_pose,
        "poses": poses,
        "worst_standard_error_in_noise": {"before": start.worst, "after": float(plan.worst[-1])},
        "enough": proposal.is_enough,
        "standard_errors_before": None if errors is None else _sensors(errors),
        "standard_errors_after": _sensors(plan.standard_errors),
    }


def _sensors(standard_errors: FloatArray) -> list[dict[str, Any]]:
    blocks = []
    for sensor, twelve in enumerate(standard_errors, start=1):
        parts = zip(ERROR_KINDS, twelve.reshape(4, 3), strict=True)
        blocks.append({"sensor": sensor} | {kind.key(): (kind.factor * part).tolist() for kind, part in parts})
    return blocks


_TURN_RATE_DEG_S, _SAMPLE_RATE_HZ = 5.0, 10.0
"""Of a small underwater vehicle, and of samples that are averaged to one in a tenth of a second."""

_ASSUMED_INCLINATION, _ASSUMED_INTENSITY_T = from_degrees(60.0), 50e-6
"""Of the field where no place is named: those of middle latitudes."""


@click.command()
@click.argument("recording", type=terminal.PATH, required=False)
@terminal.array_option
@terminal.path_option("--calibration", "Calibration YAML instead of a recording.")
@terminal.path_option(
    "--prior", "Calibration YAML at its present age: rank a vehicle's turns by what they add per minute."
)
@click.option(
    "--turn-rate-deg-s", type=terminal.Number(0.1, 180), help="Turn rate of a vehicle about each axis.  [default: 5]"
)
@click.option("--sample-rate-hz", type=terminal.Number(0.1, 10_000), help="Sample rate of its sensors.  [default: 10]")
@click.option("--turntable", help="Steps of a turntable, degrees: one for all, or YAW,PITCH,ROLL; 0 for a fixed axis.")
@click.option("--pitch-limit-deg", type=float, help="Pitch limit of a vehicle with full yaw.  [default: 0]")
@click.option("--roll-limit-deg", type=float, help="Roll limit of a vehicle with full yaw.  [default: 0]")
@click.option("--place", help="LAT,LON,DATE: take inclination and intensity from IGRF.")
@click.option("--poses", type=click.IntRange(1, 200), default=12, show_default=True, help="Number of attitudes.")
@click.option("--samples-per-pose", type=click.IntRange(1, 1_000_000), default=100, show_default=True)
@terminal.reading_options
@answering
def command(
    recording: Path | None,
    array_path: Path,
    calibration_path: Path | None,
    prior_path: Path | None,
    turn_rate_deg_s: float | None,
    sample_rate_hz: float | None,
    turntable: str | None,
    pitch_limit_deg: float | None,
    roll_limit_deg: float | None,
    place: str | None,
    poses: int,
    samples_per_pose: int,
    how: Reading,
    answer: Answer,
) -> None:
    """Propose the attitudes that reduce the worst standard error most, and predict the standard errors.

    The plan adds to what RECORDING or a calibration determines; without either, it is a complete calibration.
    """
    field_T = None if place is None else field_at(place)
    array = read_array(array_path)
    if prior_path is not None:
        if recording is not None or calibration_path is not None or turntable is not None:
            raise InputError("--prior plans the turns of a vehicle: leave out recording, --calibration and --turntable")
        limits = from_degrees(pitch_limit_deg or 0.0), from_degrees(roll_limit_deg or 0.0)
        rates = from_degrees(turn_rate_deg_s or _TURN_RATE_DEG_S), sample_rate_hz or _SAMPLE_RATE_HZ
        inclination = _ASSUMED_INCLINATION if field_T is None else _inclination_of(field_T)
        with answer.files([prior_path, array_path]):
            plan_turns(prior_path, array, Vehicle(*limits, *rates), inclination, answer)
        return
    if turn_rate_deg_s is not None or sample_rate_hz is not None:
        raise InputError("--turn-rate-deg-s and --sample-rate-hz go with --prior")
    with answer.files([recording, calibration_path, array_path, *how.files]):
        with terminal.showing_progress() as progress:
            start = _start(recording, calibration_path, array, field_T, how, progress)
            inclination, source = _inclination(field_T, start)
            reach = _reach(turntable, pitch_limit_deg, roll_limit_deg, inclination)
            fields_T = start.model.intensity_T * reach.directions
            task = progress.add_task(f"choosing among {len(fields_T)} attitudes", total=poses)
            plan = planning.make_plan(
                start, fields_T, poses, samples_per_pose, lambda done: progress.update(task, completed=done)
            )
        _give(Proposal(plan, start, reach, inclination, source, samples_per_pose), answer)


def _inclination_of(field_T: FloatArray) -> float:
    """Return the inclination of a field (3,) east, north, up, radians."""
    return float(np.arcsin(-field_T[2] / np.linalg.norm(field_T)))


def _start(
    recording_path: Path | None,
    calibration_path: Path | None,
    array: Array,
    field_T: FloatArray | None,
    how: Reading,
    progress: Progress,
) -> planning.PlanStart:
    if recording_path is not None and calibration_path is not None:
        raise InputError("give either a recording or --calibration, which states what its recording determines")
    if calibration_path is not None:
        return planning.start_from_calibration(_read_calibration(calibration_path, array))
    if recording_path is None:
        if field_T is None:
            start = planning.start_from_nothing(array, _ASSUMED_INTENSITY_T)
            return replace(start, note="the intensity of the field is assumed: give --place")
        known = array if array.scalar_noise_T is not None else replace(array, scalar_noise_T=0.0)
        return planning.start_from_nothing(known, float(np.linalg.norm(field_T)))
    source, usage = read_source(recording_path, array, how, terminal.reading(progress))
    recording = source.whole()
    for remark in usage.missing:
        say(f"warning: {remark}", err=True)
    if field_T is not None and recording.scalar_T is None:
        recording = replace(recording, scalar_T=np.full(recording.sample_count, np.linalg.norm(field_T)))
    progress.add_task(f"fitting {recording.sample_count} samples", total=None)
    return planning.start_from_recording(recording, array)


def _inclination(field_T: FloatArray | None, start: planning.PlanStart) -> tuple[float, str]:
    """Return the inclination in radians, and where it comes from."""
    if field_T is not None:
        return _inclination_of(field_T), "of the place"
    if start.inclination is not None:
        return start.inclination, "from the recorded attitude"
    return _ASSUMED_INCLINATION, "assumed: give --place"


def _reach(
    turntable: str | None, pitch_deg: float | None, roll_deg: float | None, inclination: float
) -> planning.Reach:
    is_vehicle = pitch_deg is not None or roll_deg is not None
    if is_vehicle == (turntable is not None):
        raise InputError("say what can be reached: either --turntable, or --pitch-limit-deg and --roll-limit-deg")
    if turntable is None:
        return planning.reach_of_vehicle(from_degrees(pitch_deg or 0.0), from_degrees(roll_deg or 0.0), inclination)
    form = "one step in degrees or YAW,PITCH,ROLL such as 30,60,60"
    steps = terminal.numbers_in("--turntable", form, turntable, (1, 3))
    return planning.reach_of_turntable(from_degrees(np.broadcast_to(steps, 3)), inclination)
