"""`tam compare`: compare a simulator's recording with a real one, and write corrections for the simulator."""

from dataclasses import replace
from pathlib import Path

import click

from tam_calibration.cli import terminal
from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import Answer, answering
from tam_calibration.comparison import compare
from tam_calibration.comparison.result import Comparison
from tam_calibration.recordings import provenance
from tam_calibration.recordings.channel_map import AS_IT_IS, Reading, read_map
from tam_calibration.recordings.fit_input import read_array_of, read_compared
from tam_calibration.report import comparison_rows
from tam_calibration.report.blocks import Block
from tam_calibration.results.comparison_json import comparison_to_mapping, write_mend


@click.command()
@click.argument("simulation", type=terminal.PATH)
@click.argument("recording", type=terminal.PATH)
@terminal.array_option
@terminal.path_option(
    "--array-of-simulation", "Array YAML of the simulation, if it differs; it needs the same number of sensors."
)
@terminal.path_option("--report", "Write an HTML page: what differs, drawn, and corrections to copy.")
@terminal.path_option("--mend", "Write what the simulation lacks, for tam simulate --from-comparison.")
@terminal.path_option("--map-of-simulation", "Map YAML of the simulation, if its names differ.")
@terminal.reading_options
@answering
def command(
    simulation: Path,
    recording: Path,
    array_path: Path,
    array_of_simulation_path: Path | None,
    report_path: Path | None,
    mend_path: Path | None,
    map_of_simulation_path: Path | None,
    how: Reading,
    answer: Answer,
) -> None:
    """Compare SIMULATION, recorded from your simulator, with RECORDING, and write corrections for the simulator.

    Each may have any format; path, length, rate and site may differ. Exits 0 when they are the same, 1 when they
    differ or it cannot be decided, 2 on bad input.
    """
    inputs = [simulation, recording, array_path, array_of_simulation_path, map_of_simulation_path, *how.files]
    simulated_map = None if map_of_simulation_path is None else read_map(map_of_simulation_path)
    simulated_how = replace(AS_IT_IS, channel_map=simulated_map, tolerance_s=how.tolerance_s)
    with terminal.graded(answer.is_json), answer.files(inputs, report=report_path, mend=mend_path) as places:
        comparison = _compare(simulation, recording, array_path, array_of_simulation_path, simulated_how, how)
        sources = provenance(simulation), provenance(recording)
        if "report" in places:
            from tam_calibration.report.comparison_report import write_comparison_report

            write_comparison_report(places["report"], comparison, *sources)
        if comparison.mend is None:
            places.pop("mend", None)
        elif "mend" in places:
            write_mend(places["mend"], comparison.mend)
        answer.give(
            comparison_to_mapping(comparison, *sources),
            comparison_rows.answer(comparison),
            comparison_rows.summary_blocks(comparison),
            _tables(comparison),
            "" if comparison.verdict == "same" else comparison_rows.next_words(comparison),
        )
    if mend_path is not None and comparison.mend is None and not answer.is_json:
        say(f"not written: {mend_path}, as nothing was compared")
    raise click.exceptions.Exit(0 if comparison.verdict == "same" else 1)


def _compare(
    simulation: Path,
    recording: Path,
    array_path: Path,
    simulated_array_path: Path | None,
    simulated_how: Reading,
    how: Reading,
) -> Comparison:
    """Return the comparison of two files, with remarks on how their samples were joined."""
    array = read_array_of("recording", array_path, recording)
    simulated = array if simulated_array_path is None else read_array_of("simulation", simulated_array_path, simulation)
    with terminal.showing_progress() as progress:
        begun = terminal.working(progress, "reading the simulation"), terminal.reading(progress)
        theirs, remarks_on_theirs = read_compared("simulation", simulation, simulated, simulated_how, begun[0])
        source, remarks = read_compared("recording", recording, array, how, begun[1])
        going_on = terminal.progress_of(progress, "comparing")
        comparison = compare(theirs, source, array, array_of_simulation=simulated, progress=going_on)
    return replace(comparison, remarks=(*remarks_on_theirs, *remarks, *comparison.remarks))


def _tables(comparison: Comparison) -> list[Block]:
    return [
        *comparison_rows.mistake_blocks(comparison),
        *comparison_rows.difference_blocks(comparison),
        *comparison_rows.noise_blocks(comparison),
        *comparison_rows.closing_blocks(comparison),
    ]
