"""The page on where a source is."""

from collections.abc import Callable
from pathlib import Path

from tam_calibration.localization.survey import Survey
from tam_calibration.report.formatting import count, fixed
from tam_calibration.report.page import Block, Points, Section, Table, embed, sections_of, write_page
from tam_calibration.report.survey_plots import plot_source_spectrum, plot_survey_map
from tam_calibration.report.survey_rows import HEADER, MOST_ROWS, overall_rows, sample_rows, statements

_MAP = "The source in plan and in profile, with ellipses that hold 95 %; the array, or its track, for scale. "
_MAGNIFIED = "Below, magnified, the source of all samples together among those of single samples."
_SPECTRUM = "Power of all readings over that of their noise, background taken off; dashed what chance reaches."
_SAMPLES = f"Position ± standard error of samples by themselves; of more than {MOST_ROWS} some from first to last."


def where_section(survey: Survey) -> Section:
    """Return the map of the source, and where it is in numbers and words."""
    blocks: list[Block] = []
    if survey.overall is not None:
        for number, one in enumerate((survey.overall, *survey.further), 1):
            which = f"Source {number}" if survey.further else "The source"
            words = f"{which} of all samples together ± standard errors."
            blocks.append(Table(["", "x", "y", "z", "size"], overall_rows(one), words))
    elif len(survey.time_s) == 1:
        blocks.append(Table(HEADER, sample_rows(survey), "The source ± standard errors."))
    caption = _MAP if survey.overall is None else _MAP + _MAGNIFIED
    picture = embed(plot_survey_map(survey), "Map of the source in plan and profile", caption)
    return Section("Where the source is", [*blocks, picture, Points(statements(survey))])


def spectrum_section(survey: Survey) -> Section | None:
    """Return the spectrum in which the frequency of an alternating source was found."""
    if survey.line is None or survey.line.spectrum is None:
        return None
    figure = plot_source_spectrum(survey.line.spectrum, survey.line.frequency_hz)
    words = f"Spectrum of the readings with a line at {fixed(survey.line.frequency_hz, 4)} Hz"
    return Section("Spectrum", [embed(figure, words, _SPECTRUM)])


def samples_section(survey: Survey) -> Section | None:
    """Return where single samples see the source."""
    rows = sample_rows(survey)
    return Section("Samples", [Table(HEADER, rows, _SAMPLES)]) if rows else None


SECTIONS: tuple[Callable[[Survey], Section | None], ...] = (where_section, spectrum_section, samples_section)
"""In the order in which they are read."""


def write_survey_report(path: Path, survey: Survey, recording_name: str) -> None:
    """Write a self-contained HTML page on where the source of a recording is.

    Parameters
    ----------
    path : Path
        File to write; nothing is left there when writing fails.
    survey : Survey
        What was found.
    recording_name : str
        Of the recording's file.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    subtitle = f"{recording_name}, {count(len(survey.time_s))} {'poses' if survey.line else 'samples'}"
    write_page(path, "Source report", subtitle, sections_of(SECTIONS, survey))
