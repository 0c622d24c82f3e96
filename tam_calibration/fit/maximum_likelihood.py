"""The joint maximum-likelihood fit of all sensors; outliers are held down by a multivariate Student-t distribution."""

from dataclasses import replace

from tam_calibration.core.noise import complete_noise
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.estimate import make_calibration
from tam_calibration.fit.problem import Known, Problem, posterior_of
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import SensorErrors


def maximum_likelihood(recording: SampleSource, array: Array, *, robust: bool = False) -> Calibration:
    """Fit the errors of the sensors by maximum likelihood.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field. Between the readings of a scalar magnetometer that is slower than the sensors the
        intensity is interpolated, see ``reference``; other samples without one count with what the sensors say of each
        other. Without any scalar reading the intensity is an unknown constant. The interpolation, as a robust fit,
        needs all samples in memory.
    array : Array
        Geometry and noise; a noise that is not stated is estimated.
    robust : bool
        Whether the noise is taken for Student-t with six degrees of freedom, so that outliers count little. Two scales
        are estimated, of the differences of the sensors and of the common mode. Without outliers this costs a few per
        cent of the standard errors. The intensity is not interpolated: what samples share cannot be weighed sample by
        sample.

    Returns
    -------
    Calibration
        With the covariance of the estimate: the inverse of its Fisher information, or its sandwich form.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    Refused
        When the iteration does not settle.
    """
    if robust:
        recording = recording.whole()
    found = posterior_of(recording, _without_attitude(recording, array), Known(is_robust=robust))
    name = "robust" if robust else "maximum_likelihood"
    return make_calibration(name, recording, array, found.errors, found.covariance, found.intensity_T)


def estimate(recording: SampleSource, array: Array) -> SensorErrors:
    """Return the errors alone, without covariance and quality: the same numbers in less time.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field, as in ``maximum_likelihood``.
    array : Array
        Geometry and noise; a noise that is not stated is estimated.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    Refused
        When the iteration does not settle.
    """
    place, _ = Problem.of(recording, _without_attitude(recording, array), Known()).most_probable()
    return place.errors


def _without_attitude(recording: SampleSource, array: Array) -> KnownNoiseArray:
    """Return the array with every noise known, and no attitude as data."""
    return replace(complete_noise(array, recording)[0], attitude_noise=None)
