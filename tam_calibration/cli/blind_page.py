"""The score of the check on withheld effects as an HTML page, with the confusion matrix and the reliability curve."""

from pathlib import Path

from matplotlib.figure import Figure

from tam_calibration.blind.score import Score
from tam_calibration.cli.blind_table import HEADER, cells, effects, reliability, remarks, shares
from tam_calibration.report.page import Image, Points, Section, Table, Text, embed, render


def write_page(path: Path, score: Score, name: str) -> None:
    """Write the page."""
    missed = [row.name for row in score.rows if row.cases and not row.is_met]
    verdict = Text(f"Missed: {'; '.join(missed)}.", "doubt") if missed else Text("Every figure is met.", "good")
    sections = [
        Section("Figures asked for", [verdict, Table(HEADER, [cells(row) for row in score.rows])]),
        Section("What was named for what", [_picture_of_confusion(score), Points(remarks(score, {}))]),
        Section(
            "Probabilities",
            [_picture_of_reliability(score), Table(("told", "true", "statements"), reliability(score))],
        ),
        Section("Effect by effect", [Table(("effect", "solved", "amplitude left"), effects(score))]),
        Section("By condition", [Table(("condition", "solved", "of"), shares({**score.by_condition, **score.short}))]),
        Section("Cases that went wrong", [Points([one.line for one in score.failures] or ["none"])]),
    ]
    path.write_text(render("The check on withheld effects", name, sections), encoding="utf-8")


def _picture_of_confusion(score: Score) -> Image:
    truths = list(score.confusion)
    named = {answer for counts in score.confusion.values() for answer in counts}
    answers = [truth for truth in truths if truth in named] + sorted(named - set(truths))
    figure = Figure(figsize=(9, 8), layout="constrained")
    axes = figure.add_subplot()
    shares = [[counts[answer] / counts.total() for answer in answers] for counts in score.confusion.values()]
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for row, counts in enumerate(score.confusion.values()):
        for column, answer in enumerate(answers):
            if counts[answer]:
                dark = counts[answer] > counts.total() / 2
                axes.text(
                    column, row, str(counts[answer]), ha="center", va="center", color="white" if dark else "black"
                )
    axes.set_xticks(range(len(answers)), answers, rotation=60, ha="right")
    axes.set_yticks(range(len(truths)), truths)
    axes.set_xlabel("first answer")
    axes.set_ylabel("truth")
    return embed(figure, "confusion matrix", "How often each answer came first; rows are the truth.")


def _picture_of_reliability(score: Score) -> Image:
    figure = Figure(figsize=(4.5, 4.5), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color="0.7")
    axes.plot([one.told for one in score.reliability], [one.true for one in score.reliability], "o-")
    axes.set_xlabel("probability told")
    axes.set_ylabel("share that came true")
    return embed(figure, "reliability curve", "What came true of what was told; on the line it is as told.")
