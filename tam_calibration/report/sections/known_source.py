"""What a known source showed of the array, where one was recorded."""

import numpy as np

from tam_calibration.calibration import Calibration, KnownSource
from tam_calibration.report.evidence import Evidence
from tam_calibration.report.formatting import number, with_error
from tam_calibration.report.page import Section, Table, Text
from tam_calibration.units import to_degrees

_INTRODUCTION = (
    "A uniform field sees neither the length of the baselines, nor a turn of all sensors together, nor where the "
    "elements of the axes sit. The field of a known source did; array and matrices on this page hold what it showed."
)
_COMMON = "Value ± standard error, of the noise of the source's amplitudes; the source itself counts as exact."
_PLACES = "Place of the element of each axis beside its sensor (mm), array frame ± standard error."
_DOUBTFUL = 2.0
"""Reduced χ² above which source and array do not fit each other."""


def build(evidence: Evidence) -> Section | None:
    """Return the section, or None where no source was known."""
    calibration = evidence.calibration
    found = calibration.known_source
    if found is None:
        return None
    return Section("Known source", [Text(_INTRODUCTION), _common(found), *_verdict(found), _places(calibration, found)])


def _common(found: KnownSource) -> Table:
    turns = zip("xyz", to_degrees(found.rotation), to_degrees(found.rotation_standard_errors), strict=True)
    rows = [
        ["true baselines over stated", with_error(found.baseline_scale, found.baseline_scale_standard_error, 4)],
        *([f"turn of the frame about {axis} (°)", with_error(float(v), float(e), 4)] for axis, v, e in turns),
        ["reduced χ²", number(found.reduced_chi_square)],
    ]
    return Table(["quantity", "value"], rows, _COMMON)


def _verdict(found: KnownSource) -> list[Text]:
    if found.reduced_chi_square <= _DOUBTFUL:
        return []
    return [
        Text(
            f"Reduced χ² is {number(found.reduced_chi_square)} where 1 is expected: the source is not quite where or "
            "what it was stated to be, or the array has an error of another kind; the standard errors are too small.",
            "doubt",
        )
    ]


def _places(calibration: Calibration, found: KnownSource) -> Table:
    offsets = calibration.array.axis_offsets_m
    assert offsets is not None
    errors = found.axis_offsets_standard_errors_m
    rows = [
        [f"{sensor + 1} {'xyz'[axis]}", *_millimetres(offsets[sensor, axis], errors[sensor, axis])]
        for sensor, axis in np.ndindex(*offsets.shape[:2])
    ]
    return Table(["sensor, axis", "x", "y", "z"], rows, _PLACES)


def _millimetres(values: np.ndarray, errors: np.ndarray) -> list[str]:
    pairs = zip(1e3 * values, 1e3 * errors, strict=True)
    return [with_error(float(value), float(error), 2) for value, error in pairs]
