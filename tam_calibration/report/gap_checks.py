"""The section of a gap's report that holds the residual with its causes against the simulated twin, in numbers."""

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from tam_calibration.gap.checks import LAGS, Check, Checks, row_name
from tam_calibration.report.formatting import fixed, number
from tam_calibration.report.gap_view import GapView
from tam_calibration.report.page import Block, Points, Section, Table, Text, figure_blocks
from tam_calibration.report.style import AFTER_COLOR, MISSING_COLOR, PAGE_WIDTH_INCH, STYLE

_HEADER = {
    "chi_square": "χ²/n",
    "lag_1_correlation": "lag-1 correlation",
    "strongest_line": "strongest line (mean power)",
    "part_of_direction": "part that goes with the direction",
    "excess_kurtosis": "excess kurtosis",
}


def checks_section(view: GapView) -> list[Section]:
    """Return the section; none without a verdict."""
    checks = view.gap.checks
    if checks is None:
        return []
    row = view.rows[0]
    figure = figure_blocks(
        plot_autocorrelation(checks, row),
        "Alike from sample to sample",
        f"how alike residuals of {row_name(row, len(checks.line_hz))} are that lie so many samples apart; the band is "
        "that of noise at the first.",
        "all bars would end within the band.",
    )
    return [Section("Against the simulated twin", [*_summary(checks), *figure])]


def _summary(checks: Checks) -> list[Block]:
    compared = "With its causes the recording would look like its simulated twin, which has noise alone"
    if not checks.departing_rows:
        return [Text(f"{compared}, and so it does: every statistic of every axis is in the range of noise.", "good")]
    rows = [row_name(row, len(checks.line_hz)) for row in checks.departing_rows]
    cells = [
        [name, *(_cell(check, row) for check in checks.by_name.values())]
        for name, row in zip(rows, checks.departing_rows, strict=True)
    ]
    twin = ["noise alone", *(_range(check, checks.departing_rows[0]) for check in checks.by_name.values())]
    return [
        Text(f"{compared}, if nothing else were in it. It does not:"),
        Points(checks.sentences),
        Table(
            ["axis", *(_HEADER[name] for name in checks.by_name)],
            [twin, *cells],
            "Axes that depart; ▲ and ▼ mark what is above and below the range of noise.",
        ),
    ]


def _cell(check: Check, row: int) -> str:
    value = check.values[row]
    return number(value) + (" ▲" if value > check.high[row] else " ▼" if value < check.low[row] else "")


def _range(check: Check, row: int) -> str:
    return f"{fixed(check.low[row], 2)} to {number(check.high[row])}"


@matplotlib.rc_context(STYLE)
def plot_autocorrelation(checks: Checks, row: int) -> Figure:
    """Draw the autocorrelation of one row, and the band of noise."""
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 2.8), layout="constrained")
    axes = figure.subplots()
    check = checks.lag_1_correlation
    axes.axhspan(check.low[row], check.high[row], color=MISSING_COLOR, alpha=0.3, linewidth=0)
    axes.bar(np.arange(1, LAGS + 1), checks.autocorrelation[row], width=0.5, color=AFTER_COLOR)
    axes.axhline(0, color="black", linewidth=0.6)
    axes.set(xlabel="samples apart", ylabel="correlation", ylim=(-1.05, 1.05))
    return figure
