"""What is known before a plan: nothing, a recording, or a calibration."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.core.noise import complete_noise
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.coverage import field_of
from tam_calibration.fit.identifiability import require_determined
from tam_calibration.fit.information import Information, InformationModel
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class PlanStart:
    """What is known before a plan.

    Parameters
    ----------
    model : Model
        Errors, noise and field.
    information : Information
        Of what was recorded.
    standard_errors : (K, 12) array, optional
        Before the plan, SI; None where parameters are open.
    inclination : float, optional
        Of the field, positive downwards, radians; where a recorded attitude tells it.
    note : str
        What is open and what was assumed for it; empty otherwise.
    """

    model: InformationModel
    information: Information
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
    return PlanStart(model, Information(np.zeros((9, 9)), np.zeros((4, 4))), None)


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
    information = model.rows(field).information
    return PlanStart(model, information, _standard_errors(model, information), inclination)


def start_from_calibration(calibration: Calibration) -> PlanStart:
    """Return the start that a calibration gives through its covariance.

    Raises
    ------
    InputError
        When it has no covariance or no scalar reference.
    """
    if calibration.covariance is None or not calibration.has_scalar_reference:
        lacks = "covariance" if calibration.covariance is None else "scalar reference"
        raise InputError(f"the calibration has no {lacks}: plan from its recording instead")
    model = _model_of(calibration)
    information = _taken_apart(model, calibration.covariance)
    standard_errors = _standard_errors(model, information)
    if not np.allclose(standard_errors, calibration.standard_errors, rtol=0.01, atol=0):
        raise InputError(
            f"the covariance of a calibration by {calibration.method} is not the inverse of an information that more "
            "samples add to: plan from its recording, or calibrate that with maximum_likelihood"
        )
    return PlanStart(model, information, standard_errors)


def _taken_apart(model: InformationModel, covariance: FloatArray) -> Information:
    """Return the information whose inverse is nearest to a covariance (12 K, 12 K) of the parameters."""
    ellipsoid, affine = model.loadings
    channels, units = affine.shape[1], model.noise_units
    loadings = np.hstack([ellipsoid, affine.reshape(len(affine), -1)])
    elements = np.linalg.pinv(units[:, None] * loadings) * units
    inside = elements @ covariance @ elements.T
    blocks = inside[9:, 9:].reshape(channels, 4, channels, 4)
    each = inv(np.einsum("kikj->ij", blocks) / channels) if channels else np.zeros((4, 4))
    return Information(inv(inside[:9, :9]), each)


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
        rows.ellipsoid[~np.isfinite(scalar)] = 0
    return PlanStart(model, rows.information, None, _inclination(recording, field), note)


def _inclination(recording: Recording, field_T: FloatArray) -> float | None:
    """Return the inclination of the mean field in the world, up being that of the attitude."""
    if recording.attitude is None:
        return None
    from scipy.spatial.transform import Rotation

    known = np.isfinite(recording.attitude).all(axis=1)
    east, north, up = Rotation.from_quat(recording.attitude[known]).apply(field_T[known]).mean(axis=0)
    return float(np.arctan2(-up, np.hypot(east, north)))


def _standard_errors(model: InformationModel, information: Information) -> FloatArray:
    return np.sqrt(model.variances(information)).reshape(-1, 12)
