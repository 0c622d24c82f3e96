"""`tam compare`: what a simulator's recording has otherwise than a real one, and what mends the simulator."""

from dataclasses import replace
from pathlib import Path

import click
from rich.console import Console

from tam_calibration.cli.terminal import (
    PATH,
    progress_of,
    showing_progress,
    stdout,
    table_of,
    tolerance_option,
    working,
    write_together,
)
from tam_calibration.comparison import compare
from tam_calibration.comparison.result import Closing, Comparison
from tam_calibration.files import provenance
from tam_calibration.files.compared_recordings import read_array_of, read_compared
from tam_calibration.files.comparison_json import Sources, comparison_to_mapping
from tam_calibration.files.mend_yaml import write_mend
from tam_calibration.files.text_files import to_json
from tam_calibration.report.comparison_rows import (
    CLOSING_HEADER,
    DIFFERENCES_HEADER,
    NOISE_HEADER,
    OTHER_HEADER,
    SOURCE_HEADER,
    closing_rows,
    difference_rows,
    headline,
    mistake_words,
    next_words,
    noise_rows,
    noise_words,
    parameter_tables,
    source_rows,
)
from tam_calibration.report.formatting import sentence
from tam_calibration.report.gap_rows import closed_words

_ROWS = 12
"""Parameters of an effect that are printed."""

_WORDS = ("simulation", "recording", "where", "unit", "colour: simulation", "colour: recording", "")
"""Columns that hold words."""


@click.command()
@click.argument("simulation", type=PATH)
@click.argument("recording", type=PATH)
@click.option("--array", "array_path", type=PATH, required=True, help="Array YAML: where the sensors sit, their noise.")
@click.option(
    "--array-of-simulation",
    "simulated_array_path",
    type=PATH,
    help="Array YAML of the simulation, where that is another one with as many sensors.",
)
@click.option("--json", "json_path", type=PATH, help="Write the result as JSON; - is stdout, instead of the tables.")
@click.option("--report", type=PATH, help="Write an HTML page: what differs, drawn, and the mend to copy.")
@click.option("--mend", type=PATH, help="Write what the simulation lacks, for tam simulate --from-comparison.")
@tolerance_option
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
    tolerance_s: float,
) -> None:
    """Say what SIMULATION, recorded from your simulator, has otherwise than RECORDING, and what mends the simulator.

    Each is a CSV file or a bag; path, length, rate and site may differ. Exits 0 when they are the same, 1 when they
    differ or that cannot be told, 2 on bad input.
    """
    to_stdout = json_path == Path("-")
    outputs = {"json": None if to_stdout else json_path, "report": report, "mend": mend}
    inputs = [path for path in (simulation, recording, array_path, simulated_array_path) if path is not None]
    with write_together(outputs, inputs) as beside:
        comparison = _compare(simulation, recording, array_path, simulated_array_path, tolerance_s)
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
        click.echo(content)
    else:
        _print(comparison, written)
        if mend and comparison.mend is None:
            click.echo(f"not written: {mend}, as nothing was compared")
    ctx.exit(0 if comparison.verdict == "same" else 1)


def _compare(
    simulation: Path, recording: Path, array_path: Path, simulated_array_path: Path | None, tolerance_s: float
) -> Comparison:
    """Return the comparison of two files, with remarks on how their samples were joined."""
    array = read_array_of("recording", array_path, recording)
    simulated = array if simulated_array_path is None else read_array_of("simulation", simulated_array_path, simulation)
    with showing_progress() as progress:
        reading = working(progress, "reading the simulation"), working(progress, "reading the recording")
        simulated_source, simulated_remarks = read_compared(
            "simulation", simulation, simulated, tolerance_s, reading[0]
        )
        source, remarks = read_compared("recording", recording, array, tolerance_s, reading[1])
        comparison = compare(
            simulated_source, source, array, array_of_simulation=simulated, progress=progress_of(progress, "comparing")
        )
    return replace(comparison, remarks=(*simulated_remarks, *remarks, *comparison.remarks))


def _print(comparison: Comparison, written: list[Path]) -> None:
    console = stdout()
    for mistake in comparison.mistakes:
        console.print(mistake_words(mistake), soft_wrap=True)
    for remark in comparison.remarks:
        console.print(remark, soft_wrap=True)
    console.print(headline(comparison), style="bold", soft_wrap=True)
    if rows := difference_rows(comparison):
        console.print(table_of(DIFFERENCES_HEADER, rows, _WORDS))
    for caption, rows in parameter_tables(comparison):
        console.print(f"{sentence(caption)[:-1]}:")
        console.print(table_of(OTHER_HEADER, rows[:_ROWS], ("unit",)))
        if len(rows) > _ROWS:
            console.print(f"… and {len(rows) - _ROWS} more: --json and --report have all.")
    if comparison.noise:
        console.print(noise_words(comparison))
        console.print(table_of(NOISE_HEADER, noise_rows(comparison), _WORDS))
    if comparison.verdict == "differs" and comparison.closing is not None:
        _print_closing(console, comparison.closing)
    console.print(f"Next: {next_words(comparison)}", soft_wrap=True)
    for path in written:
        click.echo(f"written: {path}")


def _print_closing(console: Console, closing: Closing) -> None:
    console.print(table_of(CLOSING_HEADER, closing_rows(closing)))
    if words := closed_words(closing):
        console.print(sentence(words))
    if rows := source_rows(closing):
        console.print(table_of(SOURCE_HEADER, rows))
    if closing.left:
        console.print(f"What stays open: {sentence(closing.left)}", soft_wrap=True)
