"""From recordings of survey lines to their targets, and a map of the field over them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.linalg import norm

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.recorded_attitude import misread_attitude
from tam_calibration.localization.attitude_path import attitude_path
from tam_calibration.localization.calibration_errors import errors_of
from tam_calibration.localization.line_data import direction_wander, line_data
from tam_calibration.localization.line_path import Path, path_of, reckoned
from tam_calibration.localization.target import Target, targets_of
from tam_calibration.localization.target_search import search
from tam_calibration.model.array import tensors_of
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.limits import SPEED
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

DEFAULT_VELOCITY_ERROR = 0.1
"""Standard error of a velocity for which none is stated, as a part of the speed: dead reckoning in a current."""

_NO_ERROR_M_PER_S = 1e-9
"""Largest error of a velocity that counts as none, m/s: it makes 4 µm in an hour."""

_WAY_S = 5.0
"""Time over which the way along a line is measured straight, seconds."""


_CELL_M, _MOST_CELLS = 0.5, 1000
"""Size of the cells, metres: a sixth of the depth of the nearest targets. Along a side there are at most so many."""

_REACH_M = 10.0
"""Distance from the nearest sample beyond which cells stay empty, metres: lines farther apart than twice this say
nothing of the field between them."""


@dataclass(frozen=True, eq=False)
class SurveyLine:
    """A survey line at M moments, and its targets.

    Parameters
    ----------
    targets : list of Target
        The strongest evidence first.
    center_m : (M, 3) array
        Path of the array's centre in the world of the attitude, metres.
    along_m : (M,) array
        Way along the line, metres.
    intensity_T : (M,) array
        Mean intensity of the sensors, tesla.
    contraction_T_per_m : (M,) array
        Square root of the contraction of the gradient tensor, an invariant of rotations, T/m.
    left : (M,) array
        Root mean square of what the targets leave of the readings, over the noise.
    note : str
        One sentence on what the angular velocity contributed to the attitude; empty without one.
    """

    targets: list[Target]
    center_m: FloatArray
    along_m: FloatArray
    intensity_T: FloatArray
    contraction_T_per_m: FloatArray
    left: FloatArray
    note: str = ""


def path_in(
    recording: Recording,
    velocity_m_per_s: FloatArray | None = None,
    velocity_error_m_per_s: float | None = None,
    position_error_m: float | None = None,
    position_drift_m: float = 0.0,
) -> Path:
    """Return the path of a recording: what a velocity makes, or else its positions.

    Parameters
    ----------
    recording : Recording
        With positions, unless a velocity is given.
    velocity_m_per_s : (3,) array, optional
        Of a platform that goes straight, in the world.
    velocity_error_m_per_s : float, optional
        Standard deviation of each of its components; a tenth of the speed where it is not given.
    position_error_m : float, optional
        Least standard deviation of the white error of positions; they may show a larger one.
    position_drift_m : float
        Standard deviation of their slow error over the line.

    Raises
    ------
    InputError
        When there is neither position nor velocity.
    """
    if velocity_m_per_s is not None:
        SPEED.require("the velocity", velocity_m_per_s)
        speed = float(norm(velocity_m_per_s))
        error = DEFAULT_VELOCITY_ERROR * speed if velocity_error_m_per_s is None else velocity_error_m_per_s
        SPEED.require("the error of the velocity", error)
        return reckoned(recording.time_s, velocity_m_per_s, error if error > _NO_ERROR_M_PER_S else 0.0)
    if recording.position_m is None:
        raise InputError("the recording has no positions: add columns x_m, y_m, z_m, or state --velocity")
    return path_of(recording.time_s, recording.position_m, position_error_m, position_drift_m)


def find_targets(recording: Recording, calibration: Calibration, path: Path, attitude_noise: float = 0.0) -> SurveyLine:
    """Return the targets that a platform passed, and the line that shows them.

    Parameters
    ----------
    recording : Recording
        With attitude, which an angular velocity makes more accurate.
    calibration : Calibration
        Of its array.
    path : Path
        Of the array's centre.
    attitude_noise : float
        Least standard deviation of the attitude about each axis, radians; the readings may show a larger one.

    Raises
    ------
    InputError
        When there is no attitude.
    Refused
        When the attitude was written otherwise than expected, the line is too short, or dipoles do not explain it.
    """
    if misread := misread_attitude(recording, calibration.errors):
        raise Refused(misread)
    if recording.attitude is None:
        raise InputError("the recording has no attitude, without which readings cannot be turned into the world")
    if not calibration.array.has_gradient:
        raise InputError("the array's geometry determines no gradient, from which sources are located")
    recording = calibration.without_effects(recording)
    assert recording.attitude is not None
    known = np.flatnonzero(np.isfinite(recording.attitude).all(axis=1))
    recording = recording.take(known)
    array, fields = calibration.array, calibration.errors.restore(recording.readings_T)
    errors = errors_of(calibration, fields)
    way = _way_m(path, recording.time_s)
    wander = partial(direction_wander, fields.mean(axis=1), along_m=way)
    steadied = attitude_path(recording, array.gyroscope, attitude_noise, wander)
    data = line_data(recording.time_s, fields, steadied.attitude, array, way, steadied.error, errors)
    found, left = search(data, path)
    center_T = data.fields_T.mean(axis=1)
    targets, intensity_T = targets_of(found, np.median(center_T, axis=0)), norm(center_T, axis=1)
    tensors = tensors_of(fields.reshape(len(fields), -1) @ array.operator.T)
    contraction = np.interp(data.time_s, recording.time_s, norm(tensors, axis=(1, 2)))
    center_m = path.at(data.time_s)
    return SurveyLine(targets, center_m, data.along_m, intensity_T, contraction, left, steadied.note)


def _way_m(path: Path, time_s: FloatArray) -> FloatArray:
    """Return the way (N,) along a path, without the sway of some seconds, metres."""
    count = max(2, int((time_s[-1] - time_s[0]) / _WAY_S) + 1)
    marks = np.linspace(time_s[0], time_s[-1], count)
    way = np.concatenate([[0.0], np.cumsum(norm(np.diff(path.at(marks), axis=0), axis=1))])
    return np.asarray(np.interp(time_s, marks, way))


@dataclass(frozen=True, eq=False)
class FieldMap:
    """A regular grid, interpolated linearly between the samples of lines; NaN where none is near.

    Parameters
    ----------
    x_m, y_m : (X,) and (Y,) arrays
        Middles of the cells, metres.
    anomaly_T : (Y, X) array
        Intensity less its median over all lines, tesla.
    contraction_T_per_m : (Y, X) array
        Square root of the contraction of the gradient tensor, T/m.
    """

    x_m: FloatArray
    y_m: FloatArray
    anomaly_T: FloatArray
    contraction_T_per_m: FloatArray


def require_area(paths_m: Sequence[FloatArray]) -> None:
    """Check that paths (N, 3), metres, do not lie on one straight line.

    Raises
    ------
    InputError
        When they do.
    """
    places = np.concatenate(paths_m)[:, :2]
    if np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[1] < _CELL_M * np.sqrt(len(places)):
        raise InputError("a map needs lines beside each other: all samples lie on one straight line; leave out --grid")


def field_map(lines: Sequence[SurveyLine]) -> FieldMap:
    """Return the map of survey lines beside each other, positions in one world."""
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import KDTree

    places = np.concatenate([each.center_m[:, :2] for each in lines])
    intensity = np.concatenate([each.intensity_T for each in lines])
    contraction = np.concatenate([each.contraction_T_per_m for each in lines])
    low, high = places.min(axis=0), places.max(axis=0)
    cell = max(_CELL_M, float((high - low).max()) / _MOST_CELLS)
    x, y = (np.arange(first, last + cell, cell) for first, last in zip(low, high, strict=True))
    at = np.stack(np.meshgrid(x, y), axis=-1)
    values = LinearNDInterpolator(places, np.column_stack([intensity - np.median(intensity), contraction]))(at)
    values[KDTree(places).query(at)[0] > _REACH_M] = np.nan
    return FieldMap(x, y, values[..., 0], values[..., 1])
