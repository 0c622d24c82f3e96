"""`tam plan`: the attitudes to record next."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from tam_calibration.cli.plan_turns import plan_turns
from tam_calibration.cli.terminal import PATH, Number, reading, showing_progress, stdout, tolerance_option
from tam_calibration.files import read_array, read_calibration, read_samples
from tam_calibration.files.text_files import to_json
from tam_calibration.fit.coverage import ENOUGH_STANDARD_ERROR, describe
from tam_calibration.fit.plan import Plan, Reach, make_plan, reach_of_turntable, reach_of_vehicle
from tam_calibration.fit.plan_start import PlanStart, start_from_calibration, start_from_nothing, start_from_recording
from tam_calibration.fit.plan_turns import Vehicle
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import field_at
from tam_calibration.model.sensor_errors import PARAMETER_NAMES
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla, to_degrees, to_nanotesla
from tam_calibration.report.formatting import number, sentence

_GROUPS = (
    ("scale factor", "", 1.0),
    ("non-orthogonality", "deg", to_degrees(1.0)),
    ("bias", "nT", to_nanotesla(1.0)),
    ("misalignment", "deg", to_degrees(1.0)),
)
"""Name, unit and factor from SI of each three parameters of a sensor."""

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

    plan: Plan
    start: PlanStart
    reach: Reach
    inclination: float
    inclination_source: str
    samples_per_pose: int

    @property
    def is_enough(self) -> bool:
        """Whether every standard error will be small against the sensor noise."""
        return bool(self.plan.worst[-1] <= ENOUGH_STANDARD_ERROR)


def _print_proposal(console: Console, proposal: Proposal) -> None:
    """Print the poses, the standard errors before and after, and whether they are enough."""
    plan, start = proposal.plan, proposal.start
    if start.note:
        console.print(sentence(start.note))
    console.print(_poses(proposal))
    console.print(_HOW_TO_TURN)
    console.print(_standard_errors(proposal))
    field = f"{number(to_nanotesla(start.model.intensity_T), 6)} nT, {_angle(proposal.inclination)}° down"
    console.print(f"Field: {field} ({proposal.inclination_source}).")
    verdict = "enough" if proposal.is_enough else "not yet enough: plan more poses or samples, or allow larger angles"
    worst = f"{_size(start.worst)} before, {_size(plan.worst[-1])} after all poses"
    limit = number(ENOUGH_STANDARD_ERROR, 1)
    console.print(f"Worst standard error: {worst} (× the sensor noise, at most {limit} wanted): {verdict}.")


def _poses(proposal: Proposal) -> Table:
    plan, reach = proposal.plan, proposal.reach
    table = Table(title=f"Poses to record, {proposal.samples_per_pose} samples each")
    for name in ("pose", "yaw (°)", "pitch (°)", "roll (°)"):
        table.add_column(name, justify="right")
    table.add_column("field points")
    table.add_column("worst standard error then (× noise)", justify="right")
    for order, (pose, worst) in enumerate(zip(plan.poses, plan.worst, strict=True), start=1):
        angles = (_angle(angle) for angle in reach.angles[pose])
        table.add_row(str(order), *angles, describe(reach.directions[pose]), _size(worst))
    return table


def _standard_errors(proposal: Proposal) -> Table:
    table = Table("worst of", title="Standard errors")
    table.add_column("before", justify="right")
    table.add_column("after", justify="right")
    for index, (name, unit, factor) in enumerate(_GROUPS):
        columns = (_worst(errors, index, factor) for errors in _before_and_after(proposal))
        table.add_row(f"{name} ({unit})".replace(" ()", "").replace("deg", "°"), *columns)
    return table


def _before_and_after(proposal: Proposal) -> tuple[FloatArray | None, FloatArray]:
    return proposal.start.standard_errors, proposal.plan.standard_errors


def _worst(standard_errors: FloatArray | None, group: int, factor: float) -> str:
    if standard_errors is None:
        return "open"
    part = standard_errors[:, 3 * group : 3 * group + 3]
    sensor, axis = np.unravel_index(int(np.argmax(part)), part.shape)
    if part[sensor, axis] == 0:
        return "fixed"
    name = PARAMETER_NAMES[3 * group + int(axis)].rsplit(" ", 1)[1]
    return f"{number(factor * float(part[sensor, axis]))} ({name} of sensor {sensor + 1})"


def _degrees(radians: FloatArray) -> list[float]:
    degrees: list[float] = np.round(to_degrees(radians), 6).tolist()
    return degrees


def _angle(radians: float) -> str:
    return f"{round(to_degrees(float(radians)), 1) + 0.0:g}".replace("-", "−")


def _size(worst: float) -> str:
    return number(float(worst)) if np.isfinite(worst) else "open"


def _proposal_to_mapping(proposal: Proposal) -> dict[str, Any]:
    """Return the content of the JSON; what is open is null."""
    plan, start, reach = proposal.plan, proposal.start, proposal.reach
    before, after = (None if errors is None else _sensors(errors) for errors in _before_and_after(proposal))
    poses = [
        dict(zip(("yaw_deg", "pitch_deg", "roll_deg"), _degrees(reach.angles[pose]), strict=True))
        | {"field_direction": reach.directions[pose].tolist(), "worst_standard_error_in_noise": float(worst)}
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
        "standard_errors_before": before,
        "standard_errors_after": after,
    }


def _sensors(standard_errors: FloatArray) -> list[dict[str, Any]]:
    keys = [f"{name.replace('-', '_').replace(' ', '_')}_{unit}".rstrip("_") for name, unit, _ in _GROUPS]
    blocks = []
    for sensor, twelve in enumerate(standard_errors, start=1):
        parts = zip(keys, twelve.reshape(4, 3), (factor for _, _, factor in _GROUPS), strict=True)
        blocks.append({"sensor": sensor} | {key: (factor * part).tolist() for key, part, factor in parts})
    return blocks


_TURN_RATE_DEG_S, _SAMPLE_RATE_HZ = 5.0, 10.0
"""Of a small underwater vehicle, and of samples that are averaged to one in a tenth of a second."""

_ASSUMED_INCLINATION_DEG, _ASSUMED_INTENSITY_NT = 60.0, 50_000.0
"""Of the field where no place is named: those of middle latitudes."""


@click.command()
@click.argument("recording", type=PATH, required=False)
@click.option("--array", "array_path", type=PATH, required=True, help="Array YAML: where the sensors sit, their noise.")
@click.option("--calibration", "calibration_path", type=PATH, help="Calibration YAML, instead of its recording.")
@click.option(
    "--prior",
    "prior_path",
    type=PATH,
    help="Calibration YAML: which turns of a vehicle buy most beside it per minute, as old as it is now.",
)
@click.option("--turn-rate-deg-s", type=Number(0.1, 180), help="Of a vehicle about each axis.  [default: 5]")
@click.option("--sample-rate-hz", type=Number(0.1, 10_000), help="Of its sensors.  [default: 10]")
@click.option("--turntable", help="Step of all axes in degrees, or YAW,PITCH,ROLL; 0 for an axis that does not turn.")
@click.option("--pitch-limit-deg", type=float, help="Of a vehicle that yaws right round.  [default: 0]")
@click.option("--roll-limit-deg", type=float, help="Of such a vehicle.  [default: 0]")
@click.option("--place", help="LAT,LON,DATE: inclination and intensity are those of IGRF there.")
@click.option("--inclination-deg", type=Number(-90, 90), help="Of the field, positive downwards.")
@click.option("--intensity-nT", "intensity_nT", type=Number(15e3, 100e3), help="Where no scalar tells it.")
@click.option("--poses", type=click.IntRange(1, 200), default=12, show_default=True, help="Number of attitudes.")
@click.option("--samples-per-pose", type=click.IntRange(1, 1_000_000), default=100, show_default=True)
@tolerance_option
@click.option("--json", "as_json", is_flag=True, help="Print the plan as JSON.")
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
    inclination_deg: float | None,
    intensity_nT: float | None,
    poses: int,
    samples_per_pose: int,
    tolerance_s: float,
    as_json: bool,
) -> None:
    """Propose the attitudes that shrink the worst standard error most, and tell what the standard errors will then be.

    What RECORDING or a calibration determines counts; without either a whole calibration is planned.
    """
    if place is not None:
        if inclination_deg is not None or intensity_nT is not None:
            raise InputError("--place tells inclination and intensity: leave out --inclination-deg and --intensity-nT")
        inclination_deg, intensity_nT = _field_at(place)
    array = read_array(array_path)
    if prior_path is not None:
        if recording is not None or calibration_path is not None or turntable is not None:
            raise InputError("--prior plans the turns of a vehicle: leave out recording, --calibration and --turntable")
        vehicle = Vehicle(
            from_degrees(pitch_limit_deg or 0.0),
            from_degrees(roll_limit_deg or 0.0),
            from_degrees(turn_rate_deg_s or _TURN_RATE_DEG_S),
            sample_rate_hz or _SAMPLE_RATE_HZ,
        )
        steep = _ASSUMED_INCLINATION_DEG if inclination_deg is None else inclination_deg
        plan_turns(prior_path, array, vehicle, from_degrees(steep), as_json)
        return
    if turn_rate_deg_s is not None or sample_rate_hz is not None:
        raise InputError("--turn-rate-deg-s and --sample-rate-hz go with --prior")
    with showing_progress() as progress:
        start = _start(recording, calibration_path, array, intensity_nT, tolerance_s, progress)
        inclination, source = _inclination(inclination_deg, start)
        reach = _reach(turntable, pitch_limit_deg, roll_limit_deg, inclination)
        field_T = start.model.intensity_T * reach.directions
        task = progress.add_task(f"choosing among {len(field_T)} attitudes", total=poses)
        plan = make_plan(start, field_T, poses, samples_per_pose, lambda done: progress.update(task, completed=done))
    proposal = Proposal(plan, start, reach, inclination, source, samples_per_pose)
    if as_json:
        click.echo(to_json(_proposal_to_mapping(proposal)))
    else:
        _print_proposal(stdout(), proposal)


def _field_at(place: str) -> tuple[float, float]:
    """Return inclination in degrees and intensity in nT of a place."""
    field_T = field_at(place)
    intensity_T = float(np.linalg.norm(field_T))
    return to_degrees(float(np.arcsin(-field_T[2] / intensity_T))), to_nanotesla(intensity_T)


def _start(
    recording_path: Path | None,
    calibration_path: Path | None,
    array: Array,
    intensity_nT: float | None,
    tolerance_s: float,
    progress: Progress,
) -> PlanStart:
    if recording_path is not None and calibration_path is not None:
        raise InputError("give either a recording or --calibration, which tells what its recording determines")
    if calibration_path is not None:
        calibration = read_calibration(calibration_path)
        if not calibration.is_of(array):
            raise InputError(f"{calibration_path} is of another array: use the calibration of this array")
        return start_from_calibration(calibration)
    if recording_path is None:
        return _start_from_nothing(array, intensity_nT)
    source = recording_path, array.sensor_count, tolerance_s, reading(progress), array
    recording = read_samples(*source).recording
    if intensity_nT is not None and recording.scalar_T is None:
        recording = replace(recording, scalar_T=np.full(recording.sample_count, from_nanotesla(intensity_nT)))
    progress.add_task(f"fitting {recording.sample_count} samples", total=None)
    return start_from_recording(recording, array)


def _start_from_nothing(array: Array, intensity_nT: float | None) -> PlanStart:
    if intensity_nT is None:
        start = start_from_nothing(array, from_nanotesla(_ASSUMED_INTENSITY_NT))
        return replace(start, note="the intensity of the field is assumed: give --place or --intensity-nT")
    if array.scalar_noise_T is None:
        array = replace(array, scalar_noise_T=0.0)
    return start_from_nothing(array, from_nanotesla(intensity_nT))


def _inclination(stated_deg: float | None, start: PlanStart) -> tuple[float, str]:
    """Return the inclination in radians, and where it comes from."""
    if stated_deg is not None:
        return from_degrees(stated_deg), "given"
    if start.inclination is not None:
        return start.inclination, "from the recorded attitude"
    return from_degrees(_ASSUMED_INCLINATION_DEG), "assumed: give --place or --inclination-deg"


def _reach(turntable: str | None, pitch_deg: float | None, roll_deg: float | None, inclination: float) -> Reach:
    is_vehicle = pitch_deg is not None or roll_deg is not None
    if is_vehicle == (turntable is not None):
        raise InputError("say what can be reached: either --turntable, or --pitch-limit-deg and --roll-limit-deg")
    if turntable is None:
        return reach_of_vehicle(from_degrees(pitch_deg or 0.0), from_degrees(roll_deg or 0.0), inclination)
    try:
        steps = np.array([float(step) for step in turntable.split(",")])
    except ValueError:
        steps = np.empty(0)
    if len(steps) not in (1, 3):
        raise InputError(
            f"--turntable must be one step in degrees or YAW,PITCH,ROLL such as 30,60,60, not {turntable!r}"
        )
    return reach_of_turntable(from_degrees(np.broadcast_to(steps, 3)), inclination)
