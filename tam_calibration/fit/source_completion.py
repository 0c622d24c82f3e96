"""A calibration from a uniform field, completed with what an alternating source shows in poses at rest.

A uniform field leaves baselines, common frame and places of the axes open; the field of a known source tells them.
"""

from dataclasses import replace

from tam_calibration.correction.calibration import Calibration, KnownSource
from tam_calibration.fit.frames import turned
from tam_calibration.fit.source_calibration import calibrate_by_source, rotation_matrix
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import Recording
from tam_calibration.sources.dipole import Source
from tam_calibration.sources.pose_amplitudes import amplitudes_of

_FRAME_STATEMENT = (
    "The array frame is the one whose attitude was recorded. A source of known place, axis and strength showed the "
    "rotation of the calibration's frame, the length of the baselines, and the places of the elements of the axes."
)
_LARGEST_CHI_SQUARE = 10.0
"""Reject the stated source above this ratio of the squared residuals to the noise floor."""


def complete(calibration: Calibration, recording: Recording, source: Source, frequency_hz: float) -> Calibration:
    """Return a calibration with true baselines, common frame and places of the axes.

    Parameters
    ----------
    calibration : Calibration
        From a uniform field.
    recording : Recording
        Of the source: the array's centre at the origin of the world, its attitude recorded, at rest in each pose.
    source : Source
        In the world.
    frequency_hz : float
        Of the source.

    Raises
    ------
    InputError
        When the recording has no attitude or no pose, or another number of sensors.
    Refused
        When the poses do not determine the parameters, or the readings are not those of this source.
    """
    seen = amplitudes_of(recording, frequency_hz)
    found = calibrate_by_source(
        seen.amplitudes_T, seen.noise_T, source, seen.poses, calibration.errors, calibration.array
    )
    reduced = found.chi_square / found.degrees_of_freedom
    if reduced > _LARGEST_CHI_SQUARE:
        raise Refused(
            f"the readings differ from those of the stated source by {reduced**0.5:.3g} times their noise: check its "
            "position, axis, strength and radius, and the gain of the sensors at its frequency"
        )
    sensors = len(calibration.array.positions_m)
    errors, derivative = turned(calibration.errors, rotation_matrix(found.rotation))
    covariance = None
    if calibration.covariance is not None:
        by_errors, by_turn = derivative[:, :-3], derivative[:, -3:]
        covariance = by_errors @ calibration.covariance @ by_errors.T
        covariance += by_turn @ found.covariance[1:4, 1:4] @ by_turn.T
    return replace(
        calibration,
        array=found.array_of(calibration.array),
        errors=errors,
        covariance=covariance,
        frame=_FRAME_STATEMENT,
        known_source=KnownSource(
            found.baseline_scale,
            float(found.standard_errors[0]),
            found.rotation,
            found.standard_errors[1:4],
            found.standard_errors[4:].reshape(sensors, 3, 3),
            reduced,
        ),
    )
