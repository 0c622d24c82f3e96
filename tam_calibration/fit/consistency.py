"""Whether one calibration describes a whole recording, and what speaks against trusting it.

Of a recording of more than ``SKETCH`` samples every n-th one is looked at.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.correction.acceptance import WRONG_PART
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.identifiability import require_accurate
from tam_calibration.fit.recorded_attitude import as_if_uniform
from tam_calibration.fit.scale import normalize, sphere_of_most
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import SKETCH, SampleSource
from tam_calibration.model.residuals import residual_series
from tam_calibration.model.units import FloatArray, to_nanotesla

_PARTS = 10
"""Of equal length, of which each is long enough for some turns of a usual survey."""

_FEWEST_IN_PART = 10
"""Fewest samples in a part: their median is certain to a third."""

_STEADY_RATIO = 4.0
"""Of the largest to the smallest residual; in the shortest parts white noise of four sensors makes 2.5 once in 1000."""

_LARGEST_STEADY_RESIDUAL = 1e-5
"""Part of the intensity, half a nanotesla: what is less, no calibration is asked for."""

_LARGEST_DISTANCE = 0.05
"""Part of the radius of a sphere that most readings are near; errors of scale and angles make readings miss it too."""


SOMETHING_MAGNETIC = "something magnetic came near, or a sensor changed"
"""What is suspected of a residual that changes, as long as no diagnosis finds another cause."""


@dataclass(frozen=True, eq=False)
class _Parts:
    """Median size of the intensity residual, tesla, in parts of equal length, and their first and last times."""

    residual_T: FloatArray
    start_s: FloatArray
    end_s: FloatArray

    def exceeds(self, residual_T: float) -> bool:
        """Whether the residual changes much between the parts and grows above a size."""
        loud = float(self.residual_T.max())
        return loud > residual_T and loud > _STEADY_RATIO * float(self.residual_T.min())

    def sentence(self) -> str:
        loud, quiet = int(self.residual_T.argmax()), int(self.residual_T.argmin())
        return (
            f"the residual of the intensity is {self._describe(quiet)} but {self._describe(loud)}: "
            + SOMETHING_MAGNETIC
        )

    def _describe(self, part: int) -> str:
        residual_nT = to_nanotesla(float(self.residual_T[part]))
        return f"{residual_nT:.3g} nT between {self.start_s[part]:.1f} and {self.end_s[part]:.1f} s"


def require_one_calibration(recording: SampleSource, calibration: Calibration) -> None:
    """Check that a fit is of a field on Earth and leaves the same residual throughout the recording.

    Parameters
    ----------
    recording : SampleSource
        Raw readings, an ambient gradient taken off.
    calibration : Calibration
        What was fitted to them.

    Raises
    ------
    Refused
        With the reason, and the times at which the residual is smallest and largest.
    """
    field = calibration.array.field
    parts = _residual_in_parts(recording, calibration)
    if parts is not None and parts.exceeds(WRONG_PART * calibration.intensity_T):
        raise Refused(f"the recording is not one calibration: {parts.sentence()}; calibrate the parts apart")
    if not field.hold(calibration.intensity_T):
        require_one_sphere(recording)
        raise Refused(
            f"the fitted intensity of {calibration.intensity_T * 1e6:.4g} µT is outside the "
            f"{field.range_uT} µT of {field.whose} field: the readings are not those of one sensor turned in one field"
        )


def require_one_sphere(recording: SampleSource) -> None:
    """Check, where a fit has failed, that the readings do not leave the sphere of most of them for a part of the time.

    Raises
    ------
    Refused
        With the times at which the distance from the sphere is smallest and largest.
    """
    some = recording.thinned(SKETCH)
    data = normalize(some)
    distance = np.zeros(some.sample_count)
    for points in np.swapaxes(data.points, 0, 1):
        center, radius = sphere_of_most(points)
        distance = np.maximum(distance, np.abs(norm(points - center, axis=1) - radius))
    parts = _in_parts(data.radius_T * distance, some.time_s)
    if parts is not None and parts.exceeds(_LARGEST_DISTANCE * data.radius_T):
        raise Refused(f"the recording is not one calibration: {parts.sentence()}; calibrate the parts apart")


def residual_that_changes(recording: SampleSource, calibration: Calibration) -> str:
    """Say when the residual of the intensity is small and when large; empty where it hardly changes.

    Parameters
    ----------
    recording : SampleSource
        Raw readings, an ambient gradient taken off.
    calibration : Calibration
        What was fitted to them.
    """
    parts = _residual_in_parts(recording, calibration)
    if parts is None or not parts.exceeds(_LARGEST_STEADY_RESIDUAL * calibration.intensity_T):
        return ""
    return f"{parts.sentence()}: leave that time out with --from and --until"


def _residual_in_parts(recording: SampleSource, calibration: Calibration) -> _Parts | None:
    some = recording.thinned(SKETCH)
    series = residual_series(calibration.errors, calibration.array, some, calibration.intensity_T)
    known = np.isfinite(series.center_intensity_T)
    return _in_parts(np.abs(series.sensor_intensity_T[known]).max(axis=1), some.time_s[known])


def _in_parts(residual: FloatArray, time: FloatArray) -> _Parts | None:
    if len(residual) < _PARTS * _FEWEST_IN_PART:
        return None
    chunks = np.array_split(np.arange(len(residual)), _PARTS)
    return _Parts(
        np.array([np.median(residual[chunk]) for chunk in chunks]),
        np.array([time[chunk[0]] for chunk in chunks]),
        np.array([time[chunk[-1]] for chunk in chunks]),
    )


Fit = Callable[[SampleSource, Array], Calibration]


def accepted(recording: SampleSource, array: Array, fit: Fit, accept: Collection[str] = ()) -> Calibration:
    """Return the calibration of a fit that is of one field, the same throughout, and accurate enough to be of use.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of the array that was turned in a field.
    array : Array
        Geometry and noise of its K sensors; a noise that is not stated is estimated.
    fit : callable
        The method: from recording and array to a ``Calibration``.
    accept : collection of str
        With "accuracy" the noise may leave parameters open.

    Raises
    ------
    InputError
        When the readings make no calibration, or leave parameters open.
    Refused
        When the recording is not one calibration.
    """
    try:
        calibration = fit(recording, array)
    except (InputError, Refused):
        require_one_sphere(recording)
        raise
    require_one_field(recording, calibration)
    return require_accurate(calibration, recording, accept)


def require_one_field(recording: SampleSource, calibration: Calibration) -> None:
    """Check that a recording is one calibration in one field.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors.
    calibration : Calibration
        Made from them.

    Raises
    ------
    Refused
        When it is not.
    """
    uniform = as_if_uniform(recording, calibration.errors, calibration.array, calibration.ambient_gradient)
    require_one_calibration(uniform, calibration)
