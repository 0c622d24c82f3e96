"""The Fisher information of samples, taken apart, and what follows from it: steps, bound, what a recording determines.

A sample's 3K + 1 readings without its three field components are 3K - 3 differential channels, which are affine in the
field, and one common mode, the residual of the intensity. The information of all samples is therefore one 9 × 9 matrix,
by the elements of an ellipsoid, and one 4 × 4 matrix, by those of an affine map, whatever the number of sensors; a
sample adds an outer product to each, so that the worth of one more attitude costs next to nothing.

What a recording determines, well or badly, is said by the names of the parameters, before and after a fit.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.core.least_squares import Elimination, scaled
from tam_calibration.core.noise import complete_noise
from tam_calibration.correction.acceptance import LARGEST_ANGLE_ERROR, LARGEST_RELATIVE_ERROR
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.coverage import (
    CELLS,
    ENOUGH_RELATIVE_ERROR,
    cell_directions,
    ellipsoid_rows,
    field_of,
    measure_coverage,
)
from tam_calibration.fit.ellipsoid import (
    COLUMNS,
    NO_ELLIPSOID,
    ROWS,
    determined,
    free_scale_gradient,
    normalize,
    without_scale,
)
from tam_calibration.fit.likelihood import Likelihood
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import MOST_NAMED, InputError, Refused
from tam_calibration.model.recording import BLOCK, FEWEST_SAMPLES, SKETCH, Recording, SampleSource
from tam_calibration.model.sensor_errors import PARAMETER_NAMES, SensorErrors
from tam_calibration.model.units import FloatArray, to_nanotesla

Place = TypeVar("Place")
Kept = TypeVar("Kept")

NOT_ONE = "the readings do not fit one calibration, look for a change of field or sensor during the recording"


def descend(
    normal_at: Callable[[Place], tuple[FloatArray, FloatArray, Kept]],
    moved: Callable[[Place, FloatArray], Place],
    place: Place,
    robust: bool = False,
) -> tuple[Place, Kept]:
    """Return the place where Gauss-Newton steps settle, and what was kept a last step before.

    Parameters
    ----------
    normal_at : callable
        From a place to the information (M, M) of what is free there, the downhill gradient (M,), and what to keep.
    moved : callable
        From a place and a step (M,) to the next place.
    place : Place
        Where to begin.
    robust : bool
        Whether the weights of the samples change from step to step.

    Raises
    ------
    InputError
        When the information is singular.
    Refused
        When the iteration does not settle.
    """
    before = np.inf
    for _ in range(100):
        information, gradient, kept = normal_at(place)
        step = newton_step(information, gradient)
        # Twice the fall of the likelihood that the step promises; below one it is part of a standard error.
        decrement = float(step @ gradient)
        # Newton's steps fall quadratically until rounding stops them, those with new weights by a constant factor.
        is_rounding = not robust and decrement < 1e-2 and decrement > before / 4
        place, before = moved(place, step), decrement
        if is_rounding or decrement < (1e-5 if robust else 1e-6):
            return place, kept
    raise Refused(f"the fit did not settle in 100 steps: {NOT_ONE}")


@determined()
def newton_step(information: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return the step (M,) to the maximum of a parabola, with its information (M, M) and downhill gradient (M,).

    Raises
    ------
    InputError
        When the information is singular.
    """
    unit, scale = scaled(information)
    if not (np.diag(information) > 0).all():
        raise InputError(NO_ELLIPSOID)
    return np.asarray(np.linalg.solve(unit, gradient / scale) / scale)


def bound(field_T: FloatArray, errors: SensorErrors, array: KnownNoiseArray, has_scalar: bool) -> FloatArray:
    """Return the smallest covariance of the parameters for given fields.

    Parameters
    ----------
    field_T : (N, 3) array
        Uniform fields in the array frame, tesla.
    errors : SensorErrors
        The truth; the misalignment of sensor 1 counts as known, see ``Calibration.statements``.
    array : Array
        With every noise stated.
    has_scalar : bool
        Whether each field's intensity was read with the array's scalar noise. Otherwise the intensity is an unknown
        constant, the scale is free and the mean determinant is fixed.

    Returns
    -------
    (12 K, 12 K) array
        In the order of ``SensorErrors.to_vector`` flattened, SI; infinite on the diagonal where undetermined.
    """
    intensity = np.linalg.norm(field_T, axis=1)
    unit = float(intensity.mean())
    scalar_noise = array.scalar_noise_T / unit if has_scalar else 0.0
    likelihood = Likelihood(errors.distort(field_T) / unit, intensity / unit, array.vector_noise_T / unit, scalar_noise)
    point = likelihood.linearize(errors.matrix, errors.bias_T / unit)
    return parameter_covariance(point.both.information, errors, unit, None if has_scalar else unit)


def parameter_covariance(
    information: FloatArray, errors: SensorErrors, unit_T: float, free_intensity_T: float | None
) -> FloatArray:
    """Return the covariance of the parameters from the information of the rows [D Λ | o].

    Parameters
    ----------
    information : (12 K, 12 K) array
        Of the rows [D Λ | o], fields and biases in units of ``unit_T``.
    errors : SensorErrors
        Where it was linearised.
    unit_T : float
        Unit of field of the information, tesla.
    free_intensity_T : float, optional
        The fitted constant intensity where no scalar reference fixes the scale.

    Returns
    -------
    (12 K, 12 K) array
        Zero for the fixed misalignment of sensor 1, infinite on the diagonal where the data leave a parameter open.
    """
    count = errors.sensor_count
    jacobian = rows_by_unknowns(errors, unit_T, free_intensity_T)
    free = np.ones(jacobian.shape[1], dtype=bool)
    free[9:12] = False
    basis = free_basis(errors, free, holds_scale=free_intensity_T is not None)
    covariance = inverted(jacobian.T @ information @ jacobian, basis)
    return covariance[: 12 * count, : 12 * count]


def rows_by_unknowns(errors: SensorErrors, unit_T: float, free_intensity_T: float | None) -> FloatArray:
    """Return the derivative of the rows [D Λ | o] of a fit by the errors of the sensors and the intensity.

    Parameters
    ----------
    errors : SensorErrors
        Where it is taken.
    unit_T : float
        Unit of field of the rows, tesla.
    free_intensity_T : float, optional
        The constant intensity, where no scalar reference tells it.

    Returns
    -------
    (12 K, 12 K or 12 K + 1) array
        The last column by the intensity over its unit, where it is free.
    """
    count = errors.sensor_count
    # Without a reference the rows of D Λ enter times the intensity F: d(F D Λ) = F d(D Λ) + D Λ dF.
    factor = 1.0 if free_intensity_T is None else free_intensity_T / unit_T
    blocks = errors.jacobian() * np.array([factor, factor, factor, 1 / unit_T])[:, None]
    by_errors = _block_diagonal(blocks).reshape(12 * count, 12 * count)
    if free_intensity_T is None:
        return by_errors
    by_intensity = np.concatenate([errors.matrix, np.zeros((count, 3, 1))], axis=2).reshape(-1, 1)
    return np.hstack([by_errors, by_intensity])


def free_basis(errors: SensorErrors, free: np.ndarray, holds_scale: bool) -> FloatArray:
    """Return the directions, as columns, of those unknowns (P,) that are free, the errors of the sensors first.

    Where the scale is held, the mean determinant does not change along them.
    """
    basis: FloatArray = np.eye(len(free))[:, free]
    if not holds_scale:
        return basis
    gradient = np.pad(free_scale_gradient(errors), (0, len(free) - 12 * errors.sensor_count))
    _, _, right = np.linalg.svd(gradient[None, free])
    return np.asarray(basis @ right[1:].T)


def inverted(information: FloatArray, basis: FloatArray) -> FloatArray:
    """Return basis (basisᵀ I basis)⁻¹ basisᵀ, with an infinite variance of what the information leaves open."""
    inside = basis.T @ information @ basis
    scale = 1 / np.sqrt(np.maximum(np.diag(inside), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(inside * np.outer(scale, scale))
    seen = values > 1e-13 * values[-1]
    directions = basis @ (scale[:, None] * vectors)
    covariance: FloatArray = (directions[:, seen] / values[seen]) @ directions[:, seen].T
    # A parameter is open when an unseen direction moves it by a part of its error with all others known.
    alone = np.linalg.norm(basis * scale, axis=1)
    open_ = np.linalg.norm(directions[:, ~seen], axis=1) > 1e-2 * np.maximum(alone, np.finfo(float).tiny)
    covariance[np.diag_indices_from(covariance)] = np.where(open_, np.inf, np.diag(covariance))
    return covariance


def information_of(rows: FloatArray) -> FloatArray:
    """Return the (13, 13) Fisher information of samples, which adds up, from what each is sensitive to.

    Parameters
    ----------
    rows : (N, 13) array
        As of ``InformationModel.rows``.

    Returns
    -------
    (13, 13) array
        Of the common mode by the nine elements of an ellipsoid, and of each differential channel by the four elements
        of an affine map.
    """
    information: FloatArray = rows.T @ rows
    information[:9, 9:] = information[9:, :9] = 0
    return information


@dataclass(frozen=True, eq=False)
class InformationModel:
    """How information and the variances of the parameters follow from fields, linearised at given errors.

    Parameters
    ----------
    errors : SensorErrors
        Where it is linearised; the misalignment of sensor 1 counts as known.
    array : Array
        With every noise stated.
    has_scalar : bool
        Whether a scalar reference gives the scale; otherwise the intensity is an unknown constant and the mean
        determinant is fixed.
    intensity_T : float
        Of the field, tesla.
    """

    errors: SensorErrors
    array: KnownNoiseArray
    has_scalar: bool
    intensity_T: float

    def rows(self, field_T: FloatArray) -> FloatArray:
        """Return what samples at fields (N, 3) in the array frame, tesla, are sensitive to, in units of their noise.

        Returns
        -------
        (N, 13) array
            The common mode by the elements of an ellipsoid, and each differential channel by field and 1.
        """
        length = norm(field_T, axis=1, keepdims=True)
        direction = field_T / length
        scalar_noise = self.array.scalar_noise_T / self.intensity_T if self.has_scalar else 0.0
        variance = scalar_noise**2 + self._elimination.variance_along(direction.T)[:, None]
        ellipsoid = ellipsoid_rows(direction) / np.sqrt(variance)
        ellipsoid[:, :6] *= length / self.intensity_T
        return np.hstack([ellipsoid, field_T / self.intensity_T, np.ones_like(length)])

    def variances(self, information: FloatArray) -> FloatArray:
        """Return the (12 K,) variances of the parameters, SI; infinite where undetermined."""
        ellipsoid, affine = self.loadings
        known, open_ = _split(information[:9, :9])
        known_affine, open_affine = _split(information[9:, 9:])
        variance = np.sum((ellipsoid @ known) * ellipsoid, axis=1)
        variance += np.sum((affine @ known_affine) * affine, axis=(1, 2))
        is_open = norm(ellipsoid @ open_, axis=1) > 1e-2 * norm(ellipsoid, axis=1)
        is_open |= norm(affine @ open_affine, axis=(1, 2)) > 1e-2 * norm(affine, axis=(1, 2))
        return np.where(is_open, np.inf, variance)

    def variances_with(self, information: FloatArray, rows: FloatArray) -> FloatArray:
        """Return the variances of the parameters when one of N samples is added to what is known.

        Parameters
        ----------
        information : (13, 13) array
            Of what is known; not singular.
        rows : (N, 13) array
            Of the N samples, of which each is added alone.

        Returns
        -------
        (N, 12 K) array
            Variances in the order of ``SensorErrors.to_vector`` flattened, SI.
        """
        ellipsoid, affine = self.loadings
        square = np.einsum("pki,pkj->pij", affine, affine).reshape(len(affine), 16)
        inverse, inverse_affine = inv(information[:9, :9]), inv(information[9:, 9:])
        # Sherman and Morrison's formula for the inverse of a matrix to which an outer product is added.
        gain, gain_affine = rows[:, :9] @ inverse, rows[:, 9:] @ inverse_affine
        rest = 1 + np.sum(gain * rows[:, :9], axis=1, keepdims=True)
        rest_affine = 1 + np.sum(gain_affine * rows[:, 9:], axis=1, keepdims=True)
        variance = np.sum((ellipsoid @ inverse) * ellipsoid, axis=1) + square @ inverse_affine.ravel()
        outer = (gain_affine[:, :, None] * gain_affine[:, None, :]).reshape(-1, 16)
        return np.asarray(variance - (gain @ ellipsoid.T) ** 2 / rest - outer @ square.T / rest_affine)

    @cached_property
    def noise_units(self) -> FloatArray:
        """(12 K,) factors that turn a bias, and a scale factor or angle times the field, into units of the noise."""
        relative = np.repeat([self.intensity_T, self.intensity_T, 1.0, self.intensity_T], 3)
        return np.outer(1 / self.array.vector_noise_T, relative).ravel()

    @cached_property
    def loadings(self) -> tuple[FloatArray, FloatArray]:
        """(12 K, 9) and (12 K, 3 K - 3, 4) parameters by the elements of the ellipsoid and of each affine map."""
        count = self.errors.sensor_count
        free = np.ones(12 * count, dtype=bool)
        free[9:12] = False
        in_unit = np.tile(np.repeat([1.0, 1.0, self.intensity_T, 1.0], 3), count)
        jacobian = _block_diagonal(self.errors.jacobian()) * in_unit
        jacobian[:, 3] /= self.intensity_T
        jacobian = jacobian[..., free]
        common = np.tensordot(self._elimination.unmixing, jacobian, 1)
        symmetric = (common[ROWS, COLUMNS] + common[COLUMNS, ROWS]) / 2
        affine = np.tensordot(self._elimination.directions.T, jacobian, 1).reshape(12 * count - 12, 12 * count - 3)
        loadings = np.zeros((12 * count, 12 * count - 3))
        loadings[free] = inv(np.concatenate([symmetric, common[:, 3], affine]))
        loadings = in_unit[:, None] * (loadings if self.has_scalar else without_scale(self.errors) @ loadings)
        return loadings[:, :9], loadings[:, 9:].reshape(12 * count, -1, 4)

    @cached_property
    def _elimination(self) -> Elimination:
        """Of the field in units of the intensity."""
        return Elimination.of_sensors(self.errors, self.array.vector_noise_T / self.intensity_T)


def _block_diagonal(blocks: FloatArray) -> FloatArray:
    """Return the (3 K, 4, 12 K) derivatives of all sensors from those of each, (K, 3, 4, 12)."""
    count = len(blocks)
    return np.asarray(np.einsum("kl,kxyp->kxylp", np.eye(count), blocks).reshape(3 * count, 4, 12 * count))


def _split(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the pseudo-inverse, and the (M, J) directions that the information leaves open."""
    values, vectors = np.linalg.eigh(information)
    seen = values > 1e-13 * values[-1]
    return (vectors[:, seen] / values[seen]) @ vectors[:, seen].T, vectors[:, ~seen]


def require_determined(recording: SampleSource, array: Array, is_uniform: bool = True) -> None:
    """Check, before a fit, that a recording determines all parameters.

    The bound is taken at error-free sensors whose fields are the readings about the centre of their sphere. In a field
    that is not uniform what the sensors differ in is not taken for noise.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors.
    array : Array
        Noise of these sensors; a noise that is not stated is estimated.
    is_uniform : bool
        Whether the field is uniform.

    Raises
    ------
    InputError
        When there are too few samples, or parameters stay open; it names them.
    Refused
        When the directions are enough, and sensors in one field do not read so.
    """
    count = recording.sample_count
    if count < FEWEST_SAMPLES:
        raise InputError(
            f"{count} samples cannot determine the {12 * recording.sensor_count - 3} parameters of "
            f"{recording.sensor_count} sensors: at least {FEWEST_SAMPLES} different attitudes are needed, better 50"
        )
    scalar_count = recording.scalar_count
    if scalar_count is not None and scalar_count < FEWEST_SAMPLES:
        raise InputError(
            f"only {scalar_count} samples have a scalar reading: at least {FEWEST_SAMPLES} are needed, or none"
        )
    noisy, _ = complete_noise(array, recording)
    data = normalize(recording.thinned(SKETCH))
    field = data.radius_T * data.points[np.isfinite(data.intensity), 0]
    some = field[:: -(-len(field) // BLOCK)]
    covariance = bound(some, SensorErrors.none(recording.sensor_count), noisy, data.has_scalar)
    excess = 1.0
    if is_uniform and recording.sensor_count > 1:
        # By how much the noise in which the sensors differ is larger than stated: noise spreads readings that lie in a
        # plane, and must not pass for directions that were visited.
        whitened = data.points / (noisy.vector_noise_T / data.radius_T)[:, None]
        differing = np.linalg.eigvalsh(np.cov(whitened.reshape(len(whitened), -1), rowvar=False))[:-3]
        excess = float(np.sqrt(max(1.0, differing.mean())))
    if problem := _inaccuracy(np.sqrt(np.diag(covariance)), excess, data.radius_T, some):
        raise problem


def _inaccuracy(errors: FloatArray, excess: float, intensity_T: float, field_T: FloatArray) -> Exception | None:
    """Return why the noise makes standard errors (12 K,) too large; refuse directions (N, 3) that do so.

    Noise in a plane passes for directions outside it, but not for enough of them.
    """
    names = open_parameters(excess * errors, intensity_T)
    if not names:
        return None
    if measure_coverage(field_T).relative_error > ENOUGH_RELATIVE_ERROR:
        refuse_open(excess * errors, intensity_T)
    # Residual over the noise from which no noise that is stated too small explains it: data sheets are within
    # twice.
    if excess > 10.0:
        return Refused(
            f"the residual is {excess:.3g} times the noise, which leaves {names} open, although the directions are "
            "enough: look for the cause with tam diagnose"
        )
    return InputError(
        f"the noise leaves {names} open, although the directions are enough: record longer, or check the noise that "
        "the array file states"
    )


def require_accurate(calibration: Calibration, recording: SampleSource, accept: Collection[str] = ()) -> Calibration:
    """Return a calibration none of whose standard errors is too large to be of use; accepted noise is a warning.

    The standard errors count for the residual that is left, where it exceeds the noise, but not for how long it lasts:
    what the directions determine is judged, and the accuracy is reported.

    Parameters
    ----------
    calibration : Calibration
        Of the recording.
    recording : SampleSource
        Raw readings of K sensors.
    accept : collection of str
        With "accuracy" the noise may leave parameters open.

    Raises
    ------
    InputError
        It names the parameters.
    Refused
        When noise alone would have left none open.
    """
    excess = 1.0
    # The standard errors of all other methods follow from what the fit leaves, not from the stated noise.
    if calibration.method == "maximum_likelihood":
        left = (calibration.reduced_chi_square.get(channel, 1.0) for channel in ("differential", "common_mode"))
        excess = float(np.sqrt(max(1.0, *left) / max(calibration.variance_factors)))
    field_T = field_of(recording.thinned(SKETCH), calibration.errors)
    problem = _inaccuracy(calibration.standard_errors.ravel(), excess, calibration.intensity_T, field_T)
    if problem is None:
        return calibration
    if "accuracy" not in accept:
        raise problem
    return replace(calibration, accepted=("accuracy",), warnings=(str(problem), *calibration.warnings))


def refuse_open(standard_errors: FloatArray, intensity_T: float) -> None:
    """Refuse standard errors that are too large to be of use, or unknown.

    Parameters
    ----------
    standard_errors : (12 K,) array
        Of the parameters in the order of ``SensorErrors.to_vector`` flattened, SI; infinite or NaN where unknown.
    intensity_T : float
        Intensity of the field, against which a bias is judged, tesla.

    Raises
    ------
    InputError
        It names the parameters.
    """
    if names := open_parameters(standard_errors, intensity_T):
        raise InputError(
            f"the readings do not determine {names}: "
            "turn the array through directions outside one plane or cone, up and down as well as around"
        )


def open_parameters(standard_errors: FloatArray, intensity_T: float) -> str:
    """Return the names of parameters whose standard errors, as of ``refuse_open``, are too large to be of use."""
    relative, angle = LARGEST_RELATIVE_ERROR, LARGEST_ANGLE_ERROR
    limits = np.array([relative] * 3 + [angle] * 3 + [relative * intensity_T] * 3 + [angle] * 3)
    return _name_open(~(standard_errors.reshape(-1, 12) <= limits))


def _name_open(open_: np.ndarray) -> str:
    """Return the names of the parameters, by sensor, that a mask (K, 12) selects."""
    groups: dict[tuple[int, ...], list[str]] = {}
    for parameter, name in enumerate(PARAMETER_NAMES):
        sensors = tuple(int(sensor) + 1 for sensor in np.flatnonzero(open_[:, parameter]))
        if sensors:
            groups.setdefault(sensors, []).append(name)
    parts = []
    for sensors, names in groups.items():
        whose = "every sensor" if len(sensors) == len(open_) > 1 else f"sensor {', '.join(map(str, sensors))}"
        parts.append(f"{', '.join(names)} of {whose}")
    return "; ".join(parts)


_WEAK_RELATIVE_ERROR = 5.0
"""Above this ratio to the full sphere's standard error a parameter is badly determined."""


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
        The worst of those above ``_WEAK_RELATIVE_ERROR``, worst first, with their sensors and ratios.
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

    Parameters
    ----------
    recording : Recording
        Raw readings, whose attitudes are judged.
    calibration : Calibration
        Made from them; its noise is the one that counts.
    """
    field_T = field_of(recording, calibration.errors)
    if recording.scalar_T is not None:
        field_T = field_T[np.isfinite(recording.scalar_T)]
    intensity_T = calibration.intensity_T
    model = InformationModel(calibration.errors, calibration.array, recording.scalar_T is not None, intensity_T)
    sphere = information_of(model.rows(intensity_T * cell_directions())) * (len(field_T) / CELLS)
    own, best = model.variances(information_of(model.rows(field_T))), model.variances(sphere)
    ratio = np.sqrt(np.divide(own, best, out=np.full_like(own, np.nan), where=best > 0)).reshape(-1, 12)
    parameters = _worst(ratio)
    return Weakness(ratio, parameters, _reason(field_T, intensity_T) if parameters else "")


def _worst(ratio: FloatArray) -> tuple[str, ...]:
    weak = ratio > _WEAK_RELATIVE_ERROR
    largest = np.where(weak, ratio, 0).max(axis=0)
    # The worst tell what to do.
    ordered = np.argsort(-largest)[: min(MOST_NAMED, int(weak.any(axis=0).sum()))]
    only = np.arange(len(PARAMETER_NAMES)) == ordered[:, None]
    times = [f"{ratio:.3g} ×" if np.isfinite(ratio) else "undetermined" for ratio in largest[ordered]]
    return tuple(f"{_name_open(weak & own)} {each}" for each, own in zip(times, only, strict=True))


def _reason(field_T: FloatArray, intensity_T: float) -> str:
    """Name the component of the field that varied least, or the direction that it never had."""
    axis: FloatArray = np.linalg.eigh(np.cov(field_T, rowvar=False))[1][:, 0]
    nearest = int(np.argmax(np.abs(axis)))
    axis = axis * np.sign(axis[nearest])
    along = field_T @ axis
    # 0.65 and 0.95: part of the sphere's diameter within which the field varied little along a direction, and the
    # cosine from which that is called by the name of an axis: within 18° of it.
    if np.ptp(along) > 0.65 * 2 * intensity_T:
        return f"The field never points {measure_coverage(field_T).missing} of the array: turn it so that it does."
    name = f"{'xyz'[nearest]} component" if axis[nearest] > 0.95 else f"component along {np.round(axis, 2).tolist()}"
    low, high, size = (f"{to_nanotesla(float(value)) / 1e3:.0f}" for value in (along.min(), along.max(), intensity_T))
    return (
        f"The field's {name} in the array frame only spans {low} to {high} of ±{size} µT: {_ADVICE[nearest]} further."
    ).replace("-", "−")
