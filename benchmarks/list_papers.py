"""Write the tables of ``benchmarks/papers.md``: compared numbers from the kept results, all others from the code.

Run ``python benchmarks/list_papers.py`` after ``tam reproduce all``; a test compares page, results and code.
"""

import csv
from collections import Counter
from pathlib import Path

from tam_validation.papers import PAPERS
from tam_validation.papers.printed import not_compared
from tam_validation.papers.tables import STATUSES

PAGE = Path(__file__).parent / "papers.md"
RESULTS = Path(__file__).parent / "results"
BEGIN, END = "<!-- papers: written by benchmarks/list_papers.py -->\n", "<!-- end of papers -->\n"

_SOURCES = ("printed", "derived from printed numbers", "said in words")


def papers_tables() -> str:
    """Return how many numbers of each paper are compared, with what outcome, and the list of what is not."""
    columns = ["paper", "numbers", *_SOURCES, *STATUSES]
    counts = [_row(columns), _row(["---"] * len(columns)), *(_row(_counts(paper)) for paper in PAPERS)]
    absent = [_row([paper, *item]) for paper in PAPERS for item in not_compared(paper).items()]
    return "\n".join([*counts, "", "| paper | not compared | reason |", "|---|---|---|", *absent, ""])


def _counts(paper: str) -> list[str]:
    _, *lines = (RESULTS / f"reproduce_{paper}.csv").read_text(encoding="utf-8").splitlines()
    rows = list(csv.DictReader(lines))
    source, status = (Counter(row[key] for row in rows) for key in ("source", "status"))
    numbers = [len(rows), *(source[each] for each in _SOURCES), *(status[each] for each in STATUSES)]
    return [f"`{paper}`", *map(str, numbers)]


def _row(texts: list[str]) -> str:
    return f"| {' | '.join(texts)} |"


def with_tables(page: str) -> str:
    """Return the text of the page with the tables in their place."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}{papers_tables()}{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
