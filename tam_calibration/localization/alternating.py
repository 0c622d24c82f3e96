"""An alternating source: frequency and phase in stretches of a recording, and its place from the amplitudes there."""

from collections.abc import Sequence

import numpy as np

from tam_calibration.core.noise import noise_deviation
from tam_calibration.correction.calibration import Calibration
from tam_calibration.localization.amplitude_fit import AmplitudeFit, Amplitudes, locate_amplitudes, require_one_source
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.solutions import (
    ARRAY_FRAME,
    WORLD_FRAME,
    EulerSolutions,
    Line,
    Overall,
    Status,
    Survey,
)
from tam_calibration.localization.source_fit import (
    PLACE_ERROR_M,
    SOURCES,
    elements_of,
    errors_of,
    require_gradient,
    require_index,
)
from tam_calibration.localization.turned_samples import turned
from tam_calibration.model.array import tensors_of
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.mounting import matrices_of
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.demodulation import (
    CHANCE,
    FEWEST_PERIODS,
    Demodulated,
    Spectrum,
    Stretch,
    background_of,
    demodulate,
    find_frequency,
    poses_of,
    turning_of,
    without,
)

_SEARCHED = 0.7
"""Part of the resolution, one over the length of a stretch, within which the frequency is sought."""

_LARGEST_ADVANCE = 0.1
"""Turns by which the phase may advance over a stretch where the frequency is stated: it was rounded then, and the one
that is found is taken."""

_CLEAR = 25.0
"""Mean square of the amplitudes over their standard errors below which noise moves the frequency as it likes."""

_SAME_PHASE = 1e-3
"""Part of the amplitudes that may be out of phase, all together: clocks of the sensors that differ by 16 µs make it at
10 Hz."""

_HIGHEST_HZ = 1e6
"""Highest frequency of a source, hertz: no array samples twice as fast."""


def estimator_of(stretch: Stretch, found: Demodulated) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the sinusoid (N,) of a source whose channels turn, and what makes its amplitudes.

    The noise is the median of what is left at all frequencies: beside the source is also what bends over the array,
    which the amplitudes do not hold.

    Parameters
    ----------
    stretch : Stretch
        In which the source is heard.
    found : Demodulated
        Its amplitudes.

    Returns
    -------
    carrier : (N,) array
        Of the source, its amplitude one.
    estimator : (D, N, D) array
        From the channels to the amplitudes.
    covariance : (D, D) array
        Of the amplitudes.
    """
    from scipy.fft import dct

    assert stretch.turning is not None
    count, channels = stretch.channels.shape
    carrier = stretch.carrier(found.frequency_hz, found.phase)[:, 0]
    design = without(stretch.background, (carrier[:, None, None] * stretch.turning).reshape(count, -1))
    design = design.reshape(count, channels, channels)
    window = np.hanning(count)[:, None]
    waves = dct(window * (stretch.rest - design @ found.amplitude), axis=0, norm="ortho")
    noise = noise_deviation(waves, axis=0) / np.sqrt(np.mean(window**2))
    unit = design / noise[:, None] * noise  # the unknowns have the units of the channels: the noise scales them too
    covariance = np.linalg.inv(np.einsum("npa,npb->ab", unit, unit))
    estimator = np.einsum("a,ab,npb,p->anp", noise, covariance, unit, 1 / noise, optimize=True)
    return carrier, estimator, covariance * np.outer(noise, noise)


def frequency_of(stretches: Sequence[Stretch], frequency_hz: float, is_stated: bool) -> float:
    """Return the frequency of a source near one that was stated or found.

    Parameters
    ----------
    stretches : sequence of Stretch
        In which it is heard.
    frequency_hz : float
        Near which it is, hertz.
    is_stated : bool
        Whether its phase may advance by no more than a tenth of a turn against it.

    Raises
    ------
    Refused
        When a stated frequency is off.
    """
    from scipy.optimize import minimize_scalar
    from scipy.special import chdtri

    size = [demodulate(stretch, frequency_hz).noise for stretch in stretches]
    if not all((noise > 0).all() for noise in size):
        return frequency_hz

    def energy(offset_hz: float) -> float:
        each = [demodulate(stretch, frequency_hz + offset_hz).noise for stretch in stretches]
        parts = zip(stretches, each, size, strict=True)
        return float(sum(len(own.time_s) * np.sum((now / before) ** 2) for own, now, before in parts))

    longest_s = max(stretch.span_s for stretch in stretches)
    widest_hz, options = _SEARCHED / longest_s, {"xatol": np.sqrt(np.finfo(float).eps) / longest_s}
    found = minimize_scalar(energy, bounds=(-widest_hz, widest_hz), method="bounded", options=options)
    hertz = frequency_hz + float(found.x)
    heard = [demodulate(stretch, hertz) for stretch in stretches]
    signal = np.mean([np.mean((each.amplitude / each.standard_errors) ** 2) for each in heard])
    # All channels have the noise that is left at the frequency that is found.
    count = sum(stretch.channels.size for stretch in stretches)
    if signal < _CLEAR or count * (energy(0.0) / float(found.fun) - 1) < chdtri(1, CHANCE):
        return frequency_hz
    turns = abs(float(found.x)) * longest_s
    if is_stated and turns > _LARGEST_ADVANCE:
        raise Refused(
            f"the frequency is off: against {frequency_hz:.9g} Hz the phase advances by {360 * turns:.3g}° in "
            f"{longest_s:.3g} s. State {hertz:.5g} Hz, or let it be found"
        )
    return hertz


def require_one_phase(found: Sequence[Demodulated]) -> None:
    """Refuse amplitudes of which more is out of phase than noise makes.

    Raises
    ------
    Refused
        When they are those of several sources.
    """
    from scipy.special import chdtrc

    freedom = sum(len(each.amplitude) - 1 for each in found)
    energy = sum(each.out_of_phase * (len(each.amplitude) - 1) for each in found)
    signal = sum(np.sum((each.amplitude / each.standard_errors) ** 2) for each in found)
    if chdtrc(freedom, energy) < CHANCE and energy > freedom + _SAME_PHASE**2 * signal:
        raise Refused(
            f"there are two sources, or the sensors' clocks differ: {100 * np.sqrt(energy / signal):.2g} % of the "
            "amplitudes are out of phase with the others. Switch off all sources but one"
        )


_TURNING = "The array never stood still: field and gradient were demodulated as they turned."

_POINT = "A coil counts as a point: one of radius a at distance r may be up to a²/r beside the place that is found."


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
    require_gradient(calibration.array)
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
    places = (
        "The sensors are not exactly where they are stated: standard errors hold "
        f"{1e3 * PLACE_ERROR_M:g} mm of each place."
    )
    remarks = {_TURNING: not poses, places: is_displaced, _POINT: index == DIPOLE_INDEX}
    return Survey(
        ARRAY_FRAME if recording.attitude is None else WORLD_FRAME,
        np.array([np.mean(stretch.time_s[[0, -1]]) for stretch in stretches]),
        turned(solutions, attitude),
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
