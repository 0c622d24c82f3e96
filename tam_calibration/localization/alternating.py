"""An alternating source, from the amplitudes that the sensors read of it."""

from collections.abc import Sequence

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.localization.amplitude_fit import (
    AmplitudeFit,
    Amplitudes,
    locate_amplitudes,
    require_one_source,
)
from tam_calibration.localization.calibration_errors import PLACE_ERROR_M, errors_of
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.localization.source_fit import SOURCES, elements_of, require_index
from tam_calibration.localization.stretch import estimator_of, frequency_of, require_one_phase
from tam_calibration.localization.survey import ARRAY_FRAME, WORLD_FRAME, Line, Overall, Survey
from tam_calibration.localization.turned_samples import turned
from tam_calibration.model.array import tensors_of
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.mounting import matrices_of
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.demodulation import (
    Demodulated,
    Spectrum,
    Stretch,
    background_of,
    demodulate,
    find_frequency,
    turning_of,
)
from tam_calibration.sources.poses import FEWEST_PERIODS, poses_of

_HIGHEST_HZ = 1e6
"""Highest frequency of a source, hertz: no array samples twice as fast."""

_TURNING = "The array never stood still: field and gradient were demodulated as they turned."

_POINT = "A coil counts as a point: one of radius a at distance r may be up to a²/r beside the place that is found."

_PLACES = (
    f"The sensors are not exactly where they are stated: standard errors hold {1e3 * PLACE_ERROR_M:g} mm of each place."
)


def locate_alternating(
    recording: Recording, calibration: Calibration, frequency_hz: float | None = None, *, index: float = DIPOLE_INDEX
) -> Survey:
    """Locate an alternating source; the array stays where it is, and may turn.

    Each axis of each sensor is demodulated, in each pose in which the array stood still for ten periods or more; where
    it never did, field and gradient are demodulated as they turn. Without attitude there is one pose.

    Parameters
    ----------
    recording : Recording
        Raw readings, with attitude where the array was turned.
    calibration : Calibration
        Of its array.
    frequency_hz : float, optional
        Of the source; found where it is not given.
    index : float
        Structural index.

    Raises
    ------
    InputError
        When the calibration is of another array, the frequency is none, or the recording is too short or too sparse.
    Refused
        When no line stands out of the noise, the frequency is off, no pose can be located, or the amplitudes are not
        those of one source of this structural index.
    """
    require_index(index)
    if not calibration.array.has_gradient:
        raise InputError("the array's geometry determines no gradient, from which sources are located")
    if frequency_hz is not None and not 0 < frequency_hz <= _HIGHEST_HZ:
        raise InputError(
            f"the frequency must be a positive number of hertz, at most {_HIGHEST_HZ:g}, not {frequency_hz:g}"
        )
    recording = calibration.without_effects(recording)
    if recording.attitude is not None:
        recording = recording.take(np.flatnonzero(np.isfinite(recording.attitude).all(axis=1)))
    spectrum = _spectrum(recording, frequency_hz is None)
    near_hz = frequency_hz or (spectrum.peak_hz if spectrum else np.nan)
    poses = [slice(None)] if recording.attitude is None else poses_of(recording, near_hz)
    stretches = [Stretch.of(recording.take(pose)) for pose in poses] or [_turning(recording, calibration)]
    hertz = frequency_of(stretches, near_hz, frequency_hz is not None)
    error_hz = spectrum.peak_standard_error_hz if spectrum and hertz != frequency_hz else np.nan
    found = [demodulate(stretch, hertz) for stretch in stretches]
    require_one_phase(found)
    parts = _of_poses(found, calibration) if poses else [_of_turning(stretches[0], found[0], recording, calibration)]
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (len(parts), 1))
    if recording.attitude is not None and poses:
        attitude = recording.attitude[[(pose.start + pose.stop) // 2 for pose in poses]]
    rotation = matrices_of(attitude)
    each = {one: locate_amplitudes(parts, rotation, one) for one in SOURCES}
    solutions, together = each[index]
    if together is not None:
        require_one_source({one: fit for one, (_, fit) in each.items()}, index)
    is_displaced = together is not None and together.place_error_m > 0
    remarks = {_TURNING: not poses, _PLACES: is_displaced, _POINT: index == DIPOLE_INDEX}
    return Survey(
        ARRAY_FRAME if recording.attitude is None else WORLD_FRAME,
        np.array([np.mean(stretch.time_s[[0, -1]]) for stretch in stretches]),
        turned(solutions, attitude),
        np.zeros((len(parts), 3)),
        _overall(together, index) if together and solutions.is_located.sum() > 1 else None,
        line=Line(hertz, error_hz, spectrum),
        note=" ".join(remark for remark, holds in remarks.items() if holds),
    )


def _spectrum(recording: Recording, is_needed: bool) -> Spectrum | None:
    """Return the spectrum from ten periods in the record to half the sampling rate, if a line stands out of it."""
    try:
        whole = Stretch.of(recording, recording.attitude)
        return find_frequency(whole, FEWEST_PERIODS / whole.span_s, 0.5 * whole.rate_hz)
    except (Refused, InputError):
        if is_needed:
            raise
        return None


def _turning(recording: Recording, calibration: Calibration) -> Stretch:
    """Return field and gradient as they turn: their amplitudes rest in the world, where the array has no geometry."""
    assert recording.attitude is not None
    outputs = calibration.apply(recording.readings_T)[:, :8]
    background = background_of(recording.time_s, recording.attitude)
    return Stretch(recording.time_s, outputs, background, turning_of(recording.attitude))


def _of_poses(found: Sequence[Demodulated], calibration: Calibration) -> list[Amplitudes]:
    """Return what the sensors read in each pose, corrected, for sources in the array frame."""
    array, matrix = calibration.array, calibration.errors.inverse
    raw = np.array([each.amplitude for each in found]).reshape(len(found), -1, 3)
    fields = np.einsum("kij,nkj->nki", matrix, raw)
    errors = errors_of(calibration, fields, is_alternating=True)
    tensors = tensors_of(fields.reshape(len(fields), -1) @ array.operator.T)
    points, by_points = elements_of(array, np.eye(3 * array.sensor_count))
    correction = np.einsum("kij,kl->kilj", matrix, np.eye(array.sensor_count)).reshape(len(by_points), -1)
    return [
        Amplitudes(
            field.ravel(),
            correction * each.standard_errors**2 @ correction.T,
            points,
            by_points,
            by_errors,
            _by_places(calibration, points),
            np.broadcast_to(tensor, (len(points), 3, 3)),
            array.operator[:8],
        )
        for field, each, by_errors, tensor in zip(fields, found, errors, tensors, strict=True)
    ]


def _by_places(calibration: Calibration, points_m: FloatArray) -> FloatArray:
    """Return the derivatives (P, 3, 3 K) of points at the sensors, or at their elements, by the sensors' places."""
    count = calibration.array.sensor_count
    return np.repeat(np.eye(3 * count).reshape(count, 3, -1), len(points_m) // count, axis=0)


def _of_turning(stretch: Stretch, found: Demodulated, recording: Recording, calibration: Calibration) -> Amplitudes:
    """Return field and gradient in the world, and what they are linear in: the fields at the sensors all along."""
    assert recording.attitude is not None
    array, rotation = calibration.array, matrices_of(recording.attitude)
    carrier, by_outputs, noise = estimator_of(stretch, found)
    back = np.swapaxes(rotation, 1, 2)
    center = back @ found.amplitude[:3]
    tensor = tensors_of(found.amplitude[None])[0]
    fields = center[:, None] + array.positions_m @ (back @ tensor @ rotation)
    errors = array.operator[:8] @ errors_of(calibration, fields, is_alternating=True)
    points, by_points = elements_of(array, array.operator[:8])
    by_fields = by_outputs * carrier[:, None]
    in_world = np.einsum("onp,pqj,nij->onqi", by_fields, by_points.reshape(8, -1, 3), rotation, optimize=True)
    return Amplitudes(
        np.einsum("onp,np->o", by_outputs, stretch.channels),
        noise,
        (points @ back).reshape(-1, 3),
        in_world.reshape(8, -1),
        np.einsum("onp,npq->oq", by_fields, errors),
        (rotation[:, None] @ _by_places(calibration, points)).reshape(-1, 3, 3 * array.sensor_count),
        np.broadcast_to(tensor, (len(rotation) * len(points), 3, 3)),
        np.eye(8),
    )


def _overall(fit: AmplitudeFit, index: float) -> Overall:
    found = EulerSolutions.of_fits(np.array([Status.LOCATED]), fit.solution, index == DIPOLE_INDEX)
    place, moment = found.position_m[0], found.moment_Am2[0]
    of_place, of_moment = found.position_covariance_m2[0], found.moment_covariance_A2m4[0]
    return Overall(place, of_place, moment, of_moment, float(found.chi_square[0]), fit.degrees_of_freedom)
