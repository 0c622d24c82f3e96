"""Residuals as the panels of figures, in nT and nT/m, each with its noise floor."""

from tam_calibration.array import OUTPUT_NAMES, TENSOR_OUTPUTS
from tam_calibration.report.residual_plots import Panel
from tam_calibration.residuals import Residuals, ResidualSeries
from tam_calibration.units import to_nanotesla

COMPONENT_NAMES = tuple(OUTPUT_NAMES[output][1:] for output in TENSOR_OUTPUTS)
"""Names of the independent tensor components: xx, xy, xz, yy, yz."""


def intensity_panels(series: ResidualSeries, floor: Residuals) -> list[Panel]:
    """Return a panel of |B| − reference for each sensor and, of more than one, for their centre."""
    sensors = zip(series.sensor_intensity_T.T, floor.sensor_intensity_T, strict=True)
    panels = [
        Panel(f"sensor {i + 1}", to_nanotesla(values), to_nanotesla(float(noise)))
        for i, (values, noise) in enumerate(sensors)
    ]
    if len(panels) > 1:
        panels.append(Panel("centre", to_nanotesla(series.center_intensity_T), to_nanotesla(floor.center_intensity_T)))
    return panels


def tensor_panels(series: ResidualSeries, floor: Residuals) -> list[Panel]:
    """Return a panel for each independent component of the gradient tensor."""
    components = zip(COMPONENT_NAMES, series.tensor_T_per_m.T, floor.tensor_T_per_m, strict=True)
    return [Panel(name, to_nanotesla(values), to_nanotesla(float(noise))) for name, values, noise in components]
