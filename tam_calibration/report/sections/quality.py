"""Residuals in and out of sample against the noise floor, and the noise behind it."""

from tam_calibration.calibration import Calibration
from tam_calibration.report.evidence import Evidence
from tam_calibration.report.formatting import join, number, ratio
from tam_calibration.report.page import Section, Table, Text
from tam_calibration.report.panels import COMPONENT_NAMES
from tam_calibration.residuals import Residuals
from tam_calibration.units import to_nanotesla

_CHANNELS = {"differential": "between the sensors", "common_mode": "against the reference intensity"}


def build(evidence: Evidence) -> Section:
    """Return the section."""
    calibration = evidence.calibration
    return Section("Quality", [_residuals(calibration), Text(_chi_square(calibration)), Text(_noise(calibration))])


def _residuals(calibration: Calibration) -> Table:
    after = {"in sample": calibration.in_sample}
    caption = "Root mean square residuals. No samples were held out."
    if calibration.held_out is not None:
        after["out of sample"] = calibration.held_out
        caption = "Root mean square residuals. Out of sample: samples that the fit did not see."
    states = {"before": calibration.before, **after, "noise floor": calibration.floor}
    columns = {name: _figures(state, calibration.array.has_gradient) for name, state in states.items()}
    rows = []
    for quantity, floor in columns["noise floor"].items():
        ratios = [ratio(columns[name][quantity] / floor) for name in after]
        rows.append([quantity, *(number(column[quantity]) for column in columns.values()), *ratios])
    return Table(["residual", *columns, *(f"{name} / floor" for name in after)], rows, caption)


def _figures(residuals: Residuals, has_gradient: bool) -> dict[str, float]:
    """Return all residuals in nT and nT/m by name."""
    sensors = residuals.sensor_intensity_T
    figures = {f"|B|, sensor {sensor + 1} (nT)": float(value) for sensor, value in enumerate(sensors)}
    if len(sensors) > 1:
        figures["|B|, centre (nT)"] = residuals.center_intensity_T
    if has_gradient:
        components = zip(COMPONENT_NAMES, residuals.tensor_T_per_m, strict=True)
        figures |= {f"tensor {name} (nT/m)": float(value) for name, value in components}
        figures["tensor, all five (nT/m)"] = residuals.tensor_rmse_T_per_m
    return {name: to_nanotesla(value) for name, value in figures.items()}


def _chi_square(calibration: Calibration) -> str:
    if not calibration.reduced_chi_square:
        return "There is no redundancy, hence no reduced χ²."
    values = [f"{number(value)} {_CHANNELS.get(name, name)}" for name, value in calibration.reduced_chi_square.items()]
    return f"Reduced χ²: {join(values)}; it is 1 where noise alone is left."


def _noise(calibration: Calibration) -> str:
    array = calibration.array
    assert array.vector_noise_T is not None
    noises = [number(to_nanotesla(float(value))) for value in array.vector_noise_T]
    vector = f"{noises[0]} nT for every sensor" if len(set(noises)) == 1 else f"{join(noises)} nT, sensor by sensor"
    scalar = ""
    if calibration.has_scalar_reference and array.scalar_noise_T is not None:
        scalar = f"; of the scalar magnetometer: {number(to_nanotesla(array.scalar_noise_T))} nT"
    origin = "estimated from this recording where it was not" if calibration.noise_is_estimated else "as"
    return f"Noise per axis: {vector}{scalar}; {origin} stated for the array."
