"""`tam simulate`: make a recording of a known array and field."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from numpy.linalg import norm
from rich.console import Console

from tam_calibration.cli.terminal import PATH, Answer, answering, next_command, path_option, write_together
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import CHANNELS, Recording, channel_in_words
from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_calibration.recordings import read_recording, write_array
from tam_calibration.recordings.bag_storages import storage_alone
from tam_calibration.report.blocks import Block, Points
from tam_calibration.results import read_calibration, write_recording
from tam_calibration.results.scenario import files_of_scenario, read_scenario, write_truth
from tam_calibration.simulation import Simulation, simulate

if TYPE_CHECKING:
    from tam_calibration.comparison.mend import Mend


@click.command()
@click.argument("scenario", required=False)
@path_option(
    "--from-calibration",
    "Calibration YAML whose array, errors, noise and effects are simulated, instead of the scenario's.",
)
@path_option(
    "--from-comparison", "Corrections that tam compare wrote: added to the scenario's run, or to that of --recording."
)
@path_option(
    "--recording",
    "Recording whose field, attitude, temperature and current the twin gets, instead of a scenario's; "
    "with --from-comparison the simulated run itself.",
)
@click.option("-o", "--output", type=PATH, required=True, help="A .csv, a .mcap, or a bag's folder.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the random numbers, instead of the scenario's.")
@answering
def command(
    scenario: str | None,
    from_calibration_path: Path | None,
    from_comparison_path: Path | None,
    recording_path: Path | None,
    output: Path,
    seed: int | None,
    answer: Answer,
) -> None:
    """Make the recording of SCENARIO, a file or the name of a shipped one, with array file and truth.

    Shipped are wu_table_1, wu_turntable, tumble_100_hz, auv and warming_up. With --from-calibration the twin of a
    calibrated array is made, on the run of SCENARIO or of a recording. With --from-comparison the run of SCENARIO, or a
    recording that another simulator made, gets the effects and the noise that tam compare found missing.
    """
    if from_calibration_path is not None and from_comparison_path is not None:
        raise InputError("--from-calibration and --from-comparison exclude each other")
    given = from_calibration_path or from_comparison_path
    if recording_path is not None and (scenario is not None or given is None):
        raise InputError("--recording takes the place of a scenario, and needs --from-calibration or --from-comparison")
    with answer.files([given, recording_path, output]):
        if scenario is not None:
            result = _simulate(scenario, from_calibration_path, from_comparison_path, output, seed)
        elif recording_path is not None and from_comparison_path is not None:
            result = _mend(from_comparison_path, recording_path, output, seed or 0)
        elif recording_path is not None and from_calibration_path is not None:
            result = _twin(from_calibration_path, recording_path, output, seed or 0)
        else:
            raise InputError(
                "say what to simulate: a scenario, or --from-calibration or --from-comparison with --recording"
            )
        answer.give(result, *_in_words(result))


def _simulate(
    scenario: str, calibration_path: Path | None, mend_path: Path | None, output: Path, seed: int | None
) -> dict[str, Any]:
    inputs = [*files_of_scenario(scenario), *(path for path in (calibration_path, mend_path) if path is not None)]
    paths = {"recording": output, "array": beside(output, "array.yaml"), "truth": beside(output, "truth.yaml")}
    with write_together(paths, inputs) as places, Console(stderr=True).status("simulating") as status:
        plan = read_scenario(scenario)
        if calibration_path is not None:
            calibration = read_calibration(calibration_path)
            plan = replace(plan, array=calibration.array, errors=calibration.errors, effects=calibration.effects)
        made = simulate(plan if seed is None else replace(plan, seed=seed))
        if mend_path is not None:
            from tam_calibration.results.comparison_json import read_mend

            made = _mended(made, read_mend(mend_path))
        status.update(f"writing {made.recording.sample_count} samples")
        write_recording(places["recording"], plan.array.mounting.inverse.turned(made.recording))
        write_array(places["array"], made.scenario.array)
        write_truth(places["truth"], made)
    intensity = norm(made.center_field_T, axis=1)
    summary = _summary(made.recording, intensity, plan.rate_hz, made.scenario.seed)
    return summary | {name: str(path) for name, path in paths.items()}


def _mended(made: Simulation, mend: "Mend") -> Simulation:
    """Return a simulation with what it lacks; its array then states the noise of the mend's recording."""
    from tam_calibration.comparison.additions import mended

    plan, noise = made.scenario, mend.calibration.array
    recording = mended(made.recording, mend, plan.seed, plan.errors)
    array = plan.array.with_noise(noise.vector_noise_T, noise.scalar_noise_T)
    return replace(made, recording=recording, scenario=replace(plan, array=array, effects=plan.effects + mend.added))


def _twin(calibration_path: Path, run_path: Path, output: Path, seed: int) -> dict[str, Any]:
    from tam_calibration.effects.removal import agreed_field
    from tam_calibration.simulation.observe import twin

    calibration = read_calibration(calibration_path)
    array = calibration.array
    made, paths = _on_run(lambda run: twin(calibration, run, seed), calibration_path, array, run_path, output)
    field = agreed_field(made.readings_T, calibration.errors, array)
    return _summary(made, norm(field, axis=1), _rate_hz(made), seed) | paths | {"truth": str(calibration_path)}


def _mend(mend_path: Path, run_path: Path, output: Path, seed: int) -> dict[str, Any]:
    from tam_calibration.comparison.additions import mended
    from tam_calibration.results.comparison_json import read_mend

    mend = read_mend(mend_path)
    array = mend.calibration.array
    made, paths = _on_run(lambda run: mended(run, mend, seed), mend_path, array, run_path, output)
    intensity = norm(made.readings_T, axis=2).mean(axis=1)
    return _summary(made, intensity, _rate_hz(made), seed) | paths | {"mend": str(mend_path)}


def _on_run(
    make: Callable[[Recording], Recording], given: Path, array: Array, run_path: Path, output: Path
) -> tuple[Recording, dict[str, str]]:
    """Return what is made of the run of a recording, and the paths of the recording and array file written."""
    paths = {"recording": output, "array": beside(output, "array.yaml")}
    with write_together(paths, [given, run_path]) as places, Console(stderr=True).status("simulating") as status:
        made = make(read_recording(run_path, array.sensor_count, array=replace(array, delay_s=None)))
        status.update(f"writing {made.sample_count} samples")
        write_recording(places["recording"], array.mounting.inverse.turned(made))
        write_array(places["array"], array)
    return made, {name: str(path) for name, path in paths.items()}


def _rate_hz(recording: Recording) -> float:
    return float(1 / np.median(np.diff(recording.time_s))) if recording.sample_count > 1 else float("nan")


def beside(output: Path, ending: str) -> Path:
    """Return the path of a file that goes with a recording: run.csv or the folder run gives run.ENDING.

    Parameters
    ----------
    output : Path
        Path of the recording.
    ending : str
        Last part of the name, such as ``array.yaml``.

    Raises
    ------
    InputError
        When the path names no file.
    """
    if not output.name:
        raise InputError(f"{output} names no recording to write: give a .csv, a .mcap, or a bag's folder")
    stem = output.stem if output.suffix == ".csv" or storage_alone(output) else output.name
    return output.with_name(f"{stem}.{ending}")


def _summary(recording: Recording, intensity_T: FloatArray, rate_hz: float, seed: int) -> dict[str, Any]:
    """Return what was made, for programs."""
    present = [name for name in CHANNELS if recording.channel(name) is not None]
    return {
        "samples": recording.sample_count,
        "sensors": recording.sensor_count,
        "rate_hz": rate_hz,
        "duration_s": float(np.ptp(recording.time_s)),
        "intensity_nT": float(to_nanotesla(intensity_T.mean())),
        "channels": [channel_in_words(name) for name in (*present, *recording.further)],
        "seed": seed,
    }


def _in_words(result: dict[str, Any]) -> tuple[str, list[Block], None, str]:
    """Return what was made in a line, its files, and the command that uses them."""
    recording, array = result["recording"], result["array"]
    if "mend" in result:
        source = f"{result['mend']}  what was added"
        words = ["compare", recording, "RECORDING", "--array", array]
    else:
        source = f"{result['truth']}  their true errors"
        words = ["calibrate", recording, "--array", array, "-o", str(beside(Path(recording), "calibration.yaml"))]
    channels = f" with {', '.join(result['channels'])}" if result["channels"] else ""
    first = (
        f"{result['samples']} samples of {result['sensors']} sensors{channels} in {result['duration_s']:.6g} s, "
        f"field {result['intensity_nT']:.2f} nT, seed {result['seed']}"
    )
    described = (f"{recording}  the recording", f"{array}  positions and noise of the sensors")
    return first, [Points((*described, source))], None, next_command(*words)
