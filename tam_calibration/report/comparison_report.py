"""The report on a comparison: what the simulation has otherwise than the recording, drawn, and the mend to copy."""

from collections.abc import Callable
from pathlib import Path

from tam_calibration.comparison.result import Comparison, Side
from tam_calibration.correction.calibration import Provenance
from tam_calibration.files.comparison_json import Sources, mend_in_texts
from tam_calibration.files.yaml_document import dump_mapping
from tam_calibration.report.comparison_plots import (
    plot_all_noise,
    plot_histograms,
    plot_noise,
    plot_source_errors,
    plot_sphere,
    plot_steps,
    row_to_draw,
)
from tam_calibration.report.comparison_rows import (
    CLOSING_HEADER,
    DIFFERENCES_HEADER,
    FIGURES_HEADER,
    NOISE_HEADER,
    OTHER_HEADER,
    SOURCE_HEADER,
    axis_name,
    closing_rows,
    difference_rows,
    figure_rows,
    headline,
    mistake_words,
    most_other,
    next_words,
    noise_rows,
    noise_words,
    parameter_tables,
    source_rows,
)
from tam_calibration.report.formatting import count, number, sentence
from tam_calibration.report.gap_rows import closed_words
from tam_calibration.report.gap_view import GapView
from tam_calibration.report.page import Block, Code, Points, Section, Table, Text, embed, sections_of, write_page


def verdict_section(comparison: Comparison) -> Section:
    """Return the verdict, the simulator's gross mistakes, and what to do."""
    emphasis = "good" if comparison.verdict == "same" else "doubt"
    blocks: list[Block] = [Text(remark, "doubt") for remark in comparison.remarks]
    blocks.append(Text(headline(comparison), emphasis))
    blocks += [Text(mistake_words(mistake), "doubt") for mistake in comparison.mistakes]
    blocks.append(Text(next_words(comparison)))
    if comparison.simulation is not None and comparison.recording is not None:
        header = ("", "simulation", "recording")
        blocks.append(Table(header, _side_rows(comparison.simulation, comparison.recording)))
    return Section("Verdict", blocks)


def _side_rows(simulation: Side, recording: Side) -> list[list[str]]:
    sides = simulation, recording
    spans = [side.recording.time_s[-1] - side.recording.time_s[0] for side in sides]
    return [
        ["samples", *(count(side.recording.sample_count) for side in sides)],
        ["span (s)", *(number(float(span)) for span in spans)],
        ["sensors", *(count(side.array.sensor_count) for side in sides)],
        ["beside its own model", *(side.gap.verdict.replace("_", " ") for side in sides)],
    ]


def differences_section(comparison: Comparison) -> Section | None:
    """Return the effects that one side lacks or has otherwise, with parameters; None where nothing was compared."""
    if comparison.recording is None:
        return None
    rows = difference_rows(comparison)
    if not rows:
        return Section("What differs", [Text("No effect is in one of the two and not, or otherwise, in the other.")])
    tables = [Table(OTHER_HEADER, rows, caption) for caption, rows in parameter_tables(comparison)]
    return Section("What differs", [Table(DIFFERENCES_HEADER, rows, numeric=False), *tables])


def noise_section(comparison: Comparison) -> Section | None:
    """Return the noise of both, the axis that differs most first; None where nothing was compared."""
    if not comparison.noise:
        return None
    worst = most_other(comparison.noise)
    name = axis_name(worst.recording)
    blocks: list[Block] = [
        Text(noise_words(comparison)),
        embed(plot_noise(worst), f"Noise of {name}", f"Noise of {name} by frequency, with 95 % intervals"),
        Points(
            [
                "What you see: where the lines lie apart by more than their bands, the noise is another; a rise to the "
                "left is 1/f noise or drift, a hump is noise in a band.",
                "When they are the same: the bands overlap at all frequencies.",
            ]
        ),
        embed(plot_all_noise(comparison.noise), "Noise of all axes", "All axes; what differs is shaded"),
        Table(NOISE_HEADER, noise_rows(comparison), "Standard deviation ± standard error", numeric=False),
    ]
    return Section("Noise", blocks)


def residuals_section(comparison: Comparison) -> Section | None:
    """Return the residuals of both over direction and by size; None where nothing was compared."""
    simulation, recording = comparison.simulation, comparison.recording
    if simulation is None or recording is None:
        return None
    row = row_to_draw(simulation, recording)
    name = GapView(recording.gap).row_name(row)
    sides = simulation, recording, row, name
    blocks: list[Block] = [
        Text(
            f"What a calibration of each leaves of its own readings, for {name}, the row in which the two differ most. "
            "Paths need not be alike: each residual is that of its own run."
        ),
        embed(plot_sphere(*sides), "Residuals by direction", "Mean residual over the directions of the field"),
        embed(plot_histograms(*sides), "Residuals by size", "How often the residual has which size"),
        Points(
            [
                "What you see: a smooth pattern of the ground or of the dots alone is an effect of attitude that the "
                "other side lacks; broader shoulders or longer tails are noise or outliers that it lacks.",
                "When they are the same: the dots have the shade of the ground, and the two lines lie on each other.",
            ]
        ),
    ]
    return Section("Residuals", blocks)


def closing_section(comparison: Comparison) -> Section | None:
    """Return how far the mend closes the gap, and what stays open; None where there is no gap."""
    closing = comparison.closing
    if closing is None or comparison.verdict == "same":
        return None
    blocks: list[Block] = [
        Text("Each term was added to a twin of the simulation's run, or taken from it, and judged out of sample."),
        Table(CLOSING_HEADER, closing_rows(closing)),
    ]
    if words := closed_words(closing):
        blocks.append(Text(sentence(words)))
    if closing.steps:
        title = "The gap after each further term of the mend"
        blocks.append(embed(plot_steps(closing), title, title))
    if rows := source_rows(closing):
        title = "The same source put into each, located by tam locate, with 95 % intervals"
        blocks += [embed(plot_source_errors(closing), title, title), Table(SOURCE_HEADER, rows)]
    if closing.left:
        blocks.append(Text(f"What stays open: {sentence(closing.left)}", "doubt"))
    return Section("How far the mend closes the gap", blocks)


def figures_section(comparison: Comparison) -> Section | None:
    """Return every figure of the simulation beside that of the recording; None where there are none."""
    if not comparison.figures:
        return None
    tables = [Table(FIGURES_HEADER, rows, sentence(group)[:-1]) for group, rows in figure_rows(comparison)]
    about = Text(
        "Scale factors, non-orthogonality, biases and misalignment are what a calibration removes: that they differ is "
        "stated, and is no difference of the simulation."
    )
    return Section("Side by side", [about, *tables])


_COMMAND = "tam simulate --from-comparison mend.yaml --recording SIMULATION -o mended.csv"


def mend_section(comparison: Comparison) -> Section | None:
    """Return what to write into the simulator, to copy; None where nothing was compared or all is the same."""
    mend = comparison.mend
    if mend is None or comparison.verdict == "same":
        return None
    texts = mend_in_texts(mend)
    blocks: list[Block] = [
        Text("One click selects a block. Gazebo and MuJoCo hold white noise and biases; the rest is in the last two."),
        Code(texts["sdf"], "Gazebo: the <sensor> elements of the SDF"),
        Code(texts["mjcf"], "MuJoCo: the <sensor> and <custom> elements of the MJCF"),
        Code(texts["plugin"], "Python: what a plugin does sample by sample"),
        Code(dump_mapping(texts["parameters"]), "mend.yaml: the parameters, as tam compare --mend writes them"),
        Code(_COMMAND, "The run of the simulation with all of the mend"),
    ]
    return Section("The mend, to copy", blocks)


SECTIONS: tuple[Callable[[Comparison], Section | None], ...] = (
    verdict_section,
    differences_section,
    noise_section,
    residuals_section,
    closing_section,
    figures_section,
    mend_section,
)
"""Sections in reading order."""


def write_comparison_report(path: Path, comparison: Comparison, sources: Sources) -> None:
    """Write a self-contained HTML page about a comparison.

    Parameters
    ----------
    path : Path
        File to write; nothing is left there when writing fails, and an older file stays as it was.
    comparison : Comparison
        What was compared.
    sources : Sources
        The files that it is of.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    subtitle = f"simulation: {_named(sources.simulation)} | recording: {_named(sources.recording)}"
    write_page(path, "The simulation beside the recording", subtitle, sections_of(SECTIONS, comparison))


def _named(source: Provenance | None) -> str:
    return "what the nodes collected" if source is None else f"{source.name}, SHA-256 {source.sha256}"
