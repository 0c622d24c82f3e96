"""A map of the field as netCDF, by the conventions CF-1.8: QGIS, GMT and xarray read it."""

from pathlib import Path

import numpy as np

from tam_calibration.localization.field_map import FieldMap
from tam_calibration.model.units import to_nanotesla
from tam_calibration.recordings.navigation import geographic
from tam_calibration.results.targets_file import Origin


def write_map(path: Path, field: FieldMap, origin: Origin | None = None) -> None:
    """Write a map; with an origin its axes are latitude and longitude.

    Parameters
    ----------
    path : Path
        The file.
    field : FieldMap
        The map.
    origin : tuple of float, optional
        Latitude and longitude, degrees, and height, metres, of the position 0, 0.
    """
    from scipy.io import netcdf_file

    x, y = ("x", "x_m", "m", field.x_m), ("y", "y_m", "m", field.y_m)
    if origin is not None:
        places = np.zeros((len(field.x_m) + len(field.y_m), 3))
        places[: len(field.x_m), 0], places[len(field.x_m) :, 1] = field.x_m, field.y_m
        degrees = geographic(places, np.array(origin))
        x = ("lon", "longitude", "degrees_east", degrees[: len(field.x_m), 1])
        y = ("lat", "latitude", "degrees_north", degrees[len(field.x_m) :, 0])
    with netcdf_file(path, "w") as file:
        file.Conventions = "CF-1.8"
        for name, meaning, unit, values in (y, x):
            file.createDimension(name, len(values))
            axis = file.createVariable(name, "f8", (name,))
            axis[:] = values
            axis.units, axis.long_name = unit, meaning
        for name, unit, values in (
            ("anomaly_nT", "nT", to_nanotesla(field.anomaly_T)),
            ("contraction_nT_per_m", "nT m-1", to_nanotesla(field.contraction_T_per_m)),
        ):
            grid = file.createVariable(name, "f4", (y[0], x[0]))
            grid[:] = values
            grid.units = unit
