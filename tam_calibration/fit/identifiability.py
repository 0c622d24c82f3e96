"""What a recording determines, told by the parameters' names before a fit is tried and after it is done."""

import numpy as np

from tam_calibration.array import Array
from tam_calibration.calibration import Calibration
from tam_calibration.exceptions import InputError
from tam_calibration.fit.bound import bound
from tam_calibration.fit.noise import complete_noise
from tam_calibration.fit.scale import Normalized, normalize
from tam_calibration.recording import SKETCH, SampleSource
from tam_calibration.sensor_errors import PARAMETER_NAMES, SensorErrors
from tam_calibration.units import FloatArray

FEWEST_SAMPLES = 9
"""An ellipsoid has nine parameters, and each sample gives one intensity."""

_LARGEST_ANGLE_ERROR = 0.01
_LARGEST_RELATIVE_ERROR = 0.005
_SAMPLES = 5000


def require_determined(recording: SampleSource, array: Array, is_uniform: bool = True) -> None:
    """Check, before a fit, that a recording determines all parameters.

    The bound is taken at error-free sensors whose fields are the readings about the centre of their sphere. In a field
    that is not uniform what the sensors differ in is not taken for noise.

    Raises
    ------
    InputError
        When there are too few samples, or parameters stay open; it names them.
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
    some = field[:: -(-len(field) // _SAMPLES)]
    covariance = bound(some, SensorErrors.none(recording.sensor_count), noisy, data.has_scalar)
    excess = _noise_excess(data, noisy) if is_uniform else 1.0
    refuse_open(excess * np.sqrt(np.diag(covariance)), data.radius_T)


def require_accurate(calibration: Calibration) -> None:
    """Check, after a fit, that no parameter's standard error is too large to be of use.

    The standard errors count for the residual that is left, where it exceeds the noise.

    Raises
    ------
    InputError
        It names the parameters.
    """
    excess = np.sqrt(max(1.0, *calibration.reduced_chi_square.values()))
    refuse_open(excess * calibration.standard_errors.ravel(), calibration.intensity_T)


def _noise_excess(data: Normalized, array: Array) -> float:
    """Return how much larger than stated, at least 1, the noise is in which the sensors differ from each other.

    Noise spreads readings that lie in a plane, and must not pass for directions that were visited.
    """
    assert array.vector_noise_T is not None
    whitened = data.points / (array.vector_noise_T / data.radius_T)[:, None]
    differing = np.linalg.eigvalsh(np.cov(whitened.reshape(len(whitened), -1), rowvar=False))[:-3]
    return float(np.sqrt(max(1.0, differing.mean()))) if differing.size else 1.0


def refuse_open(standard_errors: FloatArray, intensity_T: float) -> None:
    """Refuse standard errors (12 K,) that are too large to be of use, or unknown.

    Raises
    ------
    InputError
        It names the parameters.
    """
    relative, angle = _LARGEST_RELATIVE_ERROR, _LARGEST_ANGLE_ERROR
    limits = np.array([relative] * 3 + [angle] * 3 + [relative * intensity_T] * 3 + [angle] * 3)
    open_ = ~(standard_errors.reshape(-1, 12) <= limits)
    if open_.any():
        raise InputError(
            f"the readings do not determine {name_open(open_)}: "
            "turn the array through directions outside one plane or cone, up and down as well as around"
        )


def name_open(open_: np.ndarray) -> str:
    """Return the names of the parameters, by sensor, that a mask (K, 12) selects."""
    groups: dict[tuple[int, ...], list[str]] = {}
    for parameter, name in enumerate(PARAMETER_NAMES):
        sensors = tuple(int(sensor) + 1 for sensor in np.flatnonzero(open_[:, parameter]))
        if sensors:
            groups.setdefault(sensors, []).append(name)
    return "; ".join(f"{', '.join(names)} of {_name_sensors(sensors, len(open_))}" for sensors, names in groups.items())


def _name_sensors(sensors: tuple[int, ...], count: int) -> str:
    if len(sensors) == count > 1:
        return "every sensor"
    return f"sensor {', '.join(map(str, sensors))}"
