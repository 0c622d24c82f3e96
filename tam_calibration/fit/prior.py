"""What is known before a fit: the last calibration, less certain by what its sensors may have changed since.

The errors θ of the sensors are taken as normal about the last estimate, their covariance that of the calibration plus
that of the changes. What a calibration holds by convention tells nothing: the frame of sensor 1, and without a scalar
reference the scale. Errors are therefore compared in the prior's convention: θ' = convention(θ), with derivative L, has
the energy (θ' - θ₀)ᵀ P⁻¹ (θ' - θ₀), which adds the information Lᵀ P⁻¹ L to that of the data.

``turned`` and ``in_first_frame`` express errors in another common frame, with the derivative for their covariance.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.linalg import inv

from tam_calibration.core.least_squares import Normal, whitening
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.ellipsoid import free_scale, without_scale
from tam_calibration.model.data_sheet import DAY_S, ChangeRates
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.limits import is_covariance
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, has_date


def turned(
    errors: SensorErrors, rotation: FloatArray, orientation: FloatArray | None = None
) -> tuple[SensorErrors, FloatArray]:
    """Return errors in a frame from which a rotation X leads to that of the errors given, and their derivative.

    A further turn δ, (1 + [δ]×) X, changes the matrices M X by M [δ]× X.

    Parameters
    ----------
    errors : SensorErrors
        Of K sensors, with matrices M.
    rotation : (3, 3) array
        X.
    orientation : (K, 3, 3) array, optional
        Of the sensors after the turn, by right angles; by default the nearest.

    Returns
    -------
    SensorErrors, (12 K, 12 K + 3) array
        Errors, and their derivative by those given and by δ, radians.
    """
    after = errors.with_rotation(errors.rotation @ rotation, orientation)
    # Only the misalignment changes: Λ' = Λ X and Λ [δ]× X = [Λ δ]× Λ'.
    back, count = inv(after.turning_axes), errors.sensor_count
    derivative = np.eye(12 * count, 12 * count + 3)
    for sensor in range(count):
        own = slice(12 * sensor + 9, 12 * sensor + 12)
        derivative[own, own] = back[sensor] @ errors.turning_axes[sensor]
        derivative[own, -3:] = -back[sensor] @ errors.rotation[sensor]
    return after, derivative


def in_first_frame(errors: SensorErrors) -> tuple[SensorErrors, FloatArray]:
    """Return errors turned into the frame of sensor 1, and the (12 K, 12 K) derivative by the errors given."""
    first = errors.rotation[0]
    after, derivative = turned(errors, first.T, errors.orientation @ errors.orientation[0].T)
    after = replace(after, misalignment=np.vstack([np.zeros((1, 3)), after.misalignment[1:]]))
    # The frame turns with sensor 1.
    derivative[:, 9:12] += derivative[:, -3:] @ first.T @ errors.turning_axes[0]
    derivative[9:12] = 0
    return after, derivative[:, :-3]


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the errors of an array's sensors before a fit.

    Parameters
    ----------
    calibration : Calibration
        Where it comes from.
    covariance : (12 K, 12 K) array
        Of the flattened errors now, SI: that of the calibration, widened.
    rates : ChangeRates, optional
        By which it was widened; None for tolerances of new sensors, which no time widens.
    elapsed_s : float, optional
        Time since the calibration, seconds; None where a date is missing, and a day was assumed.
    warming_K : float, optional
        Temperature less that of the calibration, kelvin; None where one is unknown, and none was assumed.
    """

    calibration: Calibration
    covariance: FloatArray
    rates: ChangeRates | None
    elapsed_s: float | None
    warming_K: float | None

    @property
    def errors(self) -> SensorErrors:
        """The last estimate."""
        return self.calibration.errors

    @property
    def knows_frame(self) -> bool:
        """Whether the common frame is known, and not that of sensor 1 by convention."""
        errors, covariance = self.calibration.errors, self.calibration.covariance
        is_turned = errors.misalignment[0].any() or not np.array_equal(errors.orientation[0], np.eye(3))
        return bool(is_turned or covariance[9:12, 9:12].any())

    @property
    def knows_scale(self) -> bool:
        """Whether the absolute scale is known."""
        return self.calibration.has_scalar_reference

    @cached_property
    def standard_errors(self) -> FloatArray:
        """(K, 12) standard errors now."""
        return np.sqrt(np.diag(self.covariance)).reshape(-1, 12)

    @cached_property
    def whitening(self) -> FloatArray:
        """(12 K, R) matrix W of the precision W Wᵀ: Wᵀ (θ' - θ₀) has unit variance; nothing along what is held."""
        # Part of the largest eigenvalue of a scaled covariance below which a direction is held, and not
        # uncertain.
        return whitening(self.covariance, 1e-13)

    @cached_property
    def precision(self) -> FloatArray:
        """(12 K, 12 K) inverse of the covariance, zero along what is held."""
        return self.whitening @ self.whitening.T

    def widened(self, changes: FloatArray, variance: FloatArray) -> "Prior":
        """Return the prior where errors may have changed along some directions by more.

        Parameters
        ----------
        changes : (12 K, M) array
            Changes of the errors in the prior's convention by M unknowns.
        variance : (M,) array
            Of the unknowns.
        """
        return self.with_more(changes * variance @ changes.T)

    def with_more(self, covariance: FloatArray) -> "Prior":
        """Return the prior with a covariance (12 K, 12 K) added to its own."""
        return replace(self, covariance=self.covariance + covariance)

    def terms(self, errors: SensorErrors) -> Normal:
        """Return what the prior adds to the normal equations at given errors: Lᵀ P⁻¹ L, and its pull towards them."""
        comparable, derivative = self.in_convention(errors)
        distance = (comparable.to_vector() - self.errors.to_vector()).ravel()
        pull = self.precision @ distance
        return Normal(self.precision, -pull, float(distance @ pull), self.whitening.shape[1]).by(derivative)

    def in_convention(self, errors: SensorErrors) -> tuple[SensorErrors, FloatArray]:
        """Return errors in the prior's frame and scale, and the (12 K, 12 K) derivative L by the errors given."""
        derivative: FloatArray = np.eye(12 * errors.sensor_count)
        if not self.knows_frame:
            errors, derivative = in_first_frame(errors)
        if not self.knows_scale:
            errors = replace(errors, scale_factor=float(free_scale(errors.matrix)) * errors.scale_factor)
            derivative = without_scale(errors) @ derivative
        return errors, derivative


def prior_of(
    calibration: Calibration, time_s: float | None, temperature_C: float | None, rates: ChangeRates | None = None
) -> Prior:
    """Return what a calibration tells of the errors at another time and temperature.

    Parameters
    ----------
    calibration : Calibration
        The last one, with a covariance.
    time_s : float, optional
        Now, seconds since 1970. Where it or the date of the calibration is unknown, a day has passed.
    temperature_C : float, optional
        Now. Where it or that of the calibration is unknown, it is the same.
    rates : ChangeRates, optional
        By which the errors change; those of the calibration's array, or the defaults, where they are not given.

    Raises
    ------
    InputError
        When the covariance of the calibration is not valid.
    """
    covariance = _covariance_of(calibration)
    rates = rates or calibration.array.change_rates or ChangeRates()
    elapsed_s = None
    if time_s is not None and has_date(time_s) and has_date(calibration.time_span_s[1]):
        elapsed_s = max(time_s - calibration.time_span_s[1], calibration.time_span_s[0] - time_s, 0.0)
    warming_K = None
    if temperature_C is not None and calibration.temperature_C is not None:
        warming_K = temperature_C - calibration.temperature_C
    # Without a date: the calibration of the pier is a day old at most when the vehicle dives.
    age_s = DAY_S if elapsed_s is None else elapsed_s
    change = np.tile(rates.variances(age_s, warming_K or 0.0), calibration.errors.sensor_count)
    prior = Prior(calibration, covariance, rates, elapsed_s, warming_K)
    # A sensor 1 that turns makes all others turn in its frame.
    _, derivative = prior.in_convention(calibration.errors)
    return prior.widened(derivative, change)


def _covariance_of(calibration: Calibration) -> FloatArray:
    covariance = calibration.covariance
    if not np.isfinite(covariance).all():
        raise InputError("the covariance of the calibration is not finite: calibrate its recording anew")
    covariance = (covariance + covariance.T) / 2
    if not is_covariance(covariance) or (np.diag(covariance) < 0).any():
        raise InputError(
            "the covariance of the calibration is not valid: it gives a combination of the errors a negative variance; "
            "calibrate its recording anew"
        )
    return covariance
