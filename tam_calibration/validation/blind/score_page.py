"""The score of the check on withheld effects as an HTML page, with the confusion matrix and the reliability curve."""

from pathlib import Path

from matplotlib.figure import Figure

from tam_calibration.report.page import Points, Section, Table, Text, embed, write_page
from tam_calibration.validation.blind.score import Score
from tam_calibration.validation.blind.score_table import HEADER, cells, effects, reliability, remarks, shares


def write_score_page(path: Path, score: Score, name: str) -> None:
    """Write the page."""
    missed = [row.name for row in score.rows if row.cases and not row.is_met]
    verdict = Text(f"Missed: {'; '.join(missed)}.", "doubt") if missed else Text("Every figure is met.", "good")
    confusion = embed(
        draw_confusion(score), "confusion matrix", "How often each answer came first; rows are the truth."
    )
    curve = embed(
        draw_reliability(score), "reliability curve", "What came true of what was told; on the line it is as told."
    )
    table = Table(("told", "true", "statements"), reliability(score))
    sections = [
        Section("Figures asked for", [verdict, Table(HEADER, [cells(row) for row in score.rows])]),
        Section("What was named for what", [confusion, Points(remarks(score, {}))]),
        Section("Probabilities", [curve, table]),
        Section("Effect by effect", [Table(("effect", "solved", "amplitude left"), effects(score))]),
        Section("By condition", [Table(("condition", "solved", "of"), shares({**score.by_condition, **score.short}))]),
        Section("Cases that went wrong", [Points([one.line for one in score.failures] or ["none"])]),
    ]
    write_page(path, "The check on withheld effects", name, sections)


def draw_confusion(score: Score) -> Figure:
    """Draw how often each answer came first, a row for each truth."""
    truths = list(score.confusion)
    named = {answer for counts in score.confusion.values() for answer in counts}
    answers = [truth for truth in truths if truth in named] + sorted(named - set(truths))
    shares = [[counts[answer] / counts.total() for answer in answers] for counts in score.confusion.values()]
    figure = Figure(figsize=(9, 8), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for row, counts in enumerate(score.confusion.values()):
        for column, answer in enumerate(answers):
            if counts[answer]:
                ink = "white" if counts[answer] > counts.total() / 2 else "black"
                axes.text(column, row, str(counts[answer]), ha="center", va="center", color=ink)
    axes.set_xticks(range(len(answers)), answers, rotation=60, ha="right")
    axes.set_yticks(range(len(truths)), truths)
    axes.set_xlabel("first answer")
    axes.set_ylabel("truth")
    return figure


def draw_reliability(score: Score) -> Figure:
    """Draw what came true over what was told."""
    figure = Figure(figsize=(4.5, 4.5), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color="0.7")
    axes.plot([one.told for one in score.reliability], [one.true for one in score.reliability], "o-")
    axes.set_xlabel("probability told")
    axes.set_ylabel("share that came true")
    return figure
