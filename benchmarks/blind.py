"""The check on withheld effects: cases from a seed, their diagnosis, their score.

Run ``python benchmarks/blind.py --seed SEED [--cases 600] [--kinds KIND] [--outside SET] [--folder KEPT] [--judged]``;
``--kinds`` may be given several times. Every recording is made by ``tam blind make``, diagnosed by ``tam diagnose``
from its two files alone, once more with its true effect left out of the library, and scored against the sealed keys.
With ``--judged`` the figures go to ``results/blind*.csv`` and into ``docs/explanation/gap_check.md``, with the pictures
of its confusion matrix and reliability curve; the seed must then be one that nothing was tuned on, and the causes
outside the library a set that nothing was.
What the figures are, and what is asked of them, is described in ``docs/explanation/gap_check.md``.
"""

import re
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import click
from matplotlib.figure import Figure
from rich.console import Console

from tam_calibration.files.text_files import write_whole
from tam_validation.blind import KINDS, SETS
from tam_validation.blind.folder import TIMES, read_json, read_keys, read_outcomes
from tam_validation.blind.score import Score
from tam_validation.blind.score_table import HEADER, cells, print_score, remarks

RESULTS = Path(__file__).parent / "results"
DOCS = Path(__file__).parents[1] / "docs"
PRINTED = HEADER[:5]
"""Columns of the documentation."""
MARKS = ("<!-- figures: written by benchmarks/blind.py -->", "<!-- end of figures -->")


@click.command()
@click.option("--seed", type=click.IntRange(min=0), required=True)
@click.option("--cases", default=600, show_default=True)
@click.option("--kinds", type=click.Choice(KINDS), multiple=True, help="Kinds of cases.  [default: all]")
@click.option("--outside", type=click.Choice(SETS), default=SETS[0], show_default=True, help="Set of unknown causes.")
@click.option("--folder", type=click.Path(path_type=Path), help="Keep the cases here; they are answered anew.")
@click.option("--judged", is_flag=True, help="Write the results and the figures of the documentation.")
def main(seed: int, cases: int, kinds: tuple[str, ...], outside: str, folder: Path | None, judged: bool) -> None:
    """Make, answer and score cases, and print the figures."""
    asked = ["--seed", seed, "--cases", cases, *(word for kind in kinds for word in ("--kinds", kind))]
    asked += ["--outside", outside]
    with TemporaryDirectory() as passing:
        place = folder or Path(passing) / "cases"
        if not place.exists():
            tam("make", place, *asked)
        tam("answer", place)
        tam("answer", place, "--without-effect")
        keys = read_keys(place, None)
        score = Score(read_outcomes(place, keys, "answer.json"), read_outcomes(place, keys, "answer_without.json"))
        times_s = read_json(place / TIMES)
    print_score(Console(width=120), score, times_s)
    if judged:
        write_results(score)
        git = ["git", "-C", str(DOCS), "rev-parse", "--short", "HEAD"]
        commit = subprocess.run(git, check=True, capture_output=True, text=True).stdout.strip()
        document(score, times_s, f"python benchmarks/blind.py {' '.join(map(str, asked))} --judged", commit)


def tam(*words: object) -> None:
    """Run a command of the check, and end where it fails: it has said why."""
    if code := subprocess.run([sys.executable, "-m", "tam_calibration", "blind", *map(str, words)]).returncode:
        sys.exit(code)


def write_results(score: Score) -> None:
    """Write figures, confusion matrix and reliability curve as CSV."""
    figures = [(f'"{row.name}"', row.size, *cells(row)[2:4], *cells(row)[5:]) for row in score.rows]
    header = (*HEADER[:4], *HEADER[5:])
    counts = [(truth, told, str(n)) for truth, own in score.confusion.items() for told, n in own.most_common()]
    curve = [(f"{one.told:.4f}", f"{one.true:.4f}", str(one.count)) for one in score.reliability]
    write_csv("blind.csv", header, figures)
    write_csv("blind_confusion.csv", ("truth", "first answer", "cases"), counts)
    write_csv("blind_reliability.csv", ("told", "true", "statements"), curve)


def write_csv(name: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Write one table of results."""
    with write_whole(RESULTS / name) as beside:
        beside.write_text("\n".join(map(",".join, [header, *rows])) + "\n", encoding="utf-8")


def document(score: Score, times_s: dict[str, float], command: str, commit: str) -> None:
    """Put the figures between their marks in the documentation, and draw the pictures."""
    draw_confusion(score).savefig(DOCS / "images" / "gap_confusion.png", dpi=110)
    draw_reliability(score).savefig(DOCS / "images" / "gap_reliability.png", dpi=110)
    figures = [
        f"Made by `{command}` at commit {commit}, on cases that nothing was tuned on.",
        markdown(PRINTED, [cells(row)[: len(PRINTED)] for row in score.rows if is_printed(row.name, cells(row)[2])]),
        "\n".join(f"- {line}" for line in remarks(score, times_s)),
        "![How often each answer came first; rows are the truth](../images/gap_confusion.png)",
        "![Observed against predicted frequencies](../images/gap_reliability.png)",
    ]
    put(DOCS / "explanation" / "gap_check.md", figures)


def is_printed(name: str, asked: str) -> bool:
    """Return whether the documentation has a figure; ``results/blind.csv`` has all."""
    return bool(asked) and not name.startswith(("the same", "among", "axis"))


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
    """Draw the observed rate of true causes over their stated probability."""
    figure = Figure(figsize=(4.5, 4.5), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color="0.7")
    axes.plot([one.told for one in score.reliability], [one.true for one in score.reliability], "o-")
    axes.set_xlabel("probability told")
    axes.set_ylabel("share that came true")
    return figure


def put(path: Path, parts: Sequence[str]) -> None:
    """Put paragraphs between the marks of a page."""
    between = re.compile(f"{re.escape(MARKS[0])}.*?{re.escape(MARKS[1])}", re.DOTALL)
    text = between.sub(lambda _: "\n\n".join([MARKS[0], *parts, MARKS[1]]), path.read_text(encoding="utf-8"))
    with write_whole(path) as beside:
        beside.write_text(text, encoding="utf-8")


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '∣') for cell in line)} |" for line in lines)


if __name__ == "__main__":
    main()
