"""Which parameters a recording determines badly, and which attitudes it would have needed."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.calibration import Calibration
from tam_calibration.fit.coverage import CELLS, cell_directions, field_of, measure_coverage
from tam_calibration.fit.design import Model
from tam_calibration.fit.identifiability import name_open
from tam_calibration.recording import Recording
from tam_calibration.sensor_errors import PARAMETER_NAMES
from tam_calibration.units import FloatArray, to_nanotesla

WEAK_RELATIVE_ERROR = 5.0
"""Above this ratio to the full sphere's standard error a parameter is badly determined."""

_MOST_NAMES = 3
_NARROW, _AXIAL = 0.65, 0.95

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
        The worst of those above ``WEAK_RELATIVE_ERROR``, worst first, with their sensors and ratios.
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
    """
    field_T = field_of(recording, calibration.errors)
    if recording.scalar_T is not None:
        field_T = field_T[np.isfinite(recording.scalar_T)]
    intensity_T = calibration.intensity_T
    model = Model(calibration.errors, calibration.array, recording.scalar_T is not None, intensity_T)
    sphere = model.rows(intensity_T * cell_directions()).information * (len(field_T) / CELLS)
    own, best = model.variances(model.rows(field_T).information), model.variances(sphere)
    ratio = np.sqrt(np.divide(own, best, out=np.full_like(own, np.nan), where=best > 0)).reshape(-1, 12)
    parameters = _worst(ratio)
    return Weakness(ratio, parameters, _reason(field_T, intensity_T) if parameters else "")


def _worst(ratio: FloatArray) -> tuple[str, ...]:
    weak = ratio > WEAK_RELATIVE_ERROR
    largest = np.where(weak, ratio, 0).max(axis=0)
    ordered = np.argsort(-largest)[: min(_MOST_NAMES, int(weak.any(axis=0).sum()))]
    only = np.arange(len(PARAMETER_NAMES)) == ordered[:, None]
    return tuple(f"{name_open(weak & own)} {_times(largest[index])}" for index, own in zip(ordered, only, strict=True))


def _times(ratio: float) -> str:
    return f"{ratio:.3g} ×" if np.isfinite(ratio) else "undetermined"


def _reason(field_T: FloatArray, intensity_T: float) -> str:
    """Name the component of the field that varied least, or the direction that it never had."""
    axis: FloatArray = np.linalg.eigh(np.cov(field_T, rowvar=False))[1][:, 0]
    nearest = int(np.argmax(np.abs(axis)))
    axis = axis * np.sign(axis[nearest])
    along = field_T @ axis
    if np.ptp(along) > _NARROW * 2 * intensity_T:
        return f"The field never points {measure_coverage(field_T).missing} of the array: turn it so that it does."
    name = f"{'xyz'[nearest]} component" if axis[nearest] > _AXIAL else f"component along {np.round(axis, 2).tolist()}"
    low, high, size = (f"{to_nanotesla(float(value)) / 1e3:.0f}" for value in (along.min(), along.max(), intensity_T))
    return (
        f"The field's {name} in the array frame only spans {low} to {high} of ±{size} µT: {_ADVICE[nearest]} further."
    ).replace("-", "−")
