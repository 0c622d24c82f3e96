"""How many recordings of a platform were done, what their gaps are, and which causes were found."""

from collections import Counter
from collections.abc import Sequence

from tam_calibration.fleet.result import ANSWERS, Result

COLUMNS = ("recordings", "done", "refused", "failed", "no gap", "explained", "open")


def counts_of(results: Sequence[Result]) -> dict[str, int]:
    """Return the number of recordings by status and by verdict, by the names of ``COLUMNS``."""
    status = Counter(result.status for result in results)
    verdicts = Counter(result.verdict for result in results if result.verdict)
    return {
        "recordings": len(results),
        "done": status["done"],
        "refused": status["refused"],
        "failed": status["failed"],
        "no gap": verdicts["no_gap"],
        "explained": verdicts["explained"],
        "open": sum(number for verdict, number in verdicts.items() if verdict not in ANSWERS),
    }


def causes_of(results: Sequence[Result]) -> dict[str, int]:
    """Return in how many recordings each cause was found, the most frequent first."""
    causes = Counter(cause for result in results if result.gap for cause in result.gap["causes"])
    return dict(sorted(causes.items(), key=lambda item: (-item[1], item[0])))
