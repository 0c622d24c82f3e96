"""A calibration from a uniform field, completed with what a known source shows."""

from dataclasses import replace

import numpy as np

from tam_calibration.calibration import Calibration, KnownSource
from tam_calibration.exceptions import Refused
from tam_calibration.fit.source_calibration import SourceCalibration, calibrate_by_source
from tam_calibration.fit.source_recording import amplitudes_of
from tam_calibration.localization.source import Source
from tam_calibration.recording import Recording
from tam_calibration.sensor_errors import SensorErrors
from tam_calibration.units import FloatArray

FRAME_STATEMENT = (
    "The array frame is the one whose attitude was recorded: a source of known place, axis and strength showed how the "
    "frame of the calibration in a uniform field is turned against it, how long the baselines are, and where the "
    "elements of the axes sit."
)
LARGEST_CHI_SQUARE = 10.0
"""Above this many times what noise leaves, the source is not the one that is stated."""


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
    if reduced > LARGEST_CHI_SQUARE:
        raise Refused(
            f"the readings differ from those of the stated source by {reduced**0.5:.1f} times their noise: check its "
            "position, axis, strength and radius, and the gain of the sensors at its frequency"
        )
    sensors = len(calibration.array.positions_m)
    errors = found.errors_of(calibration.errors)
    return replace(
        calibration,
        array=found.array_of(calibration.array),
        errors=errors,
        covariance=_turned_covariance(calibration, found, errors),
        frame=FRAME_STATEMENT,
        known_source=KnownSource(
            found.baseline_scale,
            float(found.standard_errors[0]),
            found.rotation,
            found.standard_errors[1:4],
            found.standard_errors[4:].reshape(sensors, 3, 3),
            reduced,
        ),
    )


def _turned_covariance(calibration: Calibration, found: SourceCalibration, errors: SensorErrors) -> FloatArray | None:
    """Return the covariance of the errors in the turned frame: of the calibration before, and of the turn itself."""
    if calibration.covariance is None:
        return None
    from scipy.spatial.transform import Rotation

    sensors = errors.sensor_count
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(found.rotation).as_matrix()
    # Rows [D Λ | o] of each sensor: before by its parameters, turned, and back to the parameters after.
    before = np.einsum("kiap,ab->kibp", calibration.errors.jacobian(), turn).reshape(sensors, 12, 12)
    to_parameters = np.linalg.inv(errors.jacobian().reshape(sensors, 12, 12))
    change = np.zeros((12 * sensors, 12 * sensors))
    by_turn = np.zeros((12 * sensors, 3))
    for sensor in range(sensors):
        own = slice(12 * sensor, 12 * sensor + 12)
        change[own, own] = to_parameters[sensor] @ before[sensor]
        # A further turn δ of the frame before makes D Λ [δ]× X of D Λ X.
        rows = np.zeros((3, 4, 3))
        rows[:, :3] = np.einsum("ij,jkd,kl->ild", calibration.errors.matrix[sensor], _CROSS, turn[:3, :3])
        by_turn[own] = to_parameters[sensor] @ rows.reshape(12, 3)
    covariance: FloatArray = (
        change @ calibration.covariance @ change.T + by_turn @ found.covariance[1:4, 1:4] @ by_turn.T
    )
    return covariance


_CROSS = np.swapaxes(np.cross(np.eye(3)[:, None], np.eye(3)[None]), 0, 2)
"""(3, 3, 3) numbers [j, k, d] of the matrix [δ]× by component d of δ."""
