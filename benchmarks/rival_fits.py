"""Fits of one sensor under one signature: those of other packages, and ours."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.fit import maximum_likelihood
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_validation.papers.wu2025_sweeps import published_errors

MICROTESLA, GAUSS = 1e-6, 1e-4
"""Units of what the rivals read and return, tesla."""


@dataclass(frozen=True, eq=False)
class Data:
    """Readings (N, 3) of one sensor and intensities (N,), tesla, with the noise of both."""

    readings_T: FloatArray
    scalar_T: FloatArray
    noise_T: float
    scalar_noise_T: float


@dataclass(frozen=True, eq=False)
class Correction:
    """The field is ``unmix @ (reading - bias_T)``."""

    unmix: FloatArray
    bias_T: FloatArray

    def field_T(self, readings_T: FloatArray) -> FloatArray:
        """Return the (N, 3) fields of readings."""
        return (readings_T - self.bias_T) @ self.unmix.T

    def with_mean(self, data: Data) -> "Correction":
        """Return the correction whose mean intensity is that of the scalar."""
        factor = data.scalar_T.mean() / norm(self.field_T(data.readings_T), axis=1).mean()
        return Correction(factor * self.unmix, self.bias_T)

    @property
    def errors(self) -> SensorErrors:
        """The same as errors of one sensor."""
        return SensorErrors.from_matrix(inv(self.unmix)[None], self.bias_T[None])


Fit = Callable[[Data], Correction]


def magcal(data: Data) -> Correction:
    """Return the ellipsoid about the mean of the readings."""
    found = import_module("magcal").MagnetometerCalibrator().ellipsoid_fit(data.readings_T / MICROTESLA)
    return Correction(found["transform_matrix"], found["center"] * MICROTESLA)


def mag_cal(data: Data) -> Correction:
    """Return the ellipsoid by linear least squares, its square root symmetric."""
    sensor = import_module("mag_cal.sensor").Sensor()
    sensor.fit_ellipsoid(data.readings_T / MICROTESLA)
    return Correction(sensor.transform.T, sensor.centre.ravel() * MICROTESLA)


def navlib_ellipsoid(data: Data) -> Correction:
    """Return the ellipsoid by linear least squares of another quadric."""
    hard_iron, soft_iron, _ = import_module("navlib.cal").cal_mag_ellipsoid_fit(data.readings_T / MICROTESLA)
    return Correction(inv(soft_iron), hard_iron * MICROTESLA)


def navlib_fang(data: Data) -> Correction:
    """Return the ellipsoid of Fang 2011."""
    hard_iron, soft_iron, _ = import_module("navlib.cal").cal_mag_ellipsoid_fit_fang(data.readings_T / MICROTESLA)
    return Correction(inv(soft_iron), hard_iron * MICROTESLA)


def navlib_twostep(data: Data) -> Correction:
    """Return the solution of Alonso and Shuster 2002, which is told the mean intensity and the noise."""
    reference = np.array([data.scalar_T.mean() / GAUSS, 0.0, 0.0])
    noise = data.noise_T / GAUSS
    hard_iron, soft_iron, _ = import_module("navlib.cal").cal_mag_twostep_hsi(
        data.readings_T / GAUSS, reference, measurement_noise_std=noise
    )
    return Correction(inv(soft_iron), hard_iron * GAUSS)


def ours(estimate: Callable[[Recording, Array], SensorErrors]) -> Fit:
    """Return one of our methods as a fit of one sensor."""

    def fit(data: Data) -> Correction:
        recording = Recording(np.arange(len(data.readings_T)) * 1.0, data.readings_T[:, None], data.scalar_T)
        errors = estimate(recording, array_of(data))
        return Correction(inv(errors.matrix[0]), errors.bias_T[0])

    return fit


def array_of(data: Data) -> Array:
    """Return the array of one sensor."""
    return Array(np.zeros((1, 3)), np.array([data.noise_T]), data.scalar_noise_T)


OURS = {
    "maximum_likelihood": ours(maximum_likelihood.estimate),
    "lossless": ours(lambda recording, array: published_errors(recording, as_published=False)),
}
RIVALS: dict[str, tuple[str, Fit]] = {
    "magcal": ("magcal", magcal),
    "circuitpython-mag-cal": ("mag_cal", mag_cal),
    "navlib ellipsoid_fit": ("navlib", navlib_ellipsoid),
    "navlib ellipsoid_fit_fang": ("navlib", navlib_fang),
    "navlib twostep_hsi": ("navlib", navlib_twostep),
}


def is_installed(rival: str) -> bool:
    """Return whether the package of a rival is there."""
    return find_spec(RIVALS[rival][0]) is not None
