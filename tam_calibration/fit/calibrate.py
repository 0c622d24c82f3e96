"""One call from a recording to a calibration that was checked before, after, and on samples it has not seen.

The held-out residuals of a sample are those by errors that were fitted without it.
"""

from collections.abc import Collection, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial, reduce

import numpy as np

from tam_calibration.correction.acceptance import within_limits
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import published
from tam_calibration.fit.attitude_check import USE_IT, worth_of
from tam_calibration.fit.consistency import Fit, accepted, doubts_of
from tam_calibration.fit.estimate import widened
from tam_calibration.fit.identifiability import require_determined
from tam_calibration.fit.information import newton_step
from tam_calibration.fit.joint_calibration import JointCalibration, calibrate_jointly
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.problem import Known, Place, Problem
from tam_calibration.fit.recorded_attitude import is_attitude_data
from tam_calibration.fit.reference import turning_scalar
from tam_calibration.fit.screening import sound_readings
from tam_calibration.fit.what_changed import despite_changes, naming_changes, what_changed
from tam_calibration.integrity import require_enough, require_sound
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import FEWEST_SAMPLES, SKETCH, SampleSource
from tam_calibration.model.sensor_errors import Residuals, ResidualSums, SensorErrors
from tam_calibration.model.units import FloatArray

METHODS: dict[str, Fit] = {
    "maximum_likelihood": maximum_likelihood,
    "robust": partial(maximum_likelihood, robust=True),
    "lossless": published.lossless,
    "artificial_vector": published.artificial_vector,
    "fast_rotation": published.fast_rotation,
    "integrated": published.integrated,
    "two_step_linear": published.two_step_linear,
    "simplified_linear": published.simplified_linear,
}
DEFAULT_METHOD = "maximum_likelihood"


def calibrate(
    recording: SampleSource,
    array: Array,
    method: str = DEFAULT_METHOD,
    *,
    accept: Collection[str] = (),
    prior: Prior | Calibration | None = None,
    main_field_T: FloatArray | None = None,
) -> Calibration:
    """Fit the errors of an array's sensors and judge the fit.

    Parameters
    ----------
    recording : Recording
        Samples (N, K, 3), tesla, in a uniform field, with the array turned through many directions. Any
        ``SampleSource`` if it is larger than memory.
    array : Array
        Geometry and noise of K sensors; a noise that is not stated is estimated. Its tolerances are the prior of a
        maximum likelihood fit if no prior is given.
    method : str
        "maximum_likelihood", "robust", "lossless", "artificial_vector", "fast_rotation", "integrated",
        "two_step_linear" or "simplified_linear".
    accept : collection of str
        Names of findings that become warnings: ``tam_calibration.integrity.ACCEPTABLE``.
    prior : Calibration or Prior, optional
        A calibration of the same array, made less certain by possible changes since then, or a prior that is used as
        it is. The recording then needs to determine only what the prior leaves open.
    main_field_T : (3,) array, optional
        The field of a model at the place of the recording, east, north, up, tesla, with an error of
        ``LOCAL_STANDARD_ERROR_T``. It determines the scale without a scalar, and the heading with attitude as data.

    Returns
    -------
    Calibration
        Scale factors, non-orthogonality and misalignment [rad] and bias [T] of each sensor, with their covariance, and
        the residuals of held-out blocks of time if the recording is long enough.

    Raises
    ------
    InputError
        When the recording cannot be used, does not belong to the array or leaves parameters open.
    Refused
        When something changed within the recording, its channels are faulty, or the calibration exceeds a limit.

    Examples
    --------
    >>> from tam_calibration import calibrate, read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> calibration = calibrate(made.recording, made.scenario.array)
    >>> calibration.errors.scale_factor[1].round(3)  # sensor 2, x y z; the truth is 1.02, 0.96, 1.05
    array([1.02, 0.96, 1.05])
    >>> calibration.warnings
    ()
    """
    if method not in METHODS:
        raise InputError(f"there is no method {method!r}: choose one of {', '.join(METHODS)}")
    fit, takes_priors = METHODS[method], method == DEFAULT_METHOD
    is_joint = prior is not None or main_field_T is not None or is_attitude_data(recording, array)
    if is_joint and not takes_priors:
        raise InputError(f"priors and attitude as data go with {DEFAULT_METHOD}, not with {method}")
    if takes_priors and not is_joint:
        has_rates = recording.thinned(SKETCH).angular_velocity_rad_s is not None
        is_joint = has_rates or array.tolerances is not None
    array.require_recording(recording)
    recording, found, notes = _checked(recording, array, accept, method != "robust", is_joint)
    with nullcontext() if prior is not None else naming_changes(recording, array):
        if not is_joint:
            with _naming_attitude(recording, takes_priors):
                require_determined(recording, array)
        require_enough(recording.sample_count, accept)
        is_joint |= takes_priors and "scalar" not in accept and turning_scalar(recording, array) is not None
        if is_joint:
            made = calibrate_jointly(recording, array, prior, main_field_T, accept)
        else:
            with _naming_attitude(recording, takes_priors):
                known = Known() if takes_priors else None
                made = JointCalibration(accepted(recording, array, fit, accept), recording, array, fit, known)
    calibration = made.calibration if is_joint else widened(made.calibration, made.recording)
    if prior is None:
        # A scalar that was left out still tells changes of the field.
        calibration = despite_changes(calibration, recording, made.array, accept)
    if takes_priors and not is_attitude_data(recording, array) and (worth := worth_of(made.recording, calibration)):
        notes.append(worth)
    residuals = held_out_residuals(made.recording, made.array, made.fit, calibration, made.known)
    calibration = replace(calibration, held_out=residuals)
    warnings = (*found, *calibration.warnings, *doubts_of(made.recording, calibration))
    notes = [note for note in (*notes, *calibration.notes) if note not in warnings]
    return within_limits(replace(calibration, warnings=warnings, notes=tuple(notes)), accept)


def _checked(
    recording: SampleSource, array: Array, accept: Collection[str], is_screened: bool, is_joint: bool
) -> tuple[SampleSource, list[str], list[str]]:
    """Return the samples of sound channels, without single bad readings, what is doubted of them, and what is noted."""
    if is_screened:
        used, left_out, faults = sound_readings(recording, array, accept)
    else:
        used, left_out, faults = recording, None, require_sound(recording, array, accept)
    found = [fault.sentence for fault in faults if fault.severity != "note"]
    notes = [fault.sentence for fault in faults if fault.severity == "note"]
    # Samples from which noise that lasts shows in the residuals: ten in each of the blocks that are compared.
    if used.sample_count < 160:
        notes.append(
            f"{used.sample_count} samples do not show whether their noise is white, as the standard errors assume: "
            "record more if it may last from sample to sample"
        )
    recording.thinned(SKETCH).check_plausible(array.field)
    if left_out is None or (is_joint and left_out.is_lasting):  # the joint fit finds what has changed itself
        return recording, found, notes
    change = what_changed(recording, array) if left_out.is_lasting else None
    if change is not None and change.is_explained:
        return used, [*found, f"{change.what}, and this is the calibration of the longer part: {change.todo}"], notes
    return used, found, [*notes, *left_out.sentences()]


@contextmanager
def _naming_attitude(recording: SampleSource, may_be_used: bool) -> Iterator[None]:
    """Say of readings that do not suffice that recorded attitude may help."""
    try:
        yield
    except InputError as problem:
        if not may_be_used or recording.thinned(SKETCH).attitude is None:
            raise
        raise InputError(f"{problem}; or {USE_IT}") from problem


_FOLDS, _BLOCKS_PER_FOLD = 5, 10
"""A fifth of the samples is held out at once, in blocks of time so short that no fold lacks an attitude."""


def held_out_residuals(
    recording: SampleSource, array: Array, fit: Fit, calibration: Calibration, known: Known | None
) -> Residuals | None:
    """Return the residuals of every sample, each corrected by the other folds of blocks of time.

    Parameters
    ----------
    recording : SampleSource
        Raw readings.
    array : Array
        As it was given to the fit.
    fit : callable
        The method.
    calibration : Calibration
        Of all samples.
    known : Known, optional
        What a maximum likelihood fit knows in addition. Without its part of the normal equations, one Gauss-Newton
        step then leads from the calibration to the fit of the other folds. By default these are fitted anew.

    Returns
    -------
    Residuals or None
        None if the recording is too short, or the other folds make no calibration.
    """
    count = recording.sample_count
    fold_of = (np.arange(count) * (_FOLDS * _BLOCKS_PER_FOLD) // count % _FOLDS).astype(np.int8)
    sizes = np.bincount(fold_of, minlength=_FOLDS)
    if not sizes.all() or count - sizes.max() < 2 * FEWEST_SAMPLES:
        return None
    folds = [recording.take(fold_of == fold) for fold in range(_FOLDS)]
    try:
        if known is not None:
            found = _by_steps(folds, array, calibration, known)
        else:
            fits = (fit(recording.take(fold_of != fold), array) for fold in range(_FOLDS))
            found = [(one.errors, one.intensity_T) for one in fits]
        sums = []
        for fold, (errors, intensity_T) in zip(folds, found, strict=True):
            # A fold between two readings of a slow scalar says nothing of the intensity.
            is_unread = recording.scalar_count is not None and fold.scalar_count is None
            sums.append(ResidualSums.of(errors, array, fold, np.nan if is_unread else intensity_T))
        return reduce(ResidualSums.plus, sums).result()
    except (InputError, Refused):
        return None


def _by_steps(
    folds: list[SampleSource], array: Array, calibration: Calibration, known: Known
) -> list[tuple[SensorErrors, float]]:
    """Return the errors and the intensity of the fit to the other folds, for each fold."""
    place = Place(calibration.errors, calibration.intensity_T)
    used, has_scalar = replace(known, start=place), any(fold.scalar_count is not None for fold in folds)
    problems = [Problem.of(fold, calibration.array, used, has_scalar) for fold in folds]
    parts = [problem.data_at(place) for problem in problems]
    whole, basis = sum(parts, problems[0].known_at(place)), problems[0].basis_at(place)
    found = []
    for problem, own in zip(problems, parts, strict=True):
        others = (whole - own).by(basis)
        step = newton_step(others.information, others.score)
        moved = problem.moved(place, basis @ step)
        found.append((moved.errors, moved.intensity_T))
    return found
