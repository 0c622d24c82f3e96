"""The parameters with their standard errors as rows of text, for the page and for the terminal."""

from tam_calibration.calibration import Calibration
from tam_calibration.report.formatting import with_error
from tam_calibration.sensor_errors import PARAMETER_NAMES
from tam_calibration.units import to_degrees, to_nanotesla

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
    return rows
