"""How calibration answers channels that depend on what it calibrates.

Run ``python benchmarks/dependent_channels.py --half made|judged [--runs 200] [--first-seed 1]``.

Each run is a simulated recording of one to four sensors with random errors, turned in full circles, in swings of a few
degrees, or all round, and calibrated with one channel that is wrong: an attitude that takes its heading from the raw
readings, a late attitude, a scalar beside a magnet or a current, a wrong place, a prior of sensors that have changed,
or a temperature that follows the readings. The rules were made on the kinds ``made`` and are judged on the others.
Counted are runs that are refused, and those whose answer is more than 4 of its standard errors off in any parameter,
with or without a warning. As many sound runs are counted where a channel is left out, a warning is given or the run is
refused although it is calibrated from the true attitude.
"""

from collections.abc import Callable
from dataclasses import replace

import changed_priors
import click
import dependent_kinds
import numpy as np
from dependent_cases import Case, next_day, sound, sound_attitude
from numpy.random import Generator
from rich.progress import track
from scipy.spatial.transform import Rotation
from spread import Row, show

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import calibrate
from tam_calibration.fit.identifiability import require_accurate
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori
from tam_calibration.fit.prior import in_first_frame
from tam_calibration.fit.problem import Known
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.sensor_errors import SensorErrors

FAR = 4.0
"""Standard errors from which an answer is far off."""

MADE: dict[str, Callable[[Generator], Case]] = {
    "AHRS of sensor 1": dependent_kinds.raw,
    "filtered AHRS of sensor 1": dependent_kinds.filtered,
    "AHRS of all sensors": dependent_kinds.mean,
    "AHRS with old biases": dependent_kinds.precorrected,
    "late filtered AHRS": dependent_kinds.late_compass,
    "late attitude": dependent_kinds.late,
    "scalar beside a magnet": dependent_kinds.beside_magnet,
    "scalar beside a current": dependent_kinds.beside_current,
    "wrong place": dependent_kinds.wrong_place,
    "prior of one bias ago": changed_priors.knocked,
    "prior of other sensors": changed_priors.replaced,
    "temperature that leaks": changed_priors.leaking,
    "AHRS that fits a circle": dependent_kinds.circle_fitted,
    "attitude by the field first": dependent_kinds.field_first,
    "gyroscope's scale": dependent_kinds.gyroscope_scale,
    "scalar beside iron": dependent_kinds.beside_iron,
    "scalar's heading error": dependent_kinds.heading_error,
    "wrong declination": dependent_kinds.wrong_declination,
    "prior of a turn or gain ago": changed_priors.turned_since,
    "prior of all sensors ago": changed_priors.exchanged_since,
    "prior of a colder day": changed_priors.heated,
    "prior of another vehicle's field": changed_priors.magnetised,
    "prior that aged faster": changed_priors.aged,
    "prior of a straight frame": changed_priors.bent,
    "prior before a repair": changed_priors.repaired,
}


JUDGED: dict[str, Callable[[Generator], Case]] = {
    "AHRS of another compass": dependent_kinds.another_compass,
    "attitude that feels turns": dependent_kinds.thrown,
    "attitude of other times": dependent_kinds.jittering,
    "scalar beside metal": dependent_kinds.beside_metal,
    "scalar with a dead zone": dependent_kinds.dead_zone,
    "prior before an amplifier": changed_priors.amplified,
    "prior without a magnet aboard": changed_priors.magnet_aboard,
    "prior of a warmer day": changed_priors.cooled,
    "prior before sensors were remounted": changed_priors.remounted,
}


def _sound(rng: Generator) -> Case:
    way = rng.integers(4)
    if way < 2:
        return sound_attitude(rng)
    if way == 2:
        return sound(rng, int(rng.choice([0, 2])))
    pier = sound(rng, 2)
    return next_day(rng, pier, calibrate(pier.recording, pier.array), pier.errors)


def answer(case: Case) -> Calibration | str:
    """Return the calibration of a case, or why it is refused."""
    try:
        return calibrate(case.recording, case.array, prior=case.prior, main_field_T=case.main_field_T)
    except (InputError, Refused) as problem:
        return str(problem)


def distance(calibration: Calibration, errors: SensorErrors) -> float:
    """Return by how many of its standard errors the worst parameter is off."""
    truth, _ = in_first_frame(errors)
    free = calibration.standard_errors > 0
    off = calibration.errors.to_vector() - truth.to_vector()
    return float(np.max(np.abs(off[free]) / calibration.standard_errors[free]))


def changed(case: Case, given: Calibration | str) -> str:
    """Return what a sound run loses: why it is refused though its readings suffice, a warning, or a channel.

    That the run itself saw too little is no loss.
    """
    if not isinstance(given, str):
        warnings = (one for one in given.warnings if "of the sphere" not in one and "record longer" not in one)
        return "; ".join([*warnings, *(note for note in given.notes if "left out" in note or "only its mean" in note)])
    if case.recording.attitude is None:
        return ""
    error = case.rotation.inv() * Rotation.from_quat(case.recording.attitude)
    size = float(np.sqrt(np.mean(error.magnitude() ** 2) / 3))
    lag = float(np.corrcoef(error.as_rotvec()[1:, 0], error.as_rotvec()[:-1, 0])[0, 1])
    size *= np.sqrt((1 + lag) / (1 - lag)) if lag > 0.5 else 1.0
    try:
        require_accurate(
            maximum_a_posteriori(case.recording, replace(case.array, attitude_noise=size), Known()), case.recording
        )
    except (InputError, Refused):
        return ""
    return given


@click.command(help=__doc__)
@click.option("--half", type=click.Choice(["made", "judged"]), required=True)
@click.option("--runs", default=200, show_default=True, help="With a wrong channel, and sound ones.")
@click.option("--first-seed", default=1, show_default=True)
@click.option("--verbose", is_flag=True, help="Print every answer that is far off, and what sound runs lose.")
def main(half: str, runs: int, first_seed: int, verbose: bool) -> None:
    """Count, print a table, and keep it."""
    kinds, rows, far_of_all = MADE if half == "made" else JUDGED, [], []
    for place, (name, make) in enumerate(track(kinds.items(), description=half)):
        refused, far, warned = [], [], []
        for run in range(-(-runs // len(kinds))):
            case = make(np.random.default_rng([first_seed, len(half), place, run]))
            given = answer(case)
            refused.append(isinstance(given, str))
            warned.append(not isinstance(given, str) and bool(given.warnings))
            far.append(not isinstance(given, str) and distance(given, case.errors) > FAR)
            if verbose and far[-1] and not isinstance(given, str):
                print(f"{name} {run}: {distance(given, case.errors):.1f}; {given.warnings}; {given.notes}")
        far_of_all += far
        for figure, values in (("refused", refused), ("warned of", warned), ("more than 4 standard errors off", far)):
            rows.append(Row(f"{half}, {name}", figure, [float(np.mean(values))]))
    rows.append(Row(f"{half}, all", "more than 4 standard errors off", [float(np.mean(far_of_all))], most=0.0))
    lost, far = [], []
    for run in track(range(runs), description="sound"):
        case = _sound(np.random.default_rng([first_seed, len(half), 99, run]))
        given = answer(case)
        loss = changed(case, given)
        lost.append(bool(loss))
        far.append(not isinstance(given, str) and distance(given, case.errors) > FAR)
        if verbose and (loss or far[-1]):
            print(f"sound {run}: {'' if isinstance(given, str) else round(distance(given, case.errors), 1)} {loss}")
    rows.append(Row("sound", "refused, warned of or without a channel", [float(np.mean(lost))], most=0.05))
    rows.append(Row("sound", "more than 4 standard errors off", [float(np.mean(far))]))
    command = f"python benchmarks/dependent_channels.py --half {half} --runs {runs} --first-seed {first_seed}"
    show("Channels that depend on what is calibrated", command, f"dependent_channels_{half}.csv", rows)


if __name__ == "__main__":
    main()
