"""`tam plan`: the attitudes to record next."""

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from rich.progress import Progress

from tam_calibration.array import Array
from tam_calibration.cli.plan_table import Proposal, print_proposal, proposal_to_mapping
from tam_calibration.cli.terminal import PATH, Number, reading, showing_progress, stdout, tolerance_option
from tam_calibration.exceptions import InputError
from tam_calibration.files import read_array, read_calibration, read_samples
from tam_calibration.files.json_text import to_json
from tam_calibration.fit.plan import make_plan
from tam_calibration.fit.reach import Reach, reach_of_turntable, reach_of_vehicle
from tam_calibration.fit.start import Start, start_from_calibration, start_from_nothing, start_from_recording
from tam_calibration.geomagnetic import field_at
from tam_calibration.units import from_degrees, from_nanotesla, to_degrees, to_nanotesla

ASSUMED_INCLINATION_DEG, ASSUMED_INTENSITY_NT = 60.0, 50_000.0


@click.command()
@click.argument("recording", type=PATH, required=False)
@click.option("--array", "array_path", type=PATH, required=True, help="Array YAML: where the sensors sit, their noise.")
@click.option("--calibration", "calibration_path", type=PATH, help="Calibration YAML, instead of its recording.")
@click.option("--turntable", help="Step of all axes in degrees, or YAW,PITCH,ROLL; 0 for an axis that does not turn.")
@click.option("--pitch-limit-deg", type=float, help="Of a vehicle that yaws right round.  [default: 0]")
@click.option("--roll-limit-deg", type=float, help="Of such a vehicle.  [default: 0]")
@click.option("--place", help="LAT,LON,DATE: inclination and intensity are those of IGRF there.")
@click.option("--inclination-deg", type=Number(-90, 90), help="Of the field, positive downwards.")
@click.option("--intensity-nT", "intensity_nT", type=Number(15e3, 100e3), help="Where no scalar tells it.")
@click.option("--poses", type=click.IntRange(min=1), default=12, show_default=True, help="Number of attitudes.")
@click.option("--samples-per-pose", type=click.IntRange(min=1), default=100, show_default=True)
@tolerance_option
@click.option("--json", "as_json", is_flag=True, help="Print the plan as JSON.")
def command(
    recording: Path | None,
    array_path: Path,
    calibration_path: Path | None,
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
    with showing_progress() as progress:
        start = _start(recording, calibration_path, array, intensity_nT, tolerance_s, progress)
        inclination, source = _inclination(inclination_deg, start)
        reach = _reach(turntable, pitch_limit_deg, roll_limit_deg, inclination)
        field_T = start.model.intensity_T * reach.directions
        task = progress.add_task(f"choosing among {len(field_T)} attitudes", total=poses)
        plan = make_plan(start, field_T, poses, samples_per_pose, lambda done: progress.update(task, completed=done))
    proposal = Proposal(plan, start, reach, inclination, source, samples_per_pose)
    if as_json:
        click.echo(to_json(proposal_to_mapping(proposal)))
    else:
        print_proposal(stdout(), proposal)


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
) -> Start:
    if recording_path is not None and calibration_path is not None:
        raise InputError("give either a recording or --calibration, which tells what its recording determines")
    if calibration_path is not None:
        calibration = read_calibration(calibration_path)
        if not calibration.is_of(array):
            raise InputError(f"{calibration_path} is of another array: use the calibration of this array")
        return start_from_calibration(calibration)
    if recording_path is None:
        return _start_from_nothing(array, intensity_nT)
    recording = read_samples(recording_path, array.sensor_count, tolerance_s, reading(progress)).recording
    if intensity_nT is not None and recording.scalar_T is None:
        recording = replace(recording, scalar_T=np.full(recording.sample_count, from_nanotesla(intensity_nT)))
    progress.add_task(f"fitting {recording.sample_count} samples", total=None)
    return start_from_recording(recording, array)


def _start_from_nothing(array: Array, intensity_nT: float | None) -> Start:
    if intensity_nT is None:
        start = start_from_nothing(array, from_nanotesla(ASSUMED_INTENSITY_NT))
        return replace(start, note="the intensity of the field is assumed: give --place or --intensity-nT")
    if array.scalar_noise_T is None:
        array = replace(array, scalar_noise_T=0.0)
    return start_from_nothing(array, from_nanotesla(intensity_nT))


def _inclination(stated_deg: float | None, start: Start) -> tuple[float, str]:
    """Return the inclination in radians, and where it comes from."""
    if stated_deg is not None:
        return from_degrees(stated_deg), "given"
    if start.inclination is not None:
        return start.inclination, "from the recorded attitude"
    return from_degrees(ASSUMED_INCLINATION_DEG), "assumed: give --place or --inclination-deg"


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
