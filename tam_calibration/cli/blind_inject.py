"""`tam blind inject`: a known effect in a real recording."""

from dataclasses import replace
from pathlib import Path

import click

from tam_calibration.cli.terminal import PATH, Number, write_together
from tam_calibration.exceptions import InputError
from tam_calibration.files import read_array, read_recording
from tam_calibration.files.csv_recording import write_csv_recording

EFFECTS = (
    "temperature_drift",
    "current_interference",
    "bias_jump",
    "time_skew",
    "periodic_interference",
    "outliers",
    "noise_excess",
    "hysteresis",
    "nonlinearity",
    "quantization",
    "saturation",
    "stale_samples",
)


@click.command()
@click.argument("recording", type=PATH)
@click.option("--array", type=PATH, required=True, help="Array YAML of the recording.")
@click.option("--effect", type=click.Choice(EFFECTS), required=True)
@click.option(
    "--times",
    type=Number(0, 1e6, min_open=True),
    default=1.0,
    show_default=True,
    help="Visible size over what the recording leaves by itself.",
)
@click.option("-o", "--output", type=PATH, required=True, help="CSV to write; the truth goes to .key.json beside it.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
def inject(recording: Path, array: Path, effect: str, times: float, output: Path, seed: int) -> None:
    """Put an effect into a real RECORDING, made by the check's own physics and not the library's.

    Its visible size is so many times the residual that the recording leaves by itself. Where the effect follows a
    temperature or a current, the column is made up and added.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    from tam_calibration.blind.folder import write_json
    from tam_calibration.blind.injected import inject as put

    if output.suffix != ".csv":
        raise InputError(f"{output} must end in .csv")
    real = read_recording(recording)
    sensors = read_array(array).sensor_count
    if sensors != real.sensor_count:
        raise InputError(f"{recording} holds {real.sensor_count} sensors, but {array} describes {sensors}")
    attitude = real.attitude if real.attitude is not None and np.isfinite(real.attitude).all() else None
    to_world = None if attitude is None else Rotation.from_quat(attitude).as_matrix()
    made = put(real.time_s, real.readings_T, to_world, effect, times, seed)
    channels = {"temperature_C": made.temperature_C, "current_A": made.current_A}
    own = {name: values for name, values in channels.items() if values is not None}
    with write_together({"data": output, "key": output.with_suffix(".key.json")}, [recording, array]) as beside:
        write_csv_recording(beside["data"], replace(real, readings_T=made.readings_T, **own))
        write_json(beside["key"], {"recording": recording.name, **made.key})
    visible_nT, own_nT = made.key["visible_nT"], made.key["own_residual_nT"]
    click.echo(
        f"{effect} of {visible_nT:.3g} nT in {output}, {times:g} times the {own_nT:.3g} nT that the recording leaves "
        f"by itself; the truth is in {output.with_suffix('.key.json')}"
    )
