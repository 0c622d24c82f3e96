"""`tam simulate`: make a recording of a known array and field."""

import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from numpy.linalg import norm

from tam_calibration.units import to_nanotesla

if TYPE_CHECKING:
    from tam_calibration.simulation import Simulation


@click.command()
@click.argument("scenario")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True, help="A .csv, a .mcap, or a bag's folder."
)
@click.option("--seed", type=click.IntRange(min=0), help="Of the random numbers, instead of the scenario's.")
@click.option(
    "--storage",
    type=click.Choice(["sqlite3", "mcap"]),
    default="sqlite3",
    show_default=True,
    help="Of a bag's folder.",
)
@click.option("--json", "as_json", is_flag=True, help="Print what was made as JSON.")
def command(scenario: str, output: Path, seed: int | None, storage: str, as_json: bool) -> None:
    """Make the recording of SCENARIO, a file or the name of a shipped one, with array file and truth beside it.

    Shipped are wu_table_1, wu_turntable, tumble_100_hz, auv and warming_up.
    """
    from rich.console import Console

    from tam_calibration.files import write_array, write_recording
    from tam_calibration.files.scenario import read_scenario, write_truth
    from tam_calibration.simulation import simulate

    plan = read_scenario(scenario)
    paths = {"recording": output, "array": beside(output, "array.yaml"), "truth": beside(output, "truth.yaml")}
    with Console(stderr=True).status("simulating") as status:
        made = simulate(plan if seed is None else replace(plan, seed=seed))
        status.update(f"writing {made.recording.sample_count} samples")
        write_recording(output, made.recording, storage)
        write_array(paths["array"], plan.array)
        write_truth(paths["truth"], made)
    result = summary(made) | {name: str(path) for name, path in paths.items()}
    click.echo(json.dumps(result) if as_json else sentences(result))


def beside(output: Path, ending: str) -> Path:
    """Return the path of a file that goes with a recording: run.csv or the folder run gives run.ENDING."""
    stem = output.stem if output.suffix in (".csv", ".mcap") else output.name
    return output.with_name(f"{stem}.{ending}")


def summary(made: "Simulation") -> dict[str, Any]:
    """Return what was made, for programs."""
    recording = made.recording
    optional = ("scalar_T", "temperature_C", "current_A", "attitude")
    return {
        "samples": recording.sample_count,
        "sensors": recording.sensor_count,
        "rate_hz": made.scenario.rate_hz,
        "duration_s": float(np.ptp(recording.time_s)),
        "intensity_nT": float(to_nanotesla(norm(made.center_field_T, axis=1).mean())),
        "channels": [name.partition("_")[0] for name in optional if getattr(recording, name) is not None],
        "seed": made.scenario.seed,
    }


def sentences(result: dict[str, Any]) -> str:
    """Return what was made and what to type next, for people."""
    recording, array = (shlex.quote(result[name]) for name in ("recording", "array"))
    calibration = shlex.quote(str(beside(Path(result["recording"]), "calibration.yaml")))
    channels = f" with {', '.join(result['channels'])}" if result["channels"] else ""
    return (
        f"{result['samples']} samples of {result['sensors']} sensors{channels} in {result['duration_s']:.6g} s, "
        f"field {result['intensity_nT']:.2f} nT, seed {result['seed']}\n"
        f"  {result['recording']}  the recording\n"
        f"  {result['array']}  positions and noise of the sensors\n"
        f"  {result['truth']}  their true errors\n"
        f"next: tam calibrate {recording} --array {array} -o {calibration}"
    )
