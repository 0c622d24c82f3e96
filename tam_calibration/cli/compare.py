"""`tam compare`: compare a simulator's recording with a real one, and write corrections for the simulator."""

from dataclasses import replace
from pathlib import Path

import click

from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import (
    PATH,
    Detail,
    answer_options,
    graded,
    print_answer,
    progress_of,
    reading_options,
    showing_progress,
    working,
    write_together,
)
from tam_calibration.comparison import compare
from tam_calibration.comparison.result import Comparison
from tam_calibration.files.text_files import to_json
from tam_calibration.recordings import provenance
from tam_calibration.recordings.channel_map import read_map
from tam_calibration.recordings.compared_recordings import read_array_of, read_compared
from tam_calibration.recordings.reading import AS_IT_IS, Reading
from tam_calibration.report import comparison_rows
from tam_calibration.report.blocks import Block
from tam_calibration.results.comparison_json import Sources, comparison_to_mapping, write_mend


@click.command()
@click.argument("simulation", type=PATH)
@click.argument("recording", type=PATH)
@click.option("--array", "array_path", type=PATH, required=True, help="Array YAML: positions and noise of the sensors.")
@click.option(
    "--array-of-simulation",
    "simulated_array_path",
    type=PATH,
    help="Array YAML of the simulation, if it differs; it needs the same number of sensors.",
)
@click.option("--json", "json_path", type=PATH, help="Write the result as JSON; - is stdout, instead of the tables.")
@click.option("--report", type=PATH, help="Write an HTML page: what differs, drawn, and the corrections to copy.")
@click.option("--mend", type=PATH, help="Write what the simulation lacks, for tam simulate --from-comparison.")
@click.option("--map-of-simulation", type=PATH, help="Map YAML of the simulation, if its names differ.")
@reading_options
@answer_options
@click.pass_context
def command(
    ctx: click.Context,
    simulation: Path,
    recording: Path,
    array_path: Path,
    simulated_array_path: Path | None,
    json_path: Path | None,
    report: Path | None,
    mend: Path | None,
    map_of_simulation: Path | None,
    how: Reading,
    detail: Detail,
) -> None:
    """Compare SIMULATION, recorded from your simulator, with RECORDING, and write corrections for the simulator.

    Each may have any format; path, length, rate and site may differ. Exits 0 when they are the same, 1 when they
    differ or it cannot be decided, 2 on bad input.
    """
    to_stdout = json_path == Path("-")
    outputs = {"json": None if to_stdout else json_path, "report": report, "mend": mend}
    given = (simulation, recording, array_path, simulated_array_path, map_of_simulation)
    inputs = [*(path for path in given if path is not None), *how.files]
    simulated_map = None if map_of_simulation is None else read_map(map_of_simulation)
    simulated_how = replace(AS_IT_IS, channel_map=simulated_map, tolerance_s=how.tolerance_s)
    with graded(to_stdout), write_together(outputs, inputs) as beside:
        comparison = _compare(simulation, recording, array_path, simulated_array_path, simulated_how, how)
        sources = Sources(provenance(simulation), provenance(recording))
        content = to_json(comparison_to_mapping(comparison, sources))
        if "json" in beside:
            beside["json"].write_text(content, encoding="utf-8")
        if "report" in beside:
            from tam_calibration.report.comparison_report import write_comparison_report

            write_comparison_report(beside["report"], comparison, sources)
        if "mend" in beside and comparison.mend is not None:
            write_mend(beside["mend"], comparison.mend)
    written = [path for name, path in outputs.items() if path and (name != "mend" or comparison.mend is not None)]
    if to_stdout:
        say(content)
    else:
        print_answer(
            comparison_rows.answer(comparison),
            comparison_rows.summary_blocks(comparison),
            _tables(comparison),
            detail,
            written,
            comparison_rows.next_words(comparison),
        )
        if mend and comparison.mend is None:
            say(f"not written: {mend}, as nothing was compared")
    ctx.exit(0 if comparison.verdict == "same" else 1)


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
    with showing_progress() as progress:
        reading = working(progress, "reading the simulation"), working(progress, "reading the recording")
        simulated_source, simulated_remarks = read_compared(
            "simulation", simulation, simulated, simulated_how, reading[0]
        )
        source, remarks = read_compared("recording", recording, array, how, reading[1])
        comparison = compare(
            simulated_source, source, array, array_of_simulation=simulated, progress=progress_of(progress, "comparing")
        )
    return replace(comparison, remarks=(*simulated_remarks, *remarks, *comparison.remarks))


def _tables(comparison: Comparison) -> list[Block]:
    return [
        *comparison_rows.mistake_blocks(comparison),
        *comparison_rows.difference_blocks(comparison),
        *comparison_rows.noise_blocks(comparison),
        *comparison_rows.closing_blocks(comparison),
    ]
