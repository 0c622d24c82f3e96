"""What a recording determines, well or badly, by the names of the parameters, before and after a fit."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.core.noise import complete_noise
from tam_calibration.correction.acceptance import LARGEST_ANGLE_ERROR, LARGEST_RELATIVE_ERROR
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.coverage import CELLS, ENOUGH_RELATIVE_ERROR, cell_directions, field_of, measure_coverage
from tam_calibration.fit.ellipsoid import normalize
from tam_calibration.fit.information import InformationModel, bound, information_of
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import MOST_NAMED, InputError, Refused
from tam_calibration.model.recording import BLOCK, FEWEST_SAMPLES, SKETCH, Recording, SampleSource
from tam_calibration.model.sensor_errors import PARAMETER_NAMES, SensorErrors
from tam_calibration.model.units import FloatArray, rounded, to_nanotesla


def require_determined(recording: SampleSource, array: Array, has_effects: bool = False) -> None:
    """Check, before a fit, that a recording determines all parameters.

    The bound is taken at error-free sensors whose fields are the readings about the centre of their sphere.
    Differences of the sensors that effects explain are not taken for noise.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors.
    array : Array
        Noise of these sensors; a noise that is not stated is estimated.
    has_effects : bool
        Whether effects are fitted too.

    Raises
    ------
    InputError
        When there are too few samples, or parameters stay open; it names them.
    Refused
        When the directions are enough, and sensors in one field do not read so.
    """
    count = recording.sample_count
    if count < FEWEST_SAMPLES:
        raise InputError(
            f"{count} samples cannot determine the {12 * recording.sensor_count - 3} parameters of "
            f"{recording.sensor_count} sensors: at least {FEWEST_SAMPLES} different attitudes are needed, better 50"
        )
    scalar_count = recording.scalar_count
    if scalar_count is not None and scalar_count < FEWEST_SAMPLES:
        raise InputError(
            f"only {scalar_count} samples have a scalar reading: at least {FEWEST_SAMPLES} are needed, or none"
        )
    noisy, _ = complete_noise(array, recording)
    data = normalize(recording.thinned(SKETCH))
    field = data.radius_T * data.points[np.isfinite(data.intensity), 0]
    some = field[:: -(-len(field) // BLOCK)]
    covariance = bound(some, SensorErrors.none(recording.sensor_count), noisy, data.has_scalar)
    excess = 1.0
    if not has_effects and recording.sensor_count > 1:
        # By how much the noise in which the sensors differ is larger than stated: noise spreads readings that lie in a
        # plane, and must not pass for directions that were visited.
        whitened = data.points / (noisy.vector_noise_T / data.radius_T)[:, None]
        differing = np.linalg.eigvalsh(np.cov(whitened.reshape(len(whitened), -1), rowvar=False))[:-3]
        excess = float(np.sqrt(max(1.0, differing.mean())))
    if problem := _inaccuracy(np.sqrt(np.diag(covariance)), excess, data.radius_T, some):
        raise problem


def _inaccuracy(errors: FloatArray, excess: float, intensity_T: float, field_T: FloatArray) -> Exception | None:
    """Return why the noise makes standard errors (12 K,) too large; refuse directions (N, 3) that do so.

    Noise in a plane passes for directions outside it, but not for enough of them.
    """
    names = open_parameters(excess * errors, intensity_T)
    if not names:
        return None
    if measure_coverage(field_T).relative_error > ENOUGH_RELATIVE_ERROR:
        refuse_open(excess * errors, intensity_T)
    # Residual over the noise from which no noise that is stated too small explains it: data sheets are within
    # twice.
    if excess > 10.0:
        return Refused(
            f"the residual is {excess:.3g} times the noise, which leaves {names} open, although the directions are "
            "enough: look for the cause with tam diagnose"
        )
    return InputError(
        f"the noise leaves {names} open, although the directions are enough: record longer, or check the noise that "
        "the array file states"
    )


def require_accurate(calibration: Calibration, recording: SampleSource, accept: Collection[str] = ()) -> Calibration:
    """Return a calibration none of whose standard errors is too large to be of use; accepted noise is a warning.

    The standard errors count for the residual that is left, where it exceeds the noise, but not for how long it lasts:
    what the directions determine is judged, and the accuracy is reported.

    Parameters
    ----------
    calibration : Calibration
        Of the recording.
    recording : SampleSource
        Raw readings of K sensors.
    accept : collection of str
        With "accuracy" the noise may leave parameters open.

    Raises
    ------
    InputError
        It names the parameters.
    Refused
        When noise alone would have left none open.
    """
    excess = 1.0
    # The standard errors of all other methods follow from what the fit leaves, not from the stated noise.
    if calibration.method == "maximum_likelihood":
        left = (calibration.reduced_chi_square.get(channel, 1.0) for channel in ("differential", "common_mode"))
        excess = float(np.sqrt(max(1.0, *left) / max(calibration.variance_factors)))
    field_T = field_of(recording.thinned(SKETCH), calibration.errors)
    problem = _inaccuracy(calibration.standard_errors.ravel(), excess, calibration.intensity_T, field_T)
    if problem is None:
        return calibration
    if "accuracy" not in accept:
        raise problem
    return replace(calibration, accepted=("accuracy",), warnings=(str(problem), *calibration.warnings))


def refuse_open(standard_errors: FloatArray, intensity_T: float) -> None:
    """Refuse standard errors that are too large to be of use, or unknown.

    Parameters
    ----------
    standard_errors : (12 K,) array
        Of the parameters in the order of ``SensorErrors.to_vector`` flattened, SI; infinite or NaN where unknown.
    intensity_T : float
        Intensity of the field, against which a bias is judged, tesla.

    Raises
    ------
    InputError
        It names the parameters.
    """
    if names := open_parameters(standard_errors, intensity_T):
        raise InputError(
            f"the readings do not determine {names}: "
            "turn the array through directions outside one plane or cone, up and down as well as around"
        )


def open_parameters(standard_errors: FloatArray, intensity_T: float) -> str:
    """Return the names of parameters whose standard errors, as of ``refuse_open``, are too large to be of use."""
    relative, angle = LARGEST_RELATIVE_ERROR, LARGEST_ANGLE_ERROR
    limits = np.array([relative] * 3 + [angle] * 3 + [relative * intensity_T] * 3 + [angle] * 3)
    return _name_open(~(standard_errors.reshape(-1, 12) <= limits))


def _name_open(open_: np.ndarray) -> str:
    """Return the names of the parameters, by sensor, that a mask (K, 12) selects."""
    groups: dict[tuple[int, ...], dict[str, None]] = {}
    for parameter, name in enumerate(PARAMETER_NAMES):
        sensors = tuple(int(sensor) + 1 for sensor in np.flatnonzero(open_[:, parameter]))
        if sensors:
            groups.setdefault(sensors, {})[name.rstrip(" θφψαβγ")] = None  # letters of the papers
    parts = []
    for sensors, names in groups.items():
        whose = "every sensor" if len(sensors) == len(open_) > 1 else f"sensor {', '.join(map(str, sensors))}"
        parts.append(f"{', '.join(names)} of {whose}")
    return "; ".join(parts)


_WEAK_RELATIVE_ERROR = 5.0
"""Above this ratio to the full sphere's standard error a parameter is badly determined."""


_ADVICE = ("pitch and yaw", "roll and yaw", "pitch and roll")
"""The turns that change the field along x, y and z of the array."""


@dataclass(frozen=True, eq=False)
class Weakness:
    """What the attitudes of a recording leave badly determined.

    Parameters
    ----------
    relative_error : (K, 12) array
        Cramér–Rao bound of each standard error over that of as many samples over the full sphere, in the order of
        ``errors.PARAMETER_NAMES``; NaN for what is fixed, infinite where undetermined.
    parameters : tuple of str
        The worst of those above ``_WEAK_RELATIVE_ERROR``, worst first, with their sensors and ratios.
    reason : str
        Which attitudes are missing, and what to do; empty where nothing is badly determined.
    """

    relative_error: FloatArray
    parameters: tuple[str, ...]
    reason: str

    def __str__(self) -> str:
        """Return all of it in words, or nothing."""
        if not self.parameters:
            return ""
        return f"Badly determined, in standard errors of the full sphere: {', '.join(self.parameters)}. {self.reason}"


def find_weakness(recording: Recording, calibration: Calibration) -> Weakness:
    """Return what a recording determines badly, at the errors that its calibration found.

    Where only some samples have a scalar reading, they are those that count.

    Parameters
    ----------
    recording : Recording
        Raw readings, whose attitudes are judged.
    calibration : Calibration
        Made from them; its noise is the one that counts.
    """
    field_T = field_of(recording, calibration.errors)
    if recording.scalar_T is not None:
        field_T = field_T[np.isfinite(recording.scalar_T)]
    intensity_T = calibration.intensity_T
    model = InformationModel(calibration.errors, calibration.array, recording.scalar_T is not None, intensity_T)
    sphere = information_of(model.rows(intensity_T * cell_directions())) * (len(field_T) / CELLS)
    own, best = model.variances(information_of(model.rows(field_T))), model.variances(sphere)
    ratio = np.sqrt(np.divide(own, best, out=np.full_like(own, np.nan), where=best > 0)).reshape(-1, 12)
    parameters = _worst(ratio)
    return Weakness(ratio, parameters, _reason(field_T, intensity_T) if parameters else "")


def _worst(ratio: FloatArray) -> tuple[str, ...]:
    weak = ratio > _WEAK_RELATIVE_ERROR
    largest = np.where(weak, ratio, 0).max(axis=0)
    # The worst tell what to do.
    ordered = np.argsort(-largest)[: min(MOST_NAMED, int(weak.any(axis=0).sum()))]
    only = np.arange(len(PARAMETER_NAMES)) == ordered[:, None]
    times = [f"{rounded(ratio, 3)} ×" if np.isfinite(ratio) else "undetermined" for ratio in largest[ordered]]
    return tuple(f"{_name_open(weak & own)} {each}" for each, own in zip(times, only, strict=True))


def _reason(field_T: FloatArray, intensity_T: float) -> str:
    """Name the component of the field that varied least, or the direction that it never had."""
    axis: FloatArray = np.linalg.eigh(np.cov(field_T, rowvar=False))[1][:, 0]
    nearest = int(np.argmax(np.abs(axis)))
    axis = axis * np.sign(axis[nearest])
    along = field_T @ axis
    # 0.65 and 0.95: part of the sphere's diameter within which the field varied little along a direction, and the
    # cosine from which that is called by the name of an axis: within 18° of it.
    if np.ptp(along) > 0.65 * 2 * intensity_T:
        return f"The field never points {measure_coverage(field_T).missing} of the array: turn it so that it does."
    name = f"{'xyz'[nearest]} component" if axis[nearest] > 0.95 else f"component along {np.round(axis, 2).tolist()}"
    low, high, size = (f"{to_nanotesla(float(value)) / 1e3:.0f}" for value in (along.min(), along.max(), intensity_T))
    return (
        f"The field's {name} in the array frame only spans {low} to {high} of ±{size} µT: {_ADVICE[nearest]} further."
    ).replace("-", "−")
