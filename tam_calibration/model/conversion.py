"""The values of a recording as a table of pandas or a dataset of xarray; neither is loaded before it is asked for."""

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.further_channels import is_further, unit_of
from tam_calibration.model.units import FloatArray

if TYPE_CHECKING:
    import pandas
    import xarray

ATTITUDE_COLUMNS = ("qx", "qy", "qz", "qw")
"""Columns of the attitude in a table."""

RATE_COLUMNS = ("wx_rad_s", "wy_rad_s", "wz_rad_s")
"""Columns of the angular velocity in a table."""

POSITION_COLUMNS = ("x_m", "y_m", "z_m")
"""Columns of the position in a table; any other channel is one column of its own name."""

_OF_VECTORS = {"attitude": ATTITUDE_COLUMNS, "angular_velocity_rad_s": RATE_COLUMNS, "position_m": POSITION_COLUMNS}
_SINGLE_CHANNELS = ("scalar_T", "temperature_C", "current_A")

_TIME = ("time_s",)

_VARIABLES = {
    "readings_T": ("T", ("time_s", "sensor", "axis")),
    "scalar_T": ("T", _TIME),
    "temperature_C": ("degC", _TIME),
    "current_A": ("A", _TIME),
    "attitude": ("1", ("time_s", "quaternion")),
    "angular_velocity_rad_s": ("rad/s", ("time_s", "axis")),
    "position_m": ("m", ("time_s", "axis")),
}
"""Attribute ``units`` and dimensions of each variable of a dataset."""

_COMPONENTS = {"axis": ["x", "y", "z"], "quaternion": ["x", "y", "z", "w"]}
"""Labels of the dimensions whose order has a meaning."""


def reading_columns(sensor_count: int) -> list[str]:
    """Return the columns of the readings of so many sensors: b1x_T, b1y_T, b1z_T, b2x_T and so on."""
    return [f"b{sensor}{axis}_T" for sensor in range(1, sensor_count + 1) for axis in "xyz"]


def to_pandas(values: Mapping[str, FloatArray]) -> "pandas.DataFrame":
    """Return the table of a recording's values.

    Parameters
    ----------
    values : mapping of str to array
        The fields of a ``Recording`` that are there, by name.

    Raises
    ------
    InputError
        When pandas is not installed.
    """
    table = _library("pandas")
    readings = values["readings_T"]
    columns = dict(zip(reading_columns(readings.shape[1]), readings.reshape(len(readings), -1).T, strict=True))
    columns |= {name: values[name] for name in _SINGLE_CHANNELS if name in values}
    for name, own in _OF_VECTORS.items():
        if name in values:
            columns |= zip(own, values[name].T, strict=True)
    columns |= {name: channel for name, channel in values.items() if is_further(name)}
    return table.DataFrame(columns, index=table.Index(values["time_s"], name="time_s"))


def to_xarray(values: Mapping[str, FloatArray]) -> "xarray.Dataset":
    """Return the dataset of a recording's values.

    Parameters
    ----------
    values : mapping of str to array
        The fields of a ``Recording`` that are there, by name.

    Raises
    ------
    InputError
        When xarray is not installed.
    """
    numbers = np.arange(1, values["readings_T"].shape[1] + 1)
    variables = {}
    for name in [*(one for one in _VARIABLES if one in values), *filter(is_further, values)]:
        unit, dimensions = _variable(name)
        variables[name] = (dimensions, values[name], {"units": unit})
    used = {dimension for dimensions, _, _ in variables.values() for dimension in dimensions}
    labels = {name: label for name, label in _COMPONENTS.items() if name in used}
    time = ("time_s", values["time_s"], {"units": "s"})
    dataset: xarray.Dataset = _library("xarray").Dataset(variables, {"time_s": time, "sensor": numbers, **labels})
    return dataset


def from_xarray(dataset: "xarray.Dataset") -> dict[str, FloatArray]:
    """Return the values of a dataset as ``to_xarray`` makes it, in any order of its dimensions and components.

    Raises
    ------
    InputError
        When a variable, dimension or label is missing, or a variable or unit is another.
    """
    if others := [name for name in dataset.data_vars if name not in _VARIABLES and not is_further(str(name))]:
        raise InputError(f"variable {others[0]!r} is not known: a recording has {', '.join(_VARIABLES)}")
    if missing := [name for name in ("time_s", "readings_T") if name not in dataset.variables]:
        raise InputError(f"variable {missing[0]!r} is missing: a recording has {', '.join(('time_s', *_VARIABLES))}")
    values = {"time_s": np.asarray(dataset["time_s"], dtype=float)}
    for name in map(str, dataset.data_vars):
        variable = dataset[name]
        own_unit, dimensions = _variable(name)
        if (unit := variable.attrs.get("units", own_unit)) != own_unit:
            raise InputError(f"variable {name} is in {unit!r} and must be in {own_unit!r}")
        try:
            chosen = {each: _COMPONENTS[each] for each in dimensions if each in _COMPONENTS}
            values[name] = np.asarray(variable.transpose(*dimensions).sel(chosen), dtype=float)
        except (KeyError, ValueError) as problem:
            raise InputError(f"variable {name} must have the dimensions {dimensions}: {problem}") from None
    return values


def _variable(name: str) -> tuple[str, tuple[str, ...]]:
    """Return unit and dimensions of a variable; a further channel is one number for each time."""
    return _VARIABLES[name] if name in _VARIABLES else (unit_of(name), _TIME)


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise InputError(f"{name} is not installed: pip install 'tam_calibration[notebook]'") from None
