"""The page on reproduced papers: what is compared and what is not, and the figures of Wu 2025 redrawn."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from tam_calibration.model.units import to_nanotesla
from tam_calibration.report.blocks import Block, Gallery, Section, Table, Text
from tam_calibration.report.formatting import count, fixed, join
from tam_calibration.report.page import embed, write_page
from tam_validation.papers import PAPERS
from tam_validation.papers.not_compared import not_compared
from tam_validation.papers.plots import plot_relative_errors, plot_residuals
from tam_validation.papers.row import PaperNumber
from tam_validation.papers.sweep import Sweep
from tam_validation.papers.tables import HEADER, STATUSES, cells, notes, tally
from tam_validation.papers.wu2025 import bias_rmse, excess
from tam_validation.papers.wu2025_sweeps import BEST, CORRECTED, HELD_OUT, IN_SAMPLE, PUBLISHED

_FIGURES = (
    ("vector", "Fig. 4", "Fig. 5", True),
    ("scalar", "Fig. 6", "Fig. 7", False),
    ("scalar per sample", "Fig. 6, otherwise", "Fig. 7, otherwise", True),
    ("samples", "Fig. 8", "Fig. 9", True),
)
_INTRODUCTION = (
    "Means over {runs} runs a point. Relative errors are those of the mean absolute error against the true scale "
    "factor errors, angles and biases of Table 1; bold lines are means over the parameters of a kind, pale ones the "
    "single parameters of the published method. The Cramér–Rao bound is drawn as the mean error of an estimate that "
    "reaches it. e_B, against the true intensity, is the mean of the sensors after calibration and that of each sensor "
    "before; held out are as many samples that the fit has not seen. Runs of different points share their random "
    "numbers."
)

_TRENDS = (
    "Of its simulations the paper says in words what the curves do, and prints almost no values. That stands here as "
    "an exponent, 1 for straight growth and 0 for none, or as the sign of a slope; ours is of the curves of the "
    "published method. Ours is empty where the paper measured and publishes no recording."
)
_SOURCES = (
    "Where the number of the paper is not printed there, its source says what it is. A paper is in error where ours "
    "agrees with the right number instead; where that is our own earlier result, the agreement tells only that nothing "
    "has changed here since."
)


def write_reproduction_report(
    path: Path, rows: Mapping[str, Sequence[PaperNumber]], sweeps: Mapping[str, Sweep]
) -> None:
    """Write a self-contained HTML page about reproduced papers.

    Parameters
    ----------
    path : Path
        File to write; nothing is left there when writing fails, and an older file stays as it was.
    rows : mapping
        The numbers of each paper that are compared, by the names of ``PAPERS``.
    sweeps : mapping
        Those of Wu 2025; empty where that paper is not among them.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    sections = [_verdict(rows)]
    if sweeps:
        sections.append(_figures(sweeps))
    sections += [_numbers(paper, own) for paper, own in rows.items()]
    total = sum(len(own) for own in rows.values())
    write_page(path, "Papers reproduced", f"{join(list(rows))}: {count(total)} numbers", sections)


def _verdict(rows: Mapping[str, Sequence[PaperNumber]]) -> Section:
    other = [row.name for own in rows.values() for row in own if not row.is_as_recorded]
    if other:
        verdict = Text(f"Other than on record: {'; '.join(other)}.", "doubt")
    else:
        verdict = Text("Every number that is compared has the status that is on record for it.", "good")
    table = [[PAPERS[paper], *(count(value) for value in (*tally(own), len(own)))] for paper, own in rows.items()]
    return Section("Verdict", [verdict, Table(["paper", *STATUSES, "numbers"], table)])


def _figures(sweeps: Mapping[str, Sweep]) -> Section:
    runs = next(iter(sweeps["vector"].values.values())).shape[1]
    blocks: list[Block] = [Text(_INTRODUCTION.format(runs=runs))]
    for name, errors, residuals, with_bound in _FIGURES:
        sweep, what = sweeps[name], f"over the {sweeps[name].plan.name}"
        pictures = []
        for title, about, figure in (
            (errors, "relative errors of the parameters", plot_relative_errors(sweep, with_bound)),
            (residuals, "residuals before and after calibration", plot_residuals(sweep)),
        ):
            caption = f"{title}: {about} {what}"
            pictures.append(embed(figure, caption, caption))
        blocks += [Gallery(pictures), Text(_remark(name, sweeps))]
    blocks.append(Text(_drift(sweeps["drift"])))
    return Section("Figures of Wu 2025", blocks)


def _remark(name: str, sweeps: Mapping[str, Sweep]) -> str:
    """Return what a pair of figures shows."""
    if name == "vector":
        return (
            "All errors grow straight with the noise, and none before calibration does. Without scalar noise and drift "
            "the two forms of step 1 are one method; it stays above the bound, which maximum likelihood reaches."
        )
    if name == "scalar":
        return (
            "With one error of the scalar magnetometer for a whole data set, as the paper's figures must have it, that "
            "error is one of scale alone: it moves the scale factors and e_B, and nothing else."
        )
    if name == "scalar per sample":
        return (
            "With an error of its own in each sample, as a magnetometer makes it, the angles of non-orthogonality move "
            "as well, and so does the bias of any step 1 that follows the scalar reading. The published step 1 does "
            "not follow it: that is why its bias stays, below the bound as it is told that the field is constant, and "
            "why a drift spoils it."
        )
    inside, outside = (
        [fixed(excess(sweeps[name], f"{quantity} {data}"), 1) for quantity in ("e_B", "e_T")]
        for data in (IN_SAMPLE, HELD_OUT)
    )
    return (
        f"The published method leaves e² = floor² (1 + k/N) with k = {inside[0]} for e_B and {inside[1]} for e_T on "
        f"the data of the fit, and {outside[0]} and {outside[1]} on others: e_B rises with N in the paper because it "
        "is judged by the data that it was fitted to. The errors of the parameters fall as 1/√N without a threshold."
    )


def _drift(sweep: Sweep) -> str:
    values = {method: to_nanotesla(bias_rmse(sweep, method)) for method in (PUBLISHED, CORRECTED, BEST)}
    figures = join([f"{method} {fixed(with_[1], 3)} nT ({fixed(with_[0], 3)})" for method, with_ in values.items()])
    return f"RMS error of the biases with a drift of 8.26 nT that the scalar magnetometer reads (without): {figures}."


def _numbers(paper: str, rows: Sequence[PaperNumber]) -> Section:
    blocks: list[Block] = [Text(_TRENDS)] if any(row.unit == "exponent" for row in rows) else []
    blocks += [Text(_SOURCES), Table(HEADER, cells(rows))]
    remarks = notes(rows)
    if remarks:
        table = [[str(index), note] for index, note in enumerate(remarks, start=1)]
        blocks.append(Table(["note", "reason"], table, numeric=False))
    absent = [[item.item, item.reason] for item in not_compared(paper)]
    blocks.append(Table(["not compared", "reason"], absent, numeric=False))
    return Section(PAPERS[paper], blocks)
