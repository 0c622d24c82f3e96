"""The effects of a calibration as rows of text, for the page and for the terminal."""

from tam_calibration.array import OUTPUT_NAMES
from tam_calibration.calibration import Calibration
from tam_calibration.effects.numbers import units_of
from tam_calibration.report.formatting import number
from tam_calibration.report.gap_rows import number_rows
from tam_calibration.units import to_nanotesla

NUMBERS_HEADER = ("effect", "parameter", "value ± standard error", "unit")


def effect_number_rows(calibration: Calibration) -> list[list[str]]:
    """Return the numbers of all effects in the order of ``NUMBERS_HEADER``."""
    return [
        [fitted.effect, *row]
        for fitted in calibration.effects
        for row in number_rows(fitted, units_of(fitted, calibration.errors, calibration.array))
    ]


def effect_size_rows(calibration: Calibration) -> list[list[str]]:
    """Return what is taken off each output, root mean square: the effect, nine outputs in nT and nT/m."""
    return [
        [fitted.effect, *(number(to_nanotesla(float(value))) for value in size.rms)]
        for fitted, size in zip(calibration.effects, calibration.effect_sizes, strict=True)
        if size.rms.any()
    ]


def effect_size_header() -> list[str]:
    """Return the names of the columns of ``effect_size_rows``."""
    return ["effect", *(f"{name} ({'nT' if name.startswith('b') else 'nT/m'})" for name in OUTPUT_NAMES)]
