"""A recording of a vehicle with an array of magnetometers in MuJoCo.

Run ``python examples/mujoco_vehicle.py run.mcap --seed 1``, then what it says.
"""

from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Any

import click
import numpy as np
from vehicle import SWITCHED, VEHICLE, VehicleRun, model_xml, simulate_vehicle

from tam_calibration.cli.simulate import beside
from tam_calibration.cli.terminal import PATH, Number, write_together
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_nanotesla
from tam_calibration.recordings import write_array
from tam_calibration.results import write_recording
from tam_calibration.simulation.conditions import Temperature

SEED = click.IntRange(min=0)


class Numbers(click.ParamType[FloatArray]):
    """So many numbers with commas between them."""

    def __init__(self, *names: str) -> None:
        self.name = ",".join(names)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> FloatArray:
        """Return the (M,) numbers, one for each name, or fail with a sentence."""
        try:
            numbers = np.array([float(word) for word in value.split(",")])
        except ValueError:
            numbers = np.zeros(0)
        if len(numbers) != self.name.count(",") + 1 or not np.isfinite(numbers).all():
            self.fail(f"{value!r} must be the numbers {self.name}.", param, ctx)
        return numbers


@click.command()
@click.argument("output", type=PATH)
@click.option("--seed", type=SEED, default=0, show_default=True, help="Of path and noise.")
@click.option("--noise-seed", type=SEED, help="Of the noise alone, on the path of --seed.")
@click.option("--errors-seed", type=SEED, default=0, show_default=True, help="Of the vehicle's biases.")
@click.option("--samples", type=click.IntRange(2, 1_000_000), default=4000, show_default=True)
@click.option("--rate", type=Number(1, 1000), default=20.0, show_default=True, help="Samples per second.")
@click.option("--baseline", type=Number(0.001), default=0.5, show_default=True, help="Of the cross, metres.")
@click.option("--imu", is_flag=True, help="One sensor and its attitude, without scalar, temperature and current.")
@click.option(
    "--field", type=Numbers("EAST", "NORTH", "UP"), default="1600,18900,-45900", show_default=True, help="nT."
)
@click.option("--peak-turn-rate", type=Number(0.01, 10), default=1.5, show_default=True, help="rad/s.")
@click.option("--noise-nT", "noise_nT", type=Number(0), default=1.0, show_default=True, help="Of each axis.")
@click.option("--scalar-noise-nT", "scalar_noise_nT", type=Number(0), default=0.1, show_default=True)
@click.option("--bias-nT", "bias_nT", type=Number(0), default=0.0, help="Standard deviation of the axes' biases.")
@click.option("--temperature", type=Numbers("START", "END"), default="20,25", show_default=True, help="°C.")
def main(
    output: Path,
    seed: int,
    noise_seed: int | None,
    errors_seed: int,
    samples: int,
    rate: float,
    baseline: float,
    imu: bool,
    field: FloatArray,
    peak_turn_rate: float,
    noise_nT: float,
    scalar_noise_nT: float,
    bias_nT: float,
    temperature: FloatArray,
) -> None:
    """Write the recording OUTPUT, a .csv, a .mcap or a bag's folder, with array file and MuJoCo's model beside it."""
    try:
        positions = np.zeros((1, 3)) if imu else Array.cross(baseline).positions_m
        bias = np.random.default_rng(errors_seed).normal(0, from_nanotesla(bias_nT), positions.shape)
        run = VehicleRun(
            seed,
            noise_seed,
            positions,
            replace(SensorErrors.none(len(positions)), bias_T=bias),
            from_nanotesla(noise_nT),
            None if imu else from_nanotesla(scalar_noise_nT),
            from_nanotesla(field),
            samples,
            rate,
            peak_turn_rate,
            None if imu else Temperature(*temperature),
            None if imu else SWITCHED,
        )
        paths = {"recording": output, "array": beside(output, "array.yaml"), "model": beside(output, "model.xml")}
        with write_together(paths, [VEHICLE]) as places:
            recording, array = simulate_vehicle(run)
            write_recording(places["recording"], recording)
            write_array(places["array"], array)
            places["model"].write_text(model_xml(run))
    except InputError as problem:
        raise click.UsageError(str(problem)) from None
    click.echo(f"next: tam calibrate {quote(str(output))} --array {quote(str(paths['array']))} -o calibration.yaml")


if __name__ == "__main__":
    main()
