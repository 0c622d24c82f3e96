"""Which attitudes to record next, of those in reach, so that the worst standard error becomes as small as it can.

A plan begins with nothing, a recording or a calibration.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.core.noise import complete_noise
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.coverage import field_of
from tam_calibration.fit.identifiability import refuse_open, require_determined
from tam_calibration.fit.information import InformationModel, information_of
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees


@dataclass(frozen=True, eq=False)
class PlanStart:
    """What is known before a plan.

    Parameters
    ----------
    model : Model
        Errors, noise and field.
    information : (13, 13) array
        Of what was recorded.
    standard_errors : (K, 12) array, optional
        Before the plan, SI; None where parameters are open.
    inclination : float, optional
        Of the field, positive downwards, radians; where a recorded attitude tells it.
    note : str
        What is open and what was assumed for it; empty otherwise.
    """

    model: InformationModel
    information: FloatArray
    standard_errors: FloatArray | None
    inclination: float | None = None
    note: str = ""

    @property
    def worst(self) -> float:
        """Largest standard error, as in ``Plan.worst``; infinite where parameters are open."""
        if self.standard_errors is None:
            return np.inf
        return float(np.max(self.standard_errors.ravel() * self.model.noise_units))


def start_from_nothing(array: Array, intensity_T: float) -> PlanStart:
    """Return the start of a whole calibration of sensors whose errors are small.

    Parameters
    ----------
    array : Array
        Geometry of the K sensors, and their vector noise, which must be stated.
    intensity_T : float
        Intensity of the field, tesla.

    Raises
    ------
    InputError
        When the array's noise is not stated.
    """
    if array.vector_noise_T is None:
        raise InputError("a plan without a recording needs the vector noise in the array file: add vector_noise_nT")
    model = InformationModel(
        SensorErrors.none(array.sensor_count), array.with_stated_noise(), array.scalar_noise_T is not None, intensity_T
    )
    return PlanStart(model, np.zeros((13, 13)), None)


def start_from_recording(recording: Recording, array: Array) -> PlanStart:
    """Return the start that a recording gives; where it leaves parameters open, its raw readings give the directions.

    Parameters
    ----------
    recording : Recording
        Raw readings; the inclination of the field is known where it has an attitude.
    array : Array
        Geometry and noise of the K sensors; a noise that is not stated is estimated.

    Raises
    ------
    InputError
        When the recording cannot be used.
    Refused
        When it is not one calibration.
    """
    recording.check_units(array.field)
    noisy, _ = complete_noise(array, recording)
    try:
        require_determined(recording, array)
    except InputError as problem:
        note = f"{problem}; until then the raw readings are taken for the directions of the field"
        return _start_from_raw(recording, noisy, note)
    calibration = maximum_likelihood(recording, array)
    field = field_of(recording, calibration.errors)
    inclination = _inclination(recording, field)
    if calibration.has_scalar_reference:
        return replace(start_from_calibration(calibration), inclination=inclination)
    model = _model_of(calibration)
    information = information_of(model.rows(field))
    return PlanStart(model, information, _standard_errors(model, information), inclination)


def start_from_calibration(calibration: Calibration) -> PlanStart:
    """Return the start that a calibration gives through its covariance.

    Raises
    ------
    InputError
        When it has no scalar reference, or its covariance is not the inverse of an information.
    """
    if not calibration.has_scalar_reference:
        raise InputError("the calibration has no scalar reference: plan from its recording instead")
    model = _model_of(calibration)
    # The information whose inverse is nearest to the covariance.
    ellipsoid, affine = model.loadings
    channels, units = affine.shape[1], model.noise_units
    loadings = np.hstack([ellipsoid, affine.reshape(len(affine), -1)])
    elements = np.linalg.pinv(units[:, None] * loadings) * units
    inside = elements @ calibration.covariance @ elements.T
    information = np.zeros((13, 13))
    information[:9, :9] = inv(inside[:9, :9])
    if channels:
        blocks = inside[9:, 9:].reshape(channels, 4, channels, 4)
        information[9:, 9:] = inv(np.einsum("kikj->ij", blocks) / channels)
    standard_errors = _standard_errors(model, information)
    if not np.allclose(standard_errors, calibration.standard_errors, rtol=0.01, atol=0):
        raise InputError(
            f"the covariance of a calibration by {calibration.method} is not the inverse of an information that more "
            "samples add to: plan from its recording, or calibrate that with maximum_likelihood"
        )
    return PlanStart(model, information, standard_errors)


def _model_of(calibration: Calibration) -> InformationModel:
    has_scalar = calibration.has_scalar_reference
    return InformationModel(calibration.errors, calibration.array, has_scalar, calibration.intensity_T)


def _start_from_raw(recording: Recording, array: KnownNoiseArray, note: str) -> PlanStart:
    scalar, field = recording.scalar_T, recording.readings_T.mean(axis=1)
    length = norm(field, axis=1, keepdims=True)
    intensity_T = float(np.nanmedian(length if scalar is None else scalar))
    model = InformationModel(SensorErrors.none(recording.sensor_count), array, scalar is not None, intensity_T)
    field = intensity_T * field / length
    rows = model.rows(field)
    if scalar is not None:
        rows[~np.isfinite(scalar), :9] = 0
    return PlanStart(model, information_of(rows), None, _inclination(recording, field), note)


def _inclination(recording: Recording, field_T: FloatArray) -> float | None:
    """Return the inclination of the mean field in the world, up being that of the attitude."""
    if recording.attitude is None:
        return None
    from scipy.spatial.transform import Rotation

    known = np.isfinite(recording.attitude).all(axis=1)
    east, north, up = Rotation.from_quat(recording.attitude[known]).apply(field_T[known]).mean(axis=0)
    return float(np.arctan2(-up, np.hypot(east, north)))


def _standard_errors(model: InformationModel, information: FloatArray) -> FloatArray:
    return np.sqrt(model.variances(information)).reshape(-1, 12)


_STEP = from_degrees(15.0)
"""Finer steps than this are not distinguished: they hardly change the errors."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Attitudes with different directions of the field, of equal directions the one of least tilt.

    Parameters
    ----------
    angles : (C, 3) array
        Yaw from magnetic north, pitch and roll, radians.
    directions : (C, 3) array
        Unit vectors of the field in the array frame.
    """

    angles: FloatArray
    directions: FloatArray


def reach_of_turntable(steps: FloatArray, inclination: float) -> Reach:
    """Return the reach of a turntable that turns right round in steps (3,) of yaw, pitch and roll; 0 holds an axis.

    Parameters
    ----------
    steps : (3,) array
        Radians; of fine ones multiples of 15 degrees or more are taken.
    inclination : float
        Of the field, positive downwards, radians.

    Raises
    ------
    InputError
        When a step is neither 0 nor between the finest one and half a turn.
    """
    # from_degrees(0.001): least step of a turntable, radians: motorised rotation stages resolve no finer one.
    if not ((steps == 0) | (steps >= from_degrees(0.001)) & (steps <= np.pi)).all():
        raise InputError("the steps of a turntable must be 0 (an axis that does not turn) or 0.001 to 180 degrees")
    return _reach([_turn(float(step)) for step in steps], inclination)


def reach_of_vehicle(pitch_limit: float, roll_limit: float, inclination: float) -> Reach:
    """Return the reach of a vehicle that yaws right round, and pitches and rolls up to limits.

    Parameters
    ----------
    pitch_limit, roll_limit : float
        Largest angle to either side, radians.
    inclination : float
        Of the field, positive downwards, radians.

    Raises
    ------
    InputError
        When the pitch limit lies outside 0 to 90 degrees or the roll limit outside 0 to 180.
    """
    require_swings(pitch_limit, roll_limit)
    return _reach([_turn(_STEP), _swing(pitch_limit), _swing(roll_limit)], inclination)


def require_swings(pitch_limit: float, roll_limit: float) -> None:
    """Check the largest angles of pitch and roll of a vehicle, radians."""
    if not (0 <= pitch_limit <= np.pi / 2 and 0 <= roll_limit <= np.pi):
        raise InputError("the pitch limit must lie between 0 and 90 degrees, the roll limit between 0 and 180")


def _turn(step: float) -> FloatArray:
    if step == 0:
        return np.zeros(1)
    step *= np.ceil(_STEP / step - 1e-9)
    angle = np.arange(0, 2 * np.pi - 1e-9, step)
    return np.where(angle > np.pi + 1e-9, angle - 2 * np.pi, angle)


def _swing(limit: float) -> FloatArray:
    steps = max(2, int(np.ceil(limit / _STEP - 1e-9)))
    return np.linspace(-limit, limit, 2 * steps + 1)


def field_directions(angles: FloatArray, inclination: float) -> FloatArray:
    """Return the directions of the field in the array frame at given attitudes.

    Parameters
    ----------
    angles : (N, 3) array
        Yaw from magnetic north, pitch and roll, radians.
    inclination : float
        Of the field, positive downwards, radians.

    Returns
    -------
    (N, 3) array
        Unit vectors.
    """
    from scipy.spatial.transform import Rotation

    in_world = [np.cos(inclination), 0.0, -np.sin(inclination)]
    return np.asarray(Rotation.from_euler("ZYX", angles).inv().apply(in_world))


def _reach(axes: list[FloatArray], inclination: float) -> Reach:
    angles = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    angles = angles[np.argsort(np.abs(angles[:, 1:]).sum(axis=1), kind="stable")]
    directions = field_directions(angles, inclination)
    # Difference of unit vectors from which two directions of the field are different: half a degree.
    _, first = np.unique(np.round(directions / 0.01), axis=0, return_index=True)
    first = np.sort(first)
    return Reach(angles[first], directions[first])


@dataclass(frozen=True, eq=False)
class Plan:
    """Poses to record, and what they promise.

    Parameters
    ----------
    poses : (P,) array of int
        Numbers of the chosen candidates, the one that helps most first; one may be chosen more than once.
    worst : (P,) array
        Largest standard error after each pose: of bias, and of scale factor and angle times the field, in units of the
        noise of the parameter's sensor; infinite as long as a parameter is open.
    standard_errors : (K, 12) array
        After all poses, SI, in the order of ``errors.PARAMETER_NAMES``.
    """

    poses: np.ndarray
    worst: FloatArray
    standard_errors: FloatArray


def make_plan(
    start: PlanStart,
    field_T: FloatArray,
    pose_count: int,
    samples_per_pose: int,
    progress: Callable[[int], None] = lambda done: None,
) -> Plan:
    """Choose poses among candidates, as ``tam plan`` does.

    They are taken one by one so that the sum of the squared standard errors falls most, then exchanged one by one as
    long as that sum, and after it the largest of them, falls (Fedorov's exchange); all in units of the noise.

    Parameters
    ----------
    start : PlanStart
        What is known before: from ``start_from_nothing``, ``start_from_recording`` or ``start_from_calibration``.
    field_T : (C, 3) array
        Fields in the array frame at the attitudes that can be reached, tesla: as ``reach_of_turntable`` and
        ``reach_of_vehicle`` return their directions.
    pose_count, samples_per_pose : int
        How many poses, and samples at each.
    progress : callable
        Called with the number of poses found.

    Returns
    -------
    Plan
        Numbers of the candidates, and the standard errors that they promise.

    Raises
    ------
    Refused
        When parameters stay open; it names them.

    Examples
    --------
    >>> import numpy as np
    >>> from tam_calibration import make_plan, read_scenario
    >>> from tam_calibration.fit.plan import reach_of_vehicle, start_from_nothing
    >>> start = start_from_nothing(read_scenario("wu_table_1").array, 50e-6)
    >>> reach = reach_of_vehicle(np.pi / 2, np.pi, inclination=np.radians(65))
    >>> plan = make_plan(start, 50e-6 * reach.directions, 16, 100)
    >>> reach.angles[plan.poses].shape  # yaw, pitch and roll of each pose, radians
    (16, 3)
    """
    search = _PoseSearch(start.model, start.information, np.sqrt(samples_per_pose) * start.model.rows(field_T))
    chosen: list[int] = []
    for _ in range(pose_count):
        chosen.append(int(np.argmin(search.scores(chosen, np.sum))))
        progress(len(chosen))
    chosen = search.exchange(search.exchange(chosen, np.sum), np.max)
    poses = search.order(chosen)
    variances = [start.model.variances(search.with_poses(poses[: count + 1])) for count in range(pose_count)]
    standard_errors = np.sqrt(variances[-1])
    try:
        refuse_open(standard_errors, start.model.intensity_T)
    except InputError as problem:
        words = f"even with the best {pose_count} poses within reach {problem}"
        raise Refused(f"{words}; allow more pitch and roll, or plan more poses") from None
    worst = np.sqrt([np.max(variance * start.model.noise_units**2) for variance in variances])
    return Plan(np.array(poses), worst, standard_errors.reshape(-1, 12))


@dataclass(frozen=True, eq=False)
class _PoseSearch:
    """The rows of each candidate pose, and what is known before."""

    model: InformationModel
    start: FloatArray
    poses: FloatArray

    def with_poses(self, chosen: list[int]) -> FloatArray:
        """Return the information of what is known before and of poses."""
        return self.start + information_of(self.poses[np.array(chosen, dtype=int)])

    def scores(self, chosen: list[int], criterion: Callable[..., FloatArray]) -> FloatArray:
        """Return the criterion of the squared standard errors with each candidate added to the chosen ones."""
        # Information that is there before any sample, as part of that of a pose, so that nothing is infinite.
        least = 1e-9 * np.repeat([np.mean(self.poses[:, :9] ** 2), np.mean(self.poses[:, 9:] ** 2)], [9, 4])
        variances = self.model.variances_with(self.with_poses(chosen) + np.diag(least), self.poses)
        return criterion(variances * self.model.noise_units**2, axis=-1)

    def exchange(self, chosen: list[int], criterion: Callable[..., FloatArray]) -> list[int]:
        """Return the poses with each exchanged for a better one until that gains nothing."""
        chosen, gained = list(chosen), True
        while gained:
            gained = False
            for place, old in enumerate(chosen):
                scores = self.scores(chosen[:place] + chosen[place + 1 :], criterion)
                chosen[place] = int(np.argmin(scores))
                # Relative fall of the errors below which a further exchange of poses is not worth its time.
                if scores[chosen[place]] < (1 - 1e-3) * scores[old]:
                    gained = True
                else:
                    chosen[place] = old
        return chosen

    def order(self, chosen: list[int]) -> list[int]:
        """Return the poses in the order in which they help most."""
        left = list(chosen)
        ordered: list[int] = []
        while left:
            scores = self.scores(ordered, np.sum)[left]
            ordered.append(left.pop(int(np.argmin(scores))))
        return ordered
