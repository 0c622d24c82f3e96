"""The calibration of a recording with what else is known: which channels and priors count, and what has moved."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial, reduce
from typing import NamedTuple

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.noise import WHITE, VarianceFactors
from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import SEVERAL, Moved, Update, in_words
from tam_calibration.effects.removal import of_array
from tam_calibration.fit.attitude_check import judge_attitude
from tam_calibration.fit.consistency import Fit, accepted, require_one_calibration, require_one_sphere
from tam_calibration.fit.contradiction import FAR, MOST_CHANGES, PLAUSIBLE, SIGNIFICANT, Unnamed
from tam_calibration.fit.estimate import mean_temperature, variance_factors
from tam_calibration.fit.gyroscope_check import MOST_SAMPLES, judge_gyroscope
from tam_calibration.fit.identifiability import require_determined
from tam_calibration.fit.maximum_a_posteriori import (
    FRAME_OF_GYROSCOPE,
    SETTLED,
    calibrate_with_weak_prior,
    is_weak,
    maximum_a_posteriori,
    prior_of_tolerances,
    update_of,
)
from tam_calibration.fit.prior import Prior, prior_of
from tam_calibration.fit.prior_changes import UpdatedPrior, update_prior
from tam_calibration.fit.problem import Intensity, Known, Place
from tam_calibration.fit.recorded_attitude import is_attitude_data
from tam_calibration.fit.reference import turning_scalar
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused, adding
from tam_calibration.model.geomagnetic_field import LOCAL_STANDARD_ERROR_T
from tam_calibration.model.recording import BLOCK, SKETCH, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors, measure_residuals
from tam_calibration.model.units import FloatArray, has_date, origin_of, to_nanotesla

_MOST_ROUNDS = 5
"""Of an update: the first may take what is slow for a change of the sensors. Three were the most that were needed."""


class JointCalibration(NamedTuple):
    """A calibration, its samples without effects, the array as it is known, the fit, and what this knew.

    The last is None where the samples have attitude or angular velocity, or the method takes no priors.
    """

    calibration: Calibration
    recording: SampleSource
    array: Array
    fit: Fit
    known: Known | None = None

    def noting(self, *notes: str, doubt: str = "") -> "JointCalibration":
        """Return it with more notes before its own, and a doubt as its first warning."""
        own = self.calibration
        warnings = (doubt, *own.warnings) if doubt else own.warnings
        return self._replace(calibration=replace(own, notes=(*notes, *own.notes), warnings=warnings))


def calibrate_jointly(
    recording: SampleSource,
    array: Array,
    prior: Prior | Calibration | None,
    main_field_T: FloatArray | None,
    accept: Collection[str] = (),
) -> JointCalibration:
    """Return the calibration of a recording with what else is known.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field.
    array : Array
        Geometry and noise. Its tolerances are the prior where no other is given.
    prior : Prior or Calibration, optional
        Of the same sensors.
    main_field_T : (3,) array, optional
        The world's field, east, north, up, tesla.
    accept : collection of str
        Names of findings that are overruled: of ``tam_calibration.integrity.ACCEPTABLE``.

    Returns
    -------
    JointCalibration
        With the effects of the prior that go with the array, which are taken off the recording before, and with what a
        known source had shown of the array.

    Raises
    ------
    InputError
        When the prior does not go with the recording, or all together leaves parameters open.
    Refused
        When the recording is not one calibration, or contradicts a prior that leaves errors open and tells too little
        alone.
    """
    if prior is None:
        given = None if array.tolerances is None else prior_of_tolerances(recording, array)
        return _as_far_as_they_agree(recording, array, Known(given, main_field_T), accept)
    given = prior_for(recording, array, prior)
    kept = replace(given.calibration, effects=of_array(given.calibration.effects))
    sizes = zip(given.calibration.effects, given.calibration.effect_sizes, strict=True)
    kept = replace(kept, effect_sizes=tuple(size for fitted, size in sizes if fitted in kept.effects))
    if kept.effects:
        recording = kept.without_effects(recording.whole())
    if kept.known_source is not None:
        array = replace(array, positions_m=kept.array.positions_m, axis_offsets_m=kept.array.axis_offsets_m)
    joint = _as_far_as_they_agree(recording, array, Known(given, main_field_T), accept)
    calibration = replace(
        joint.calibration, effects=kept.effects, effect_sizes=kept.effect_sizes, known_source=kept.known_source
    )
    return joint._replace(calibration=calibration)


def prior_for(recording: SampleSource, array: Array, prior: Prior | Calibration) -> Prior:
    """Return a prior for a recording: a calibration is widened to its time and temperature.

    Parameters
    ----------
    recording : SampleSource
        That the prior goes with.
    array : Array
        Of the recording; its rates of change are taken.
    prior : Prior or Calibration
        Of the same sensors.

    Raises
    ------
    InputError
        When it is of another array, has no valid covariance, or was made from samples of the same time.
    """
    calibration = prior.calibration if isinstance(prior, Prior) else prior
    if not calibration.is_of(array):
        raise InputError("the prior is the calibration of another array: use one of this array")
    first_s, last_s = recording.time_span_s
    begin_s, end_s = calibration.time_span_s
    is_dated = has_date(first_s) and has_date(begin_s)
    if (is_dated and first_s <= end_s and begin_s <= last_s) or _is_of(calibration, recording):
        raise InputError(
            "the prior was made from samples of the same time as the recording, which would count twice: "
            "take the calibration before it"
        )
    if isinstance(prior, Prior):
        return prior
    temperature_C = mean_temperature(recording)
    return prior_of(calibration, (first_s + last_s) / 2, temperature_C, array.change_rates)


def _is_of(calibration: Calibration, recording: SampleSource) -> bool:
    """Return whether a calibration states the times of a recording and what its raw readings leave, to all digits."""
    if recording.time_span_s != calibration.time_span_s:
        return False
    none = SensorErrors.none(recording.sensor_count)
    found = measure_residuals(none, calibration.array, recording, calibration.intensity_T)
    stated, own = ([*each.sensor_intensity_T, *each.tensor_T_per_m] for each in (calibration.before, found))
    # The six digits of a file.
    return np.allclose(stated, own, rtol=1e-5, atol=0, equal_nan=True)


def _as_far_as_they_agree(
    recording: SampleSource, array: Array, known: Known, accept: Collection[str]
) -> JointCalibration:
    """Return the calibration with scalar, place and attitude as far as they agree, and depend on no sensor.

    A field that pulsates as the array turns looks like a magnet near the scalar. The standard errors
    therefore hold by how much the errors differ with and without a scalar that follows the direction of the field.
    """
    scalar = None if "scalar" in accept else turning_scalar(recording, array)
    if scalar is None:
        return _with_motion(recording, array, known)
    alone = replace(recording.whole(), scalar_T=None)
    if scalar.is_useless:
        return _with_motion(alone, array, known).noting(doubt=scalar.sentence)
    given, without = (recording, known), (alone, replace(known, intensity=Intensity(scalar.mean_T, scalar.size_T)))
    (taken, used), (other, other_known) = (without, given) if scalar.is_most else (given, without)
    with adding(scalar.sentence):
        joint = _with_motion(taken, array, used).noting(scalar.sentence)
    calibration = joint.calibration
    with suppress(InputError, Refused):
        compared = _with_motion(other, array, other_known).calibration
        if compared.frame == calibration.frame:
            moved = calibration.errors.to_vector() - compared.errors.to_vector()
            calibration = replace(calibration, covariance=calibration.covariance + np.outer(moved, moved))
    return joint._replace(calibration=calibration)


def _with_motion(recording: SampleSource, array: Array, known: Known) -> JointCalibration:
    """Return the calibration with place, and angular velocity or attitude, as far as they agree.

    A gyroscope depends on no magnetometer: where attitude contradicts it, or is not used, it counts.
    """
    known, notes = _without_wrong_place(recording, known)
    is_attitude_used = is_attitude_data(recording, array)
    without_rates = _with_attitude if is_attitude_used else _with_known
    if recording.thinned(SKETCH).angular_velocity_rad_s is None:
        return without_rates(recording, array, known).noting(*notes)
    if recording.sample_count > MOST_SAMPLES:
        note = (
            f"of more than {MOST_SAMPLES} samples the angular velocity is not used: take parts with --from and --until"
        )
        return without_rates(recording, array, known).noting(*notes, note)
    alone = replace(array, attitude_noise=None)
    used, since_s = known, recording.time_span_s[0]
    if known.prior is not None and not is_weak(known.prior):
        updated = update_prior(recording, alone, known)  # a sensor that has moved is no fault of the gyroscope
        used, since_s = updated.known, updated.recording.time_span_s[0]
    with_rates, judged = judge_gyroscope(recording.whole(), alone, used, since_s)
    if judged.fit is None:
        with adding(judged.reason):
            joint = without_rates(recording, array, known)
        return joint.noting(*notes, f"{judged.reason}: it is left out")
    joint = _with_known(with_rates, alone, replace(known, gyroscope=judged.fit.begun, start=judged.fit.place))
    if is_attitude_used:
        notes = (*notes, "the recorded attitude is left out beside the gyroscope, which needs no magnetometer")
    return joint.noting(*notes, *judged.notes, doubt=judged.doubt)


def _with_attitude(recording: SampleSource, array: Array, known: Known) -> JointCalibration:
    """Return the calibration with attitude as far as it agrees, and depends on no sensor."""
    notes: tuple[str, ...] = ()
    judged = judge_attitude(recording, array, known)
    array = replace(array, attitude_noise=judged.attitude_noise)
    kept = "heading of the attitude" if judged.attitude_noise else "attitude"
    if judged.place:
        known, notes = replace(known, main_field_T=None), (*notes, f"{judged.place}: {_WITHOUT_PLACE}")
    try:
        with adding("" if judged.reason else judged.doubt):
            joint = _with_known(recording, array, replace(known, uses_heading=judged.uses_heading))
    except (InputError, Refused) as problem:
        require_one_sphere(recording)
        if not judged.reason:
            raise
        raise Refused(f"{judged.reason}; without the {kept} {problem}") from problem
    if judged.reason:
        notes = (*notes, f"{judged.reason}; the {kept} is left out")
    return joint.noting(*notes, doubt=judged.doubt)


_WITHOUT_PLACE = "it is left out; check latitude, longitude and date, and that attitude counts from true north"


def _without_wrong_place(recording: SampleSource, known: Known) -> tuple[Known, tuple[str, ...]]:
    """Return what is known without a main field of another intensity than the scalar reads, and a note of that."""
    read, scalar_T = known.intensity, recording.thinned(SKETCH).scalar_T
    if scalar_T is not None and recording.scalar_count is not None:
        read = Intensity(float(np.nanmean(scalar_T)), 0.0)
    if known.main_field_T is None or read is None:
        return known, ()
    value_T, (read_T, error_T) = float(norm(known.main_field_T)), read
    if abs(read_T - value_T) <= FAR * np.hypot(LOCAL_STANDARD_ERROR_T, error_T):
        return known, ()
    sizes = f"{to_nanotesla(read_T):.0f} nT, the field of the place is {to_nanotesla(value_T):.0f} nT"
    return replace(known, main_field_T=None), (f"the scalar reads {sizes}: {_WITHOUT_PLACE}",)


def _with_known(recording: SampleSource, array: Array, known: Known) -> JointCalibration:
    if known.prior is not None and is_weak(known.prior):
        return _with_weak_prior(recording, array, known)
    return _with_prior(recording, array, known)


def _with_prior(recording: SampleSource, array: Array, used: Known) -> JointCalibration:
    """Return the calibration with a prior that leaves no error open; what moved since then is learned anew."""
    given = used.prior
    # What was slow on this vehicle is taken for slow again: little of it passes for a change of a sensor.
    factors = WHITE if given is None else given.calibration.variance_factors
    for attempt in range(_MOST_ROUNDS):
        known = replace(used, variance_factors=factors)
        updated, (*before, last) = _updated(recording, array, known)
        is_slow_before = any(each.exceed(factors, SETTLED) for each in before)
        if attempt == 0 and before and last.exceed(factors, SETTLED) and not is_slow_before:
            # What lasts after a change, and did not before, may be what another change leaves.
            several, measured = _updated(recording, array, known, MOST_CHANGES)
            if not any(each.exceed(factors, SETTLED) for each in measured):
                updated = several
                break
        if not (is_slow_before or last.exceed(factors, SETTLED)):
            break
        factors = reduce(VarianceFactors.at_least, before, last.at_least(factors))
    if updated.refusal is not None:
        since_s = updated.recording.time_span_s[0] - origin_of(recording.time_span_s[0])
        raise Refused(f"something moved at {since_s:.1f} s, and {updated.refusal}") from updated.refusal
    fit = partial(maximum_a_posteriori, known=updated.known)
    with _naming_changes(updated.moved):
        calibration = accepted(updated.recording, array, fit)
    if given is not None:
        assert updated.difference is not None
        chi_square, freedom = updated.difference.chi_square, updated.difference.freedom
        update = update_of(calibration, given, updated.prior_of(given), chi_square, freedom, updated.moved)
        calibration = replace(calibration, update=update, warnings=_doubts(calibration, given, update, updated.unnamed))
    if (use := updated.known.gyroscope) is not None:
        # Fits to most of the samples begin where that to all has ended.
        place = Place(calibration.errors, calibration.intensity_T)
        use = replace(use, stride=-(-updated.recording.sample_count // BLOCK))
        if calibration.frame == FRAME_OF_GYROSCOPE:
            use = replace(use, start=replace(use.start, mount=np.eye(3)))
        fit = partial(maximum_a_posteriori, known=replace(updated.known, gyroscope=use, start=place))
    has_motion = updated.known.gyroscope is not None or array.attitude_noise is not None
    return JointCalibration(calibration, updated.recording, array, fit, None if has_motion else updated.known)


def _updated(
    recording: SampleSource, array: Array, known: Known, most_times: int = 1
) -> tuple[UpdatedPrior, list[VarianceFactors]]:
    """Return what a recording contradicts a prior in, and by what each of its parts then varies more than white noise.

    Of samples after a change that make no calibration that is not known, and taken for that of white noise.
    """
    updated = update_prior(recording, array, replace(known, gyroscope=None, start=None), most_times)
    updated = replace(updated, known=replace(updated.known, gyroscope=known.gyroscope, start=known.start))
    last = [] if updated.refusal is not None else [(updated.recording, updated.known)]
    with _naming_changes(updated.moved):
        measured = [
            variance_factors(maximum_a_posteriori(part, array, used), part) for part, used in (*updated.earlier, *last)
        ]
    return updated, measured if last else [*measured, WHITE]


def _doubts(calibration: Calibration, given: Prior, update: Update, unnamed: Sequence[Unnamed]) -> tuple[str, ...]:
    """Return warnings of changes that may be others than those named."""
    doubts = []
    if any(each.together == (SEVERAL, 0) for each in update.moved):
        doubts.append(
            "all errors of all sensors seem to have changed since the prior. Other sensors, sensors in another order, "
            "and a field that is not uniform, as near a source, look the same: turn the array elsewhere, and compare"
        )
    elif update.moved and (more := [each for each in unnamed if each.probability > PLAUSIBLE]):
        names = ", ".join(f"{each.name} (probability {each.probability:.2g})" for each in more)
        doubts.append(
            f"more may have changed since the prior than what is named: {names}; the standard errors allow for it: "
            "turn the array all round"
        )
    noise, before = (norm(each.array.vector_noise_T) for each in (calibration, given.calibration))
    # Noise over that of the prior, where none is stated: estimates from twenty samples differ by less.
    if calibration.noise_is_estimated and given.rates is not None and noise > 3.0 * before:
        doubts.append(
            f"the readings scatter {noise / before:.3g} times as much as those of the prior did: their noise has "
            "grown, which the array file should state then, or something moved for a while"
        )
    return tuple(doubts)


@contextmanager
def _naming_changes(moved: tuple[Moved, ...]) -> Iterator[None]:
    """Say of a refusal what moved: what the prior tells of it counts no more."""
    try:
        yield
    except (InputError, Refused) as problem:
        if not moved:
            raise
        what = dict.fromkeys(f"the {in_words(*each.together or (each.kind, each.sensor))}" for each in moved)
        raise type(problem)(f"{' and '.join(what)} moved since the prior, and {problem}") from problem


def _with_weak_prior(recording: SampleSource, array: Array, known: Known) -> JointCalibration:
    """Return the calibration with a prior that leaves errors open, or that of readings that contradict it, alone."""
    calibration, settled, fit = calibrate_with_weak_prior(recording, array, known)
    update = calibration.update
    assert update is not None
    if update.probability >= SIGNIFICANT:
        require_one_calibration(recording, calibration)
        has_motion = known.gyroscope is not None or array.attitude_noise is not None
        return JointCalibration(calibration, recording, array, fit, None if has_motion else settled)
    contradiction = (
        f"the readings contradict {update.prior_in_words}, χ² {update.chi_square:.3g} of {update.freedom} errors"
    )
    try:
        require_determined(recording, array)
        alone = _with_prior(recording, array, replace(known, prior=None))
    except (InputError, Refused):
        remedy = "faster change_rates"
        if update.rates is None:
            remedy = "tolerances that the sensors keep to, and the rotations of sensors that are turned"
        raise Refused(
            f"{contradiction}, and tell too little alone: state the noise that they have, {remedy}; or turn the array "
            "further"
        ) from None
    update = replace(update, data_share=np.where(np.isnan(update.data_share), np.nan, 1.0))
    calibration = replace(alone.calibration, update=update, warnings=(f"{contradiction}, and count alone",))
    return alone._replace(calibration=calibration)
