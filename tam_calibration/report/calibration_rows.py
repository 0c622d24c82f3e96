"""The parameters and effects of a calibration as rows of text, for the page and for the terminal."""

from tam_calibration.correction.calibration import Calibration
from tam_calibration.effects.library import units_of
from tam_calibration.model.array import OUTPUT_NAMES
from tam_calibration.model.sensor_errors import PARAMETER_NAMES, orientation_to_axes
from tam_calibration.model.units import to_degrees, to_nanotesla
from tam_calibration.report.formatting import number, with_error

_KINDS = (("", 1.0, 6), (" (°)", to_degrees(1.0), 5), (" (nT)", to_nanotesla(1.0), 2), (" (°)", to_degrees(1.0), 5))
"""Unit, factor from SI and decimals of scale factor, non-orthogonality, bias and misalignment."""


def parameter_rows(calibration: Calibration) -> list[list[str]]:
    """Return a row for each parameter: its name with the unit, then value ± standard error of each sensor."""
    values, standard_errors = calibration.errors.to_vector(), calibration.standard_errors
    rows = []
    for index, name in enumerate(PARAMETER_NAMES):
        unit, factor, decimals = _KINDS[index // 3]
        pairs = zip(values[:, index] * factor, standard_errors[:, index] * factor, strict=True)
        rows.append([name + unit, *(with_error(float(value), float(error), decimals) for value, error in pairs)])
    mounted = [" ".join(orientation_to_axes(orientation)) for orientation in calibration.errors.orientation]
    if set(mounted) != {"x y z"}:
        rows.append(["mounted with its axes along the array's", *mounted])
    return rows


NUMBERS_HEADER = ("effect", "parameter", "value ± standard error", "unit")


def effect_number_rows(calibration: Calibration) -> list[list[str]]:
    """Return the numbers of all effects in the order of ``NUMBERS_HEADER``."""
    if not calibration.effects:
        return []  # without the diagnosis, which takes as long to load as a calibration
    from tam_calibration.report.gap_rows import number_rows

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
