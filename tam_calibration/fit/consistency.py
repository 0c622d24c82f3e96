"""Whether one calibration describes a whole recording, and what speaks against trusting it.

Of a recording of more than ``SKETCH`` samples every n-th one is looked at.
Each doubt says what is wrong and, behind the last colon, what to do.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.correction.acceptance import WRONG_PART
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.coverage import field_of, measure_coverage
from tam_calibration.fit.ellipsoid import normalize, sphere_of_most
from tam_calibration.fit.identifiability import require_accurate
from tam_calibration.fit.reference import FOLLOWS
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import FEWEST_SAMPLES, SKETCH, SampleSource
from tam_calibration.model.sensor_errors import residual_series
from tam_calibration.model.units import FloatArray, from_degrees, origin_of, rounded, to_degrees, to_nanotesla

SOMETHING_MAGNETIC = "something magnetic came near, or a sensor changed"
"""What is suspected of a residual that changes, as long as no diagnosis finds another cause."""

PARTS_APART, LEAVE_OUT = "calibrate the parts apart", "leave that time out"
"""What to do about a change within a recording, as long as no diagnosis finds an effect that explains it."""


@dataclass(frozen=True, eq=False)
class _Parts:
    """Median size of the intensity residual, tesla, in parts of equal length, and their first and last times."""

    residual_T: FloatArray
    start_s: FloatArray
    end_s: FloatArray

    def exceeds(self, residual_T: float) -> bool:
        """Whether the residual changes much between the parts and grows above a size."""
        loud = float(self.residual_T.max())
        # Of the largest to the smallest residual; in the shortest parts white noise of four sensors makes 2.5 once
        # in 1000.
        return loud > residual_T and loud > 4.0 * float(self.residual_T.min())

    def require_steady(self, residual_T: float) -> None:
        """Refuse a residual that changes and exceeds a size."""
        if self.exceeds(residual_T):
            raise Refused(f"the recording is not one calibration: {self.sentence()}: {PARTS_APART}")

    def sentence(self) -> str:
        loud, quiet = int(self.residual_T.argmax()), int(self.residual_T.argmin())
        return (
            f"the residual of the intensity is {self._describe(quiet)} but {self._describe(loud)}: "
            + SOMETHING_MAGNETIC
        )

    def _describe(self, part: int) -> str:
        residual_nT = to_nanotesla(float(self.residual_T[part]))
        first_s, last_s = (one[part] - origin_of(self.start_s[0]) for one in (self.start_s, self.end_s))
        return f"{rounded(residual_nT, 3)} nT between {first_s:.1f} and {last_s:.1f} s"


def require_one_calibration(recording: SampleSource, calibration: Calibration) -> None:
    """Check that a fit is of a field on Earth and leaves the same residual throughout the recording.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors.
    calibration : Calibration
        What was fitted to them.

    Raises
    ------
    Refused
        With the reason, and the times at which the residual is smallest and largest.
    """
    field = calibration.array.field
    _residual_in_parts(recording, calibration).require_steady(WRONG_PART * calibration.intensity_T)
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
    # Part of the radius of a sphere that most readings are near; errors of scale and angles make readings miss it
    # too.
    _in_parts(data.radius_T * distance, some.time_s).require_steady(0.05 * data.radius_T)


def residual_that_changes(recording: SampleSource, calibration: Calibration) -> str:
    """Say when the residual of the intensity is small and when large; empty where it hardly changes.

    Parameters
    ----------
    recording : SampleSource
        Raw readings.
    calibration : Calibration
        What was fitted to them.
    """
    parts = _residual_in_parts(recording, calibration)
    # Part of the intensity, half a nanotesla: what is less, no calibration is asked for.
    if not parts.exceeds(1e-5 * calibration.intensity_T):
        return ""
    return f"{parts.sentence()}: {LEAVE_OUT} with --from and --until"


def _residual_in_parts(recording: SampleSource, calibration: Calibration) -> _Parts:
    some = recording.thinned(SKETCH)
    series = residual_series(calibration.errors, calibration.array, some, calibration.intensity_T)
    known = np.isfinite(series.center_intensity_T)
    return _in_parts(np.abs(series.sensor_intensity_T[known]).max(axis=1), some.time_s[known])


def _in_parts(residual: FloatArray, time: FloatArray) -> _Parts:
    """Return the medians of ten parts; of one that changes nothing where there are too few samples."""
    # Ten samples make the median of a part certain to a third; each part has some turns of a usual survey.
    if len(residual) < 100:
        return _Parts(*np.zeros((3, 1)))
    chunks = np.array_split(np.arange(len(residual)), 10)
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
    require_one_calibration(recording, calibration)
    return require_accurate(calibration, recording, accept)


LOOK_FOR_CAUSE = "look for the cause with tam diagnose"
"""What to do about a residual."""


def doubts_of(recording: SampleSource, calibration: Calibration) -> tuple[str, ...]:
    """Return what speaks against trusting a calibration, one sentence each, the gravest first.

    Parameters
    ----------
    recording : SampleSource
        Raw readings; of a large one every n-th sample is looked at.
    calibration : Calibration
        What was fitted to them, with its residuals of held-out samples where there are any.
    """
    some, has_attitude = recording.thinned(SKETCH), calibration.array.attitude_noise is not None
    found = (
        _residual(calibration),
        _small_residual(calibration),
        residual_that_changes(some, calibration),
        # What a prior or attitude tells need not be visited: the standard errors say whether both are enough.
        "" if calibration.update or has_attitude else _coverage(some, calibration),
        "" if has_attitude else _standard_errors(calibration),
        _geometry(calibration),
        _first_sensor(calibration),
        "" if calibration.update else _bias(calibration),
    )
    return tuple(filter(None, found))


def naming_causes(fit: Callable[[], Calibration], explained: Callable[[Sequence[str]], tuple[str, ...]]) -> Calibration:
    """Return the calibration of a fit; its doubts, or its refusal, name the cause where a diagnosis may find one.

    Parameters
    ----------
    fit : callable
        Makes the calibration. Effects that it fits are known causes.
    explained : callable
        From sentences to the same with the cause.

    Raises
    ------
    InputError, Refused
        As the fit.
    """
    try:
        calibration = fit()
    except Refused as problem:
        if not is_unexplained([str(problem)]):
            raise
        raise Refused(*explained([str(problem)])) from problem
    if calibration.effects or not is_unexplained(calibration.warnings):
        return calibration
    return replace(calibration, warnings=explained(calibration.warnings))


def is_unexplained(sentences: Iterable[str]) -> bool:
    """Whether a sentence is of a residual, or a change, whose cause a diagnosis may find."""
    return any(words in one for one in sentences for words in (LOOK_FOR_CAUSE, PARTS_APART, LEAVE_OUT))


def _residual(calibration: Calibration) -> str:
    """Compare with the floor, leaving room for three standard deviations of an RMS of so many samples."""
    # Largest residual over noise floor, apart from chance: data sheets are hardly more exact.
    accepted = 1.1 + 3 / np.sqrt(2 * calibration.samples)
    residuals, floor = calibration.best_residuals, calibration.floor
    sensors = residuals.sensor_intensity_T / floor.sensor_intensity_T
    ratios = {f"|B| of sensor {sensor + 1}": float(value) for sensor, value in enumerate(sensors)}
    if calibration.array.has_gradient:
        ratios["the tensor"] = residuals.tensor_rmse_T_per_m / floor.tensor_rmse_T_per_m
    chi_square, channels = calibration.reduced_chi_square, calibration.channels_in_words
    ratios |= {words: float(np.sqrt(chi_square[name])) for name, words in channels.items() if name in chi_square}
    high = [(name, value) for name, value in ratios.items() if not value <= accepted]
    # Residuals that a doubt names, the largest first.
    worst = ", ".join(f"{name} {rounded(value, 3)} times" for name, value in sorted(high, key=lambda one: -one[1])[:2])
    factor = float(np.sqrt(max(calibration.variance_factors)))
    widened = (
        f"; its slow part is {factor:.3g} times that of white noise, and standard errors have been increased"
        if factor > 1
        else ""
    )
    # Samples over how long their noise lasts, from which standard errors hold (benchmarks/error_coverage.py).
    if widened and (independent := calibration.samples / factor**2) < 100.0:
        widened += f" but may still be too small ({independent:.0f} independent samples)"
    if high:
        return f"the residual is above the noise floor ({worst}){widened}: {LOOK_FOR_CAUSE}"
    if widened:
        return f"the residual is correlated in time{widened}: {LOOK_FOR_CAUSE}"
    return ""


def _small_residual(calibration: Calibration) -> str:
    """Say where less than half of the stated noise is left, six standard deviations of χ² below that."""
    chance = 6 * np.sqrt(2 / max(1, calibration.samples - FEWEST_SAMPLES))
    chi_square, channels = calibration.reduced_chi_square, calibration.channels_in_words
    # Smallest reduced χ², of half the stated noise: data sheets guarantee more than sensors make.
    small = {name: chi_square[name] for name in channels if chi_square.get(name, 1.0) < min(0.25, 1 - chance)}
    if not small:
        return ""
    ratio = float(np.sqrt(max(small.values())))
    words = " and ".join(channels[name] for name in small)
    return (
        f"the residual {words} is only {ratio:.2g} times the stated noise, so standard errors are {1 / ratio:.2g} "
        "times too large: state less noise, or leave it out to have it estimated"
    )


def _coverage(recording: SampleSource, calibration: Calibration) -> str:
    coverage = measure_coverage(field_of(recording.whole(), calibration.errors))
    if coverage.enough:
        return ""
    return f"the field visited only {coverage.fraction:.0%} of the sphere of directions: {coverage.advice}"


def _standard_errors(calibration: Calibration) -> str:
    """Compare the standard error of corrected samples, as a mean over all directions, with that of sensor noise."""
    noise = np.sqrt(calibration.correction_matrix**2 @ np.repeat(calibration.array.vector_noise_T**2, 3))
    growth = float(np.nanmax(calibration.output_standard_errors / noise))
    # np.sqrt(2): largest standard error of a corrected sample over what sensor noise alone makes: both have an equal
    # part in it.
    if growth <= np.sqrt(2):
        return ""
    if of_scalar := next((note for note in calibration.notes if note.startswith(FOLLOWS)), ""):
        return of_scalar
    return (
        f"the parameter errors increase the error of a corrected sample to {rounded(growth, 3)} times that of sensor "
        "noise alone: record longer, in more directions"
    )


def _geometry(calibration: Calibration) -> str:
    # Three sensors determine a gradient unless they lie on one line.
    if calibration.array.sensor_count < 3 or calibration.array.has_gradient:
        return ""
    return "the sensors lie on one line, so the outputs have no gradient: place one sensor off that line"


def _first_sensor(calibration: Calibration) -> str:
    """Compare the turns of the other sensors, which all lie askew in the axes of a sensor 1 that does itself."""
    left, _, right = np.linalg.svd(calibration.errors.matrix)
    turns = left @ right
    if calibration.errors.sensor_count < 3 or (np.linalg.det(turns) < 0).any():
        return ""
    sizes = _angles(turns[1:])
    size = float(sizes.min())
    # from_degrees(5.0): turn of all other sensors against sensor 1 that no mounting makes by accident: sensors are
    # aligned to degrees.
    if size < from_degrees(5.0) or _angles(turns[2:] @ turns[1].T).max() > size / 3:
        return ""
    return (
        f"all other sensors are turned by {rounded(to_degrees(size))}° against sensor 1, whose axes are those of the "
        "array: state how sensor 1 is mounted (rotations_deg in the array file), or record attitude and use --method "
        "integrated"
    )


def _angles(turns: FloatArray) -> FloatArray:
    """Return the angles (n,) of rotation matrices (n, 3, 3), radians."""
    return np.asarray(np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1)))


def _bias(calibration: Calibration) -> str:
    bias_T = np.abs(calibration.errors.bias_T)
    sensor, axis = divmod(int(np.argmax(bias_T)), 3)
    ratio = float(bias_T[sensor, axis]) / calibration.intensity_T
    # Bias over the field from which a magnet or an offset of the driver is suspected: it uses up most of a usual
    # range.
    if ratio <= 2.0:
        return ""
    return (
        f"the bias of sensor {sensor + 1} {'xyz'[axis]} is {to_nanotesla(float(bias_T[sensor, axis])):.6g} nT, "
        f"{rounded(ratio)} times the field: look for a magnet at the sensor, and for an offset of its driver"
    )
