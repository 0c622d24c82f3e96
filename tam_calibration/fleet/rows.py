"""Counts, drifts and troubles of a batch, in numbers and as rows of text."""

from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime

from tam_calibration.fleet.missions import ParameterDrift, by_platform
from tam_calibration.fleet.task import ANSWERS, Result
from tam_calibration.report.formatting import number, with_error

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


def law_points(results: Sequence[Result]) -> list[str]:
    """Return each law of a gap of each platform, in how many recordings it is and since when, the most frequent first.

    Parameters
    ----------
    results : sequence of Result
        Sorted by platform and time.
    """
    groups: dict[tuple[str, str], list[Result]] = {}
    for result in results:
        for law in () if result.gap is None else result.gap.get("laws", ()):
            groups.setdefault((result.platform, law), []).append(result)
    ranked = sorted(groups.items(), key=lambda item: -len(item[1]))
    return [f"{platform}, {law}: {_occurrences(some)}" for (platform, law), some in ranked]


def _occurrences(results: Sequence[Result]) -> str:
    begins = [result.time_span_s[0] for result in results if result.time_span_s]
    since = f", since {datetime.fromtimestamp(min(begins), UTC):%Y-%m-%d}" if begins else ""
    return f"{len(results)} recording{'s' * (len(results) > 1)}{since}"


COUNTS_HEADER = ("platform", *COLUMNS, "causes")
DRIFT_HEADER = ("platform", "sensor", "parameter", "missions", "drift per day", "over its error", "scatter", "mean")


def count_rows(results: Sequence[Result]) -> list[list[str]]:
    """Return a row for each platform, under ``COUNTS_HEADER``."""
    rows = []
    for platform, some in by_platform(results).items():
        causes = ", ".join(f"{cause} {times}" for cause, times in causes_of(some).items())
        rows.append([platform, *map(str, counts_of(some).values()), causes or "–"])
    return rows


def drift_row(found: ParameterDrift) -> list[str]:
    """Return the row of a drift, under ``DRIFT_HEADER``."""
    drift, unit = found.drift, f" ({found.kind.sign})" if found.kind.sign else ""
    return [
        found.platform,
        str(found.sensor),
        found.name + unit,
        str(drift.missions),
        with_error(drift.per_day, drift.per_day_standard_error, 6),
        number(drift.significance),
        number(drift.scatter),
        with_error(drift.mean, drift.mean_standard_error, 6),
    ]


def largest(drifts: Sequence[ParameterDrift]) -> list[ParameterDrift]:
    """Return the drift of each platform and kind of parameter that stands out most over its standard error."""
    kinds: dict[tuple[str, str], ParameterDrift] = {}
    for found in drifts:
        key = found.platform, found.kind.name
        if abs(found.drift.significance) > (abs(kinds[key].drift.significance) if key in kinds else 0.0):
            kinds[key] = found
    return list(kinds.values())


def open_points(results: Sequence[Result]) -> list[str]:
    """Return for each recording that is not settled what is the matter with it."""
    points = []
    for result in results:
        statement = "" if result.gap is None or result.is_settled else f"{result.gap['statement']}"
        if words := "; ".join(part for part in (result.trouble, statement) if part):
            points.append(f"{result.platform}/{result.recording}: {result.status}; {words}")
    return points
