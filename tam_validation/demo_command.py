"""`tam demo`: the complete chain over ROS 2, judged by the truth that was simulated."""

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np
from numpy.linalg import norm
from rich.console import Console

from tam_calibration.cli.nodes import watched
from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import NamedPath, print_blocks
from tam_calibration.model.array import TENSOR_OUTPUTS
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.libraries import require
from tam_calibration.model.sensor_errors import noise_floor
from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_calibration.nodes.session import NODES, Children, node_commands, ros_session
from tam_calibration.recordings import provenance
from tam_calibration.report.blocks import Table
from tam_calibration.results import read_calibration, write_recording
from tam_calibration.results.overwriting import require_outside_bags
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import Simulation, simulate

if TYPE_CHECKING:
    from tam_calibration.nodes.monitor import Monitor

_ACCEPTED_RATIO = 1.05
"""Largest tensor error over the noise floor that counts as success."""


def errors_of(run: Simulation, outputs: FloatArray) -> tuple[float, float]:
    """Return the root mean square errors of |B| at the centre and of the tensor's five components, T and T/m.

    Parameters
    ----------
    run : Simulation
        The N samples with their truth.
    outputs : (N, 9) array
        Estimated centre vector, T, and gradient components xx, xy, xz, yy, yz, zz, T/m, in the array frame.
    """
    true = np.hstack([run.center_field_T, run.gradient_T_per_m[:, *np.triu_indices(3)]])
    intensity = norm(outputs[:, :3], axis=1) - norm(true[:, :3], axis=1)
    tensor = (outputs - true)[:, TENSOR_OUTPUTS]
    return float(np.sqrt(np.mean(intensity**2))), float(np.sqrt(np.mean((tensor**2).sum(axis=1))))


def _floor_of(run: Simulation) -> tuple[float, float]:
    """Return what the sensors' noise alone makes of `errors_of`, whatever the calibration."""
    floor = noise_floor(run.errors, run.scenario.array.with_stated_noise(), scalar_noise_T=0.0)
    return floor.center_intensity_T, floor.tensor_rmse_T_per_m


def raw_outputs(run: Simulation) -> FloatArray:
    """Return the (N, 9) outputs of the raw readings, taken as the field."""
    readings = run.recording.readings_T
    return readings.reshape(len(readings), -1) @ run.scenario.array.operator.T


def _gains_table(run: Simulation, live: FloatArray) -> Table:
    """Return errors before and after, and the noise floor, of the run that the calibration has not seen."""
    names = ("|B| at the centre, nT", "tensor, 5 components, nT/m")
    figures = zip(names, errors_of(run, raw_outputs(run)), errors_of(run, live[:, :9]), _floor_of(run), strict=True)
    rows = [
        [name, *(f"{to_nanotesla(value):.3f}" for value in (before, after, floor)), f"{after / floor:.4f}"]
        for name, before, after, floor in figures
    ]
    header = ("RMS error", "raw", "corrected, live", "noise floor", "ratio")
    return Table(header, rows, f"{len(live)} samples of the second run against the truth")


def require_success(run: Simulation, live: FloatArray) -> None:
    """Check that every sample was corrected, and the tensor error is near the noise floor.

    Parameters
    ----------
    run : Simulation
        The run that was corrected, with its truth.
    live : (M, 18) array
        Rows of ``field_gradient`` that the corrector published: nine outputs, T and T/m, and their standard errors.

    Raises
    ------
    Refused
        With the figures.
    """
    if len(live) != run.recording.sample_count:
        raise Refused(f"{len(live)} of {run.recording.sample_count} samples were corrected")
    ratio = errors_of(run, live[:, :9])[1] / _floor_of(run)[1]
    if not ratio <= _ACCEPTED_RATIO:
        raise Refused(f"the tensor error is {ratio:.3f} times the noise floor, more than {_ACCEPTED_RATIO}")


_SCENARIO = "tumble_100_hz"
CHECK_SAMPLES = 1000
PLAY_RATE = 2.0
"""How much faster than its stamps a bag is played: the complete chain stays under a minute."""
_TIMEOUT_S = 30.0
"""Longest wait for a node: ten times what a start takes on two cores."""


@click.command()
@click.option(
    "-o",
    "--output",
    type=NamedPath(file_okay=False, path_type=Path),
    default=Path("demo_output"),
    show_default=True,
    help="Folder for bags, calibration, page and logs.",
)
def command(output: Path) -> None:
    """Simulate a turning cross array, calibrate it over ROS 2, and test the result on a second run.

    Exits 0 only if the nodes joined every sample, and the tensor error that the corrector published in the second run
    is within 5 % of the noise floor.
    """
    require("bags", "the demonstration")
    require("report", "the demonstration")
    console = Console()
    begin = time.monotonic()
    require_outside_bags(output / "turned.mcap")
    output.mkdir(parents=True, exist_ok=True)
    with console.status("simulating"):
        turned, check = _simulate(output)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")  # other robots shall not meet these nodes
    with ros_session():
        live = _run_nodes(console, output, turned, check)
        _conclude(console, output, turned, check, live)
        console.print(f"{time.monotonic() - begin:.0f} s in all")


def _simulate(output: Path) -> tuple[Simulation, Simulation]:
    """Return the run that is calibrated with, and a later one to judge by; write both as bags."""
    scenario = read_scenario(_SCENARIO)
    turned = simulate(scenario)
    check = simulate(replace(scenario, seed=scenario.seed + 1, sample_count=CHECK_SAMPLES))
    begin_s = 2 * turned.recording.time_s[-1]  # after the last sample of the first run
    later = replace(check.recording, time_s=check.recording.time_s + begin_s)
    check = replace(check, recording=later)
    write_recording(output / "turned.mcap", turned.recording)
    write_recording(output / "check.mcap", check.recording)
    return turned, check


def _run_nodes(console: Console, output: Path, turned: Simulation, check: Simulation) -> FloatArray:
    """Return the rows of ``field_gradient`` of the second run, corrected with the calibration by the first."""
    from tam_calibration.nodes.monitor import call

    calibration_file = output / "calibration.yaml"
    calibration_file.unlink(missing_ok=True)  # of a demonstration before: the calibrator would load it
    logs = output / "logs"
    with Children(node_commands(calibration=calibration_file), logs) as children, watched(console, children) as monitor:
        live, samples = _rows_of(monitor, "field_gradient"), turned.recording.sample_count
        # What is played before a node listens to the collector is lost to it.
        monitor.wait_until(
            lambda: _count(monitor, "collector", "listeners") == len(NODES) - 1, "the start of the nodes", _TIMEOUT_S
        )
        _play(monitor, output / "turned.mcap", logs)
        monitor.wait_until(
            lambda: _count(monitor, "calibrator", "samples") == samples, f"{samples} samples", _TIMEOUT_S
        )
        console.print(f"[bold]calibrator/calibrate[/]  {call('calibrator/calibrate', _TIMEOUT_S)}")
        console.print(f"[bold]calibrator/save[/]       {call('calibrator/save', _TIMEOUT_S)}")
        _play(monitor, output / "check.mcap", logs)
        samples += check.recording.sample_count
        monitor.wait_until(lambda: _count(monitor, "collector", "samples") == samples, f"{samples} samples", _TIMEOUT_S)
        console.print(f"[bold]collector[/]             {monitor.figures('collector')['losses']}")
        if lost := _count(monitor, "collector", "lost"):
            raise Refused(f"{lost} messages were lost: {monitor.figures('collector')['losses']}")
        expected = check.recording.sample_count  # they arrive after the collector has counted them
        monitor.wait_until(lambda: len(live) >= expected, f"{expected} corrected samples", _TIMEOUT_S)
        return np.array(live)


def _count(monitor: "Monitor", name: str, figure: str) -> int | None:
    """Return a figure of a node's status that counts; None where it has none yet."""
    value = monitor.figures(name).get(figure)
    return None if value is None else int(value)


def _rows_of(monitor: "Monitor", topic: str) -> list[FloatArray]:
    """Return the rows of the clouds of a topic: a list that grows while the monitor spins."""
    from sensor_msgs.msg import PointCloud2

    from tam_calibration.nodes.topics import RELIABLE_STREAM, read_cloud

    rows: list[FloatArray] = []
    monitor.create_subscription(PointCloud2, topic, lambda cloud: rows.extend(read_cloud(cloud)[1]), RELIABLE_STREAM)
    return rows


def _play(monitor: "Monitor", bag: Path, logs: Path) -> None:
    command = ["-m", "tam_calibration", "play", str(bag), "--rate", str(PLAY_RATE)]
    with Children({"player": command}, logs) as player:
        monitor.wait_until(lambda: not player.is_running("player"), f"the end of {bag}", 2 * _TIMEOUT_S)


def _conclude(console: Console, output: Path, turned: Simulation, check: Simulation, live: FloatArray) -> None:
    """Show what was gained, write the page, and refuse when the tensor error is above the accepted ratio.

    Raises
    ------
    Refused
        With the figures.
    """
    from tam_calibration.report.calibration_report import write_calibration_report

    calibration = read_calibration(output / "calibration.yaml")
    page = output / "calibration.html"
    with console.status("writing the page"):
        source = provenance(output / "turned.mcap")
        write_calibration_report(page, replace(calibration, source=source), turned.recording)
    print_blocks([_gains_table(check, live)])
    say(f"page: {page}")
    require_success(check, live)
