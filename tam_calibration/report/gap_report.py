"""The report on a gap, in the order of its questions: whether there is one, where, why, how far it shrinks."""

from pathlib import Path

from tam_calibration.correction.parts import Provenance
from tam_calibration.gap.laws.law import causes_of
from tam_calibration.gap.result import Gap
from tam_calibration.report import gap_plots, gap_rows
from tam_calibration.report.blocks import Block, Points, Section, Text, count, counted, sentence
from tam_calibration.report.gap_rows import first_sentence, law_blocks, law_sentence
from tam_calibration.report.page import figure_blocks, write_page


def checks_blocks(view: gap_plots.GapView) -> list[Block]:
    """Return the statistics of the residual with the causes and their ranges in noise; none without a verdict."""
    checks = view.gap.checks
    if checks is None:
        return []
    compared = "With its causes the recording would look like its simulated twin, which has noise alone"
    if not checks.sentences:
        words = f"{compared}, and so it does: every statistic of every axis is in the range of noise."
        return [Text(words, "good")]
    words = f"{compared}, if nothing else were in it. It does not:"
    return [Text(words), Points(checks.sentences)]


_TERMS = (
    "The simulated twin is a recording made by the computer: the same attitudes and field, the sensor errors that were "
    "fitted, the noise of the recording, and nothing else. Whatever the recording shows and its twin does not is the "
    "gap.",
    "A residual is a reading minus the fitted model: the shift of that one axis that would "
    "explain the sample best. A fault of one axis casts a weaker image on the others and on the scalar, since "
    "each sample alone cannot tell which of them is at fault.",
    "The noise floor is the standard deviation that white noise alone gives a residual. The size of the gap is what "
    "the residual has beyond it: 1 means as large as the noise, 0 none.",
    "Out of sample: measured on parts of the recording that were not used to fit what is tested.",
)


def _where(view: gap_plots.GapView) -> list[Block]:
    """Return the sensors, axes, times and directions of the gap."""
    row = view.rows[0]
    name = view.row_name(row)
    words = gap_rows.where_words(view.gap)
    found = f"The gap lies in: {words}." if view.gap.where.sensors else "No place stands out."
    band = "" if view.gap.where.frequency_hz is None else "; the band of the gap is shaded"
    return [
        Text(f"{found} This was found without assuming a cause. Figures of one axis show {name}, the largest there."),
        *figure_blocks(
            gap_plots.plot_map(view),
            "Which sensor and axis",
            "the size of each residual against its noise floor, dark where it is too large.",
            "every cell would be near 1, as in the twin.",
        ),
        *figure_blocks(
            gap_plots.plot_sphere(view.states, row),
            "Which attitude",
            "the mean residual over the directions of the field, seen from the array; cells without samples are white.",
            "a faint random pattern, as in the twin; a smooth pattern is an effect that depends on attitude.",
        ),
        *figure_blocks(
            gap_plots.plot_spectrum(view, row),
            "Which frequency",
            f"the residual by frequency, in noise floors{band}.",
            "a flat line near 1. A rise to the left is slow (drift), a narrow peak is interference.",
        ),
        *figure_blocks(
            gap_plots.plot_dependence(view, row),
            "Which condition",
            "the residual over the rate of turning, and over temperature and current where they were recorded.",
            "flat lines near the dashed one. A slope says that the residual goes with that quantity, not yet why.",
        ),
    ]


def _causes(view: gap_plots.GapView) -> list[Block]:
    """Return the causes, ranked, with their parameters."""
    gap = view.gap
    blocks = figure_blocks(
        gap_plots.plot_evidence(gap),
        "What can be the cause",
        "the probability of each cause, of no gap at all, and of a cause that is not in the library; what the data "
        "support is blue.",
        "“no gap” would have the longest bar.",
    )
    if not gap.causes:
        return [Text("No effect of the library is supported by these data."), *blocks]
    return [*blocks, *gap_rows.cause_blocks(gap)]


def _shrinkage(view: gap_plots.GapView) -> list[Block]:
    """Return how far the gap shrinks with the causes added."""
    blocks: list[Block] = []
    shaded = "" if view.gap.where.time_s is None else "; the span of the gap is shaded"
    for row in view.rows:
        blocks += figure_blocks(
            gap_plots.plot_time(view, row),
            f"Over time: {view.row_name(row)}",
            f"the residual of each sample; dashed lines are ± the noise floor{shaded}.",
            "all panels would look like the twin's.",
        )
    blocks += figure_blocks(
        gap_plots.plot_histogram(view.states, view.rows[0]),
        "Distribution",
        "how often the residual has which size; what lies further out is counted in the outermost bins.",
        "all lines would follow the dashed one. Broad shoulders are a slow or large effect, far tails are outliers.",
    )
    return blocks


def _considered(gap: Gap) -> list[Block]:
    """Return the effects that were tried and have no evidence."""
    others = [each for each in gap.considered if each.status != "supported"]
    words = Text("These were tried, or could not be, and are no cause as far as these data tell.")
    return [words, gap_rows.hypotheses(others)] if others else []


def _signature(view: gap_plots.GapView) -> list[Block]:
    """Return what the gap does, where and when, and what could do that; nothing without a law."""
    if not view.gap.signature:
        return []
    blocks = [Text(first_sentence(view.gap), "doubt"), *law_blocks(view.gap)]
    for law in view.gap.signature:
        if law.curve is not None:
            blocks += figure_blocks(
                gap_plots.plot_course(law.curve),
                f"Course: {law_sentence(law, view.gap)}",
                "the size of the disturbance, with a band of two standard errors on either side.",
                "no curve: noise has no course.",
            )
    for cause in causes_of(view.gap.signature[0], view.gap.named):
        size = f" In nature: {cause.size}." if cause.size else ""
        title = f"{cause.title[:1].upper()}{cause.title[1:]}. {cause.physics}"
        blocks.append(Text(f"{title}{size} To prove it: {cause.proof}. Then: {cause.remedy}."))
    return blocks


def write_gap_report(path: Path, gap: Gap, source: Provenance | None = None) -> None:
    """Write a self-contained HTML page about a gap.

    Parameters
    ----------
    path : Path
        File to write; nothing is left there when writing fails, and an older file stays as it was.
    gap : Gap
        The diagnosis.
    source : Provenance, optional
        The recording diagnosed.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    view = gap_plots.GapView(gap)
    verdict = [*gap_rows.verdict_blocks(gap), Text("Words of this page:"), Points(_TERMS)]
    sections = [Section("What the gap does", _signature(view)), Section("Verdict", verdict)]
    if gap.verdict != "not_identifiable":
        sections += [
            Section("Where it lies", _where(view)),
            Section("Causes, ranked" if gap.causes else "Causes", _causes(view)),
            Section("How far it shrinks" if gap.causes else "The residuals", _shrinkage(view)),
        ]
    sections += [
        Section("Against the simulated twin", checks_blocks(view)),
        Section("What explained nothing", _considered(gap)),
        Section("What to record next", [Text(sentence(gap.next_recording))] if gap.next_recording else []),
    ]
    parts = [counted(gap.sensor_count, "sensor"), f"{count(len(gap.residue.time_s))} samples"]
    if source is not None:
        parts = [source.name, *parts, f"SHA-256 {source.sha256}"]
    write_page(path, "The gap between recording and simulation", ", ".join(parts), sections)
