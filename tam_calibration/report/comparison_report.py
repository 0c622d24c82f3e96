"""The report on a comparison: what the simulation has otherwise than the recording, drawn, and the mend to copy."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tam_calibration.comparison.result import Comparison, NoiseDifference
from tam_calibration.correction.parts import Provenance
from tam_calibration.files.yaml_document import dump_mapping
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_calibration.report import comparison_rows, page
from tam_calibration.report.blocks import Block, Code, Points, Section, Table, Text, count, number
from tam_calibration.report.comparison_rows import axis_name
from tam_calibration.report.gap_plots import State, plot_histogram, plot_sphere
from tam_calibration.report.page import embed, write_page
from tam_calibration.results.comparison_json import mend_in_texts

SIDE_COLORS = {"simulation": page.AFTER_COLOR, "recording": page.BEFORE_COLOR}
"""Of the two columns, on all figures."""


@page.in_style
def plot_noise(noise: Sequence[NoiseDifference]) -> Figure:
    """Draw the spectra of all axes small, those of sensors on one scale; what differs has a shaded ground."""
    columns = 3
    rows = -(-len(noise) // columns)
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 0.6 + 1.1 * rows)
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
    common = _range([each for each in noise if each.recording.sensor])
    for axes, each in zip(panels.ravel(), noise, strict=False):
        _draw_noise(axes, each, common if each.recording.sensor else _range([each]))
        axes.set_title(f"{axis_name(each.recording)}{': differs' if each.differs else ''}", loc="left", fontsize=8)
        if each.differs:
            axes.set_facecolor(f"{page.MISSING_COLOR}22")
    for axes in panels[:, 1:].ravel():
        axes.tick_params(labelleft=False)
    for axes in panels.ravel()[len(noise) :]:
        axes.remove()
    figure.supxlabel("frequency (Hz)")
    figure.supylabel("noise (nT/√Hz)")
    return figure


def _range(noise: Sequence[NoiseDifference]) -> tuple[float, float]:
    """Return the ends of a logarithmic axis, nT/√Hz, that shows the spectra of all but of what has no noise."""
    sides = [side for each in noise for side in (each.simulation, each.recording)]
    bounds = [_amplitude(side, side.density_low_T2_per_hz) for side in sides]
    bounds += [_amplitude(side, side.density_high_T2_per_hz) for side in sides]
    drawn = np.concatenate([each[each > 0] for each in bounds])
    low, high = (float(drawn.min()), float(drawn.max())) if len(drawn) else (1.0, 1.0)
    middle, least = np.sqrt(low * high), 10**0.6  # more than a decade, so that there is a tick with a number
    return min(low, middle / least), max(high, middle * least)


def _amplitude(noise: AxisNoise, density: FloatArray) -> FloatArray:
    """Return the root of a density of an axis's noise, nT/√Hz, but for the constant part."""
    return to_nanotesla(np.sqrt(density[noise.frequency_hz > 0]))


def _draw_noise(axes: Axes, noise: NoiseDifference, ends: tuple[float, float]) -> None:
    for name, side in (("simulation", noise.simulation), ("recording", noise.recording)):
        frequency = side.frequency_hz[side.frequency_hz > 0]
        low, high = (_amplitude(side, each) for each in (side.density_low_T2_per_hz, side.density_high_T2_per_hz))
        axes.fill_between(frequency, low, high, color=SIDE_COLORS[name], alpha=0.25, linewidth=0)
        axes.plot(
            frequency, _amplitude(side, side.density_T2_per_hz), color=SIDE_COLORS[name], linewidth=1.1, label=name
        )
    axes.set(xscale="log", yscale="log", ylim=ends)
    axes.minorticks_off()
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")


def states_of(comparison: Comparison) -> list[State]:
    """Return what a calibration leaves of simulation and recording; none where nothing was compared."""
    sides = {"simulation": comparison.simulation, "recording": comparison.recording}
    return [
        State(name, SIDE_COLORS[name], side.gap.residue.before, side.gap.residue)
        for name, side in sides.items()
        if side is not None
    ]


def row_to_draw(states: Sequence[State]) -> int:
    """Return the row whose residuals differ most in size: 3 i + a for axis a of sensor i, both from 0; 3K the scalar.

    Parameters
    ----------
    states : sequence of State
        Of simulation and recording, whose arrays have equally many sensors.
    """
    sizes = [state.ratio * state.residue.floor_T for state in states]
    is_known = np.isfinite(sizes).all(axis=0) & (np.min(sizes, axis=0) > 0)
    ratio = np.divide(sizes[1], sizes[0], out=np.ones(len(sizes[0])), where=is_known)
    return int(np.argmax(np.abs(np.log(ratio))))


def _verdict(comparison: Comparison) -> list[Block]:
    """Return the verdict, the simulator's gross mistakes, and what to do."""
    emphasis = "good" if comparison.verdict == "same" else "doubt"
    blocks = [
        Text(comparison_rows.headline(comparison), emphasis),
        *comparison_rows.mistake_blocks(comparison),
        Text(comparison_rows.next_words(comparison)),
    ]
    sides = [side for side in (comparison.simulation, comparison.recording) if side is not None]
    if len(sides) == 2:
        rows = [
            ["samples", *(count(side.recording.sample_count) for side in sides)],
            ["span (s)", *(number(float(np.ptp(side.recording.time_s))) for side in sides)],
            ["sensors", *(count(side.array.sensor_count) for side in sides)],
            ["against its own model", *(side.gap.verdict.replace("_", " ") for side in sides)],
        ]
        blocks.append(Table(("", "simulation", "recording"), rows))
    return blocks


def _differences(comparison: Comparison) -> list[Block]:
    """Return the effects that one side lacks or has otherwise, with parameters; nothing where nothing was compared."""
    if comparison.recording is None:
        return []
    nothing: list[Block] = [Text("No effect is in one of the two and not, or otherwise, in the other.")]
    return comparison_rows.difference_blocks(comparison) or nothing


def _noise(comparison: Comparison) -> list[Block]:
    """Return the noise of both; nothing where nothing was compared."""
    if not comparison.noise:
        return []
    words, table = comparison_rows.noise_blocks(comparison)
    caption = "Noise of all axes by frequency, with 95 % intervals; what differs is shaded"
    seen = [
        "What you see: where the lines lie apart by more than their bands, the noise is another; a rise to the left is "
        "1/f noise or drift, a hump is noise in a band.",
        "When they are the same: the bands overlap at all frequencies.",
    ]
    picture = embed(plot_noise(comparison.noise), "Noise of all axes", caption)
    return [words, picture, Points(seen), table]


def _residuals(comparison: Comparison) -> list[Block]:
    """Return the residuals of both over direction and by size; nothing where nothing was compared."""
    states = states_of(comparison)
    if len(states) < 2:
        return []
    row = row_to_draw(states)
    by_size = "How often the residual has which size, in noise floors of the recording"
    return [
        Text(
            f"What a calibration of each leaves of its own readings, for {states[0].row_name(row)}, the row in which "
            "the two differ most. Paths may differ: each residual is that of its own run."
        ),
        embed(plot_sphere(states, row), "Residuals by direction", "Mean residual over the directions of the field"),
        embed(plot_histogram(states, row), "Residuals by size", by_size),
        Points(
            [
                "What you see: a smooth pattern of one map alone is an effect of attitude that the other side lacks. "
                "Broader shoulders or longer tails are noise or outliers that it lacks.",
                "When they are the same: both maps have the same shades, and the two lines lie on each other.",
            ]
        ),
    ]


def _figures(comparison: Comparison) -> list[Block]:
    """Return every figure of the simulation beside that of the recording."""
    tables = comparison_rows.figure_tables(comparison)
    about = Text(
        "Scale factors, non-orthogonality, biases and misalignment are what a calibration removes: that they differ is "
        "stated, and is no difference of the simulation."
    )
    return [about, *tables] if tables else []


_COMMAND = "tam simulate --from-comparison mend.yaml --recording SIMULATION -o mended.csv"


def _mend(comparison: Comparison) -> list[Block]:
    """Return what to write into the simulator, to copy; nothing where nothing was compared or all is the same."""
    mend = comparison.mend
    if mend is None or comparison.verdict == "same":
        return []
    texts = mend_in_texts(mend)
    return [
        Text("One click selects a block. Gazebo holds noise, biases and steps; the rest is in the last two."),
        Code(texts["sdf"], "Gazebo: the <sensor> elements of the SDF"),
        Code(texts["plugin"], "Python: what a plugin does sample by sample"),
        Code(dump_mapping(texts["parameters"]), "mend.yaml: the parameters, as tam compare --mend writes them"),
        Code(_COMMAND, "The run of the simulation with all of the mend"),
    ]


def write_comparison_report(path: Path, comparison: Comparison, simulation: Provenance, recording: Provenance) -> None:
    """Write a self-contained HTML page about a comparison.

    Parameters
    ----------
    path : Path
        File to write; nothing is left there when writing fails, and an older file stays as it was.
    comparison : Comparison
        What was compared.
    simulation, recording : Provenance
        The files that it is of.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    names = [f"{source.name}, SHA-256 {source.sha256}" for source in (simulation, recording)]
    subtitle = f"simulation: {names[0]} | recording: {names[1]}"
    sections = [
        Section("Verdict", _verdict(comparison)),
        Section("What differs", _differences(comparison)),
        Section("Noise", _noise(comparison)),
        Section("Residuals", _residuals(comparison)),
        Section("How far the mend closes the gap", comparison_rows.closing_blocks(comparison)),
        Section("Side by side", _figures(comparison)),
        Section("The mend, to copy", _mend(comparison)),
    ]
    write_page(path, "The simulation and the recording", subtitle, sections)
