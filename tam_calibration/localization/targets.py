"""From recordings of survey lines to their targets, and a map of the field over them.

A target is made of the dipoles that were found: a dipole, or a body that is larger or too near. The same object from
several lines is one target.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.contradiction import SIGNIFICANT
from tam_calibration.fit.recorded_attitude import misread_attitude
from tam_calibration.localization.line_data import direction_wander, line_data
from tam_calibration.localization.line_path import Path, attitude_path, path_of, reckoned
from tam_calibration.localization.solutions import standard_errors
from tam_calibration.localization.source_fit import PLACE_ERROR_M, errors_of, require_gradient
from tam_calibration.localization.target_search import FARTHEST_M, LEAST_GAIN, UNEXPLAINED, Found, search
from tam_calibration.model.array import tensors_of
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.limits import SPEED
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import VACUUM_PERMEABILITY

WITHIN_BODY, NEAR_BODY = 0.75, 1.0
"""Distance between dipoles, or sightings, over that from the path, below which they are those of one body, and below
which an uncertain or doubtful one is a part of the body near it: a body as large as its distance shows as dipoles that
far apart."""

LARGEST_MISFIT = 3.0
"""Mean squared residual, over the noise, above which a target that no further dipole explains is no dipole: a path that
sways faster than its knots leaves some times the noise, by which standard errors are widened."""

_FAINT = 1e-3
"""Evidence for a dipole over that for its neighbour, below which a misfit makes it doubtful. Its field is then a
thirtieth of the neighbour's, which errors of the array can make."""

_LARGEST_ERROR = 0.3
"""Standard error of a place, over its distance, beyond which first order says nothing."""


@dataclass(frozen=True, eq=False)
class Target:
    """A target.

    Parameters
    ----------
    position_m : (3,) array
        In the world of the attitude, metres.
    position_covariance_m2 : (3, 3) array
        Of that, widened by residuals beyond the noise, and by the extent of an extended body.
    moment_Am2 : (3,) array
        Magnetic moment, of an extended body that of all its parts, A m².
    moment_covariance_A2m4 : (3, 3) array
        Of that.
    evidence : float
        By how much χ² would rise without it, over the misfit.
    distance_m : float
        Least distance from the path, metres.
    extent_m : float
        Of an extended body: largest distance between its parts, metres, zero where it shows as one; of a dipole zero.
    is_extended : bool
        Whether it is larger, or nearer, than a dipole.
    misfit : float
        Mean squared residual about it, over the noise.
    field_T : (3,) array
        Regional field along the line, tesla.
    lines : int
        Number of lines that show it.
    repeat_m : float
        Root mean square distance of what single lines show from the position; NaN of one line.
    """

    position_m: FloatArray
    position_covariance_m2: FloatArray
    moment_Am2: FloatArray
    moment_covariance_A2m4: FloatArray
    evidence: float
    distance_m: float
    extent_m: float
    is_extended: bool
    misfit: float
    field_T: FloatArray
    lines: int = 1
    repeat_m: float = float("nan")

    @property
    def standard_errors_m(self) -> FloatArray:
        """(3,) of the position, metres."""
        return standard_errors(self.position_covariance_m2)

    @property
    def along_field_Am2(self) -> float:
        """Part of the moment along the regional field, A m²: the field induces this part, the rest is remanent."""
        return float(self.moment_Am2 @ self.field_T / norm(self.field_T))

    @property
    def sphere_diameter_m(self) -> float:
        """Diameter of the soft iron sphere in which the field induces a moment of this size, metres."""
        # A sphere of radius a and high permeability has the moment 4π a³ B/µ0 (Jackson 1999, 5.11).
        cubed_m3 = VACUUM_PERMEABILITY * norm(self.moment_Am2) / (4 * np.pi * norm(self.field_T))
        return float(2 * np.cbrt(cubed_m3))


def targets_of(found: Sequence[Found], field_T: FloatArray) -> list[Target]:
    """Return the targets that dipoles of a line make, the strongest evidence first.

    A dipole is one where it is certain. Several within one body, or one that leaves a large misfit, are one extended
    target.

    Parameters
    ----------
    found : sequence of Found
        Dipoles of a line.
    field_T : (3,) array
        Regional field, tesla.
    """
    evident = [each for each in found if each.gain > LEAST_GAIN * max(each.misfit, 1.0)]
    groups = _bodies([each for each in evident if each.distance_m < FARTHEST_M])
    targets = [(_target(group, field_T), _is_placed(group[0])) for group in groups]
    return by_evidence(each for each, is_placed in targets if is_placed or each.is_extended)


def by_evidence(targets: Iterable[Target]) -> list[Target]:
    """Return targets, the strongest evidence first."""
    return sorted(targets, key=lambda each: -each.evidence)


def _is_placed(each: Found) -> bool:
    """Return whether the place of a dipole is known to a part of its distance."""
    error = float(np.sqrt(max(each.misfit, 1.0) * np.diag(each.covariance)[:3].max()))
    return error < _LARGEST_ERROR * each.distance_m


def _bodies(found: Sequence[Found]) -> list[list[Found]]:
    """Return groups of dipoles that are nearer to each other than bodies at their distance are large."""
    groups: list[list[Found]] = []
    for each in found:
        near = [group for group in groups if any(_are_one(each, other) for other in group)]
        groups = [group for group in groups if group not in near] + [[each, *(one for group in near for one in group)]]
    return groups


def _are_one(one: Found, other: Found) -> bool:
    apart = float(norm(one.unknowns[:3] - other.unknowns[:3]))
    distances = one.distance_m, other.distance_m
    weaker, stronger = sorted((one, other), key=lambda each: each.gain)
    is_doubtful = weaker.misfit > UNEXPLAINED and weaker.gain < _FAINT * stronger.gain
    if _is_placed(one) and _is_placed(other) and not is_doubtful:
        return apart < WITHIN_BODY * min(distances)
    return apart < NEAR_BODY * max(distances)


def _target(group: Sequence[Found], field_T: FloatArray) -> Target:
    """Return one target of dipoles: their mean place by the size of their moments, and the sum of these."""
    rows = np.array([each.unknowns for each in group])
    weights = norm(rows[:, 3:], axis=1) / norm(rows[:, 3:], axis=1).sum()
    place = weights @ rows[:, :3]
    misfit = max(each.misfit for each in group)
    covariance = max(1.0, misfit) * np.array([each.covariance for each in group])
    apart = rows[:, :3] - place
    extent = float(norm(rows[:, None, :3] - rows[:, :3], axis=2).max())
    distance = min(each.distance_m for each in group)
    is_extended = len(group) > 1 or misfit > LARGEST_MISFIT
    size = extent or (0.5 * distance if is_extended else 0.0)
    spread = np.einsum("s,sij->ij", weights**2, covariance[:, :3, :3])
    return Target(
        position_m=place,
        position_covariance_m2=spread + np.einsum("s,si,sj->ij", weights, apart, apart) + (size / 4) ** 2 * np.eye(3),
        moment_Am2=rows[:, 3:].sum(axis=0),
        moment_covariance_A2m4=covariance[:, 3:, 3:].sum(axis=0),
        evidence=sum(each.gain for each in group) / max(1.0, misfit),
        distance_m=distance,
        extent_m=extent,
        is_extended=is_extended,
        misfit=misfit,
        field_T=field_T,
    )


def merged(lines: Sequence[Sequence[Target]]) -> list[Target]:
    """Return the targets of several lines as one list, the strongest evidence first.

    The sightings of an object are averaged by their precision. Where they differ by more than their standard errors
    explain, its covariance is widened to the differences.

    Parameters
    ----------
    lines : sequence of sequences of Target
        Of each line, positions in one world.
    """
    from scipy.special import chdtri

    farthest = chdtri(3, SIGNIFICANT)  # square of the distance of two sightings of one object over their covariance
    objects: list[list[Target]] = []
    for targets in lines:
        own = list(objects)
        for target in by_evidence(targets):
            same = min(own, key=lambda seen: _distance(seen, target), default=None)
            if same is None or _distance(same, target) > farthest:
                objects.append([target])
            else:
                same.append(target)
                own.remove(same)
    return by_evidence([_of_sightings(each) for each in objects])


def _distance(seen: Sequence[Target], target: Target) -> float:
    """Return the square of the distance from the nearest sighting over both covariances; infinite where it is far."""
    nearest = np.inf
    for other in seen:
        off = other.position_m - target.position_m
        if norm(off) < WITHIN_BODY * max(other.distance_m, target.distance_m):
            spread = other.position_covariance_m2 + target.position_covariance_m2
            nearest = min(nearest, float(off @ np.linalg.solve(spread, off)))
    return nearest


def _of_sightings(seen: Sequence[Target]) -> Target:
    strongest = by_evidence(seen)[0]
    if len(seen) == 1:
        return strongest
    position, spread = _mean([each.position_m for each in seen], [each.position_covariance_m2 for each in seen])
    moment, of_moment = _mean([each.moment_Am2 for each in seen], [each.moment_covariance_A2m4 for each in seen])
    return replace(
        strongest,
        position_m=position,
        position_covariance_m2=spread,
        moment_Am2=moment,
        moment_covariance_A2m4=of_moment,
        evidence=sum(each.evidence for each in seen),
        distance_m=min(each.distance_m for each in seen),
        extent_m=max(each.extent_m for each in seen),
        is_extended=any(each.is_extended for each in seen),
        lines=len(seen),
        repeat_m=float(np.sqrt(np.mean([norm(each.position_m - position) ** 2 for each in seen]))),
    )


def _mean(values: Sequence[FloatArray], covariances: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return the mean (3,) of vectors by their precision, and its covariance, widened to the differences (Birge)."""
    precisions = [inv(each) for each in covariances]
    covariance = inv(np.sum(precisions, axis=0))
    mean = covariance @ sum(each @ value for each, value in zip(precisions, values, strict=True))
    square = sum((value - mean) @ each @ (value - mean) for each, value in zip(precisions, values, strict=True))
    return mean, covariance * max(1.0, float(square) / (3 * len(values) - 3))


DEFAULT_VELOCITY_ERROR = 0.1
"""Standard error of a velocity for which none is stated, as a part of the speed: dead reckoning in a current."""

_WAY_S = 5.0
"""Time over which the way along a line is measured straight, seconds."""


_CELL_M, _MOST_CELLS = 0.5, 1000
"""Size of the cells, metres: a sixth of the depth of the nearest targets. Along a side there are at most so many."""


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
        is_exact = error * np.ptp(recording.time_s) < PLACE_ERROR_M
        return reckoned(recording.time_s, velocity_m_per_s, 0.0 if is_exact else error)
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
    require_gradient(calibration.array)
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
    # Lines that are farther apart tell nothing of the field between them.
    values[KDTree(places).query(at)[0] > FARTHEST_M / 2] = np.nan
    return FieldMap(x, y, values[..., 0], values[..., 1])
