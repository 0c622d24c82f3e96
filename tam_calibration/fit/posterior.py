"""The errors of the sensors that are most probable by what is known before and a recording together.

Gauss-Newton over the errors θ themselves, in which the prior is a parabola: the information of the data, that of the
rows [D Λ | o], is carried to them by the derivative of the rows, and that of the prior is added. What nothing tells is
held as plain fits hold it: the frame of sensor 1, and the mean determinant where no reference tells the scale.

Beside the errors there are unknowns that only some recordings have: the constant intensity where no scalar reads it,
and where attitude is data, how it is mounted and where the world's field points.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import whitening
from tam_calibration.core.variance_factors import WHITE, VarianceFactors
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.attitude_likelihood import AttitudeEquations, AttitudeLikelihood, WorldView
from tam_calibration.fit.gauss_newton import descend
from tam_calibration.fit.gyroscope_likelihood import GyroscopeEquations, GyroscopeLikelihood
from tam_calibration.fit.gyroscope_path import GyroscopePath, GyroscopeState, GyroscopeUse
from tam_calibration.fit.information import inverted, keeping, rows_by_unknowns
from tam_calibration.fit.likelihood import Likelihood, UniformLikelihood
from tam_calibration.fit.maximum_likelihood import first_guess, likelihood_of
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.scale import Normalized, free_scale, free_scale_gradient, normalize
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.geomagnetic_field import LOCAL_STANDARD_ERROR_T
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_MOST_SKEW = np.pi / 2
"""Non-orthogonality at which two axes of a sensor are one, radians."""

_LARGEST_SCALE = 1e3
"""Scale factor from which a sensor reads another unit: far beyond, gradients vanish, and steps settle anywhere."""

_SHORTER = 0.6
"""Length of the steps where whole ones do not settle: what is taken off the gradient has a slope that the information
does not hold, which is as large where a narrow turn tells little beside wide tolerances."""

_SEEN = 1e-13
"""Part of the largest eigenvalue of a scaled information below which a direction is open."""

_ANY_TURN = np.pi
"""Standard deviation of an angle of which nothing is known, radians: it keeps the normal equations regular."""


class Intensity(NamedTuple):
    """Intensity of a constant field, and its standard error, tesla."""

    value_T: float
    standard_error_T: float


@dataclass(frozen=True, eq=False)
class Known:
    """What is known before a recording.

    Parameters
    ----------
    prior : Prior, optional
        Of the errors of the sensors.
    main_field_T : (3,) array, optional
        The world's field where the recording was made, east, north, up, tesla: that of a model, with its error of
        ``LOCAL_STANDARD_ERROR_T`` in each component.
    variance_factors : VarianceFactors
        By how much what each channel of the readings tells varies more than by white noise of the stated size: see
        ``slow_residuals``.
    curvature : (Q, Q) array, optional
        Covariance of the score of this recording, over the unknowns, by what is no straight line over what stays
        uncertain; it widens the covariance, and does not move the errors.
    start : Calibration or Place, optional
        Where the iteration begins; by default at the prior, and without one at the closed form.
    uses_heading : bool
        Whether of a recorded attitude the heading counts beside roll and pitch.
    intensity : Intensity, optional
        Of the field, where no scalar reads it in the samples.
    gyroscope : GyroscopeUse, optional
        How a recorded angular velocity counts; None where it does not. It does not go with attitude as data.
    """

    prior: Prior | None = None
    main_field_T: FloatArray | None = None
    variance_factors: VarianceFactors = WHITE
    curvature: FloatArray | None = None
    start: "Calibration | Place | None" = None
    uses_heading: bool = True
    intensity: Intensity | None = None
    gyroscope: GyroscopeUse | None = None

    @property
    def intensities(self) -> tuple[Intensity, ...]:
        """What is known of the intensity, without any scalar reading in the samples."""
        of_model = self.main_field_T
        model = () if of_model is None else (Intensity(float(norm(of_model)), LOCAL_STANDARD_ERROR_T),)
        return model if self.intensity is None else (self.intensity, *model)

    @property
    def knows_frame(self) -> bool:
        """Whether the common frame of the sensors is known."""
        return self.prior is not None and self.prior.knows_frame

    @property
    def knows_scale(self) -> bool:
        """Whether the absolute scale is known without a scalar reference."""
        return bool(self.intensities) or (self.prior is not None and self.prior.knows_scale)


@dataclass(frozen=True, eq=False)
class Posterior:
    """What all of it tells together.

    Parameters
    ----------
    errors : SensorErrors
        The most probable ones.
    covariance : (12 K, 12 K) array
        Of the flattened errors, SI; zero for what is held.
    intensity_T : float
        Of the field: fitted where no scalar reference tells it; else that of the start, tesla.
    view : WorldView, optional
        Mounting of the attitude and direction of the world's field, where attitude is data.
    mount : (3, 3) array, optional
        X: rotation from the frame of the sensors to the one whose attitude or angular velocity is data.
    with_mount : (12 K + 3, 12 K + 3) array, optional
        Covariance of the errors and of the turn of X, radians.
    """

    errors: SensorErrors
    covariance: FloatArray
    intensity_T: float
    view: WorldView | None = None
    mount: FloatArray | None = None
    with_mount: FloatArray | None = None


def posterior_of(recording: SampleSource, array: KnownNoiseArray, known: Known | Prior) -> Posterior:
    """Return what is known of the errors of an array's sensors after a recording in a uniform field.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors; without any scalar reading the intensity is an unknown constant. Attitude counts
        where the array states its standard deviation.
    array : KnownNoiseArray
        With every noise.
    known : Known or Prior
        What is known before.

    Raises
    ------
    InputError
        When nothing is known before, and the readings determine no ellipsoid to start from.
    Refused
        When the iteration does not settle, or leads to sensors that cannot be.
    """
    problem = Problem.of(recording, array, known if isinstance(known, Known) else Known(known))
    end, kept = problem.most_probable()
    if problem.known.curvature is not None:
        kept = problem.information_beside(problem.known.curvature, end), problem.basis_at(end)
    covariance, size = inverted(*kept), 12 * array.sensor_count
    told = Posterior(end.errors, covariance[:size, :size], end.intensity_T, end.view)
    if end.view is not None:
        mount, first, sign = end.view.mount, len(covariance) - 5, 1.0
    elif end.gyroscope is not None:
        mount, first, sign = end.gyroscope.mount.T, len(covariance) - 9, -1.0
    else:
        return told
    chosen, signs = np.r_[:size, first : first + 3], np.append(np.ones(size), np.full(3, sign))
    return replace(told, mount=mount, with_mount=covariance[np.ix_(chosen, chosen)] * np.outer(signs, signs))


def can_be(vector: FloatArray) -> bool:
    """Return whether sensors can have such errors.

    Parameters
    ----------
    vector : (K, 12) array
        In the order of ``SensorErrors.to_vector``.
    """
    scale_factor, skew = vector[:, :3], np.abs(vector[:, 3:6])
    return bool(((scale_factor > 0) & (scale_factor < _LARGEST_SCALE)).all() and (skew <= _MOST_SKEW).all())


class Place(NamedTuple):
    """Errors, the intensity where no scalar reads it, tesla, and the view of the world where attitude is data.

    Where angular velocity is data, the state of the gyroscope too.
    """

    errors: SensorErrors
    intensity_T: float
    view: WorldView | None = None
    gyroscope: GyroscopeState | None = None


@dataclass(frozen=True, eq=False)
class Problem:
    """The likelihood of a recording over the unknowns: errors, intensity over its unit, step of view or gyroscope."""

    known: Known
    start_errors: SensorErrors
    unit_T: float
    likelihood: Likelihood | UniformLikelihood
    has_scalar: bool
    attitude: AttitudeLikelihood | None
    mounting_error: float | None
    gyroscope: GyroscopeLikelihood | None = None

    @classmethod
    def of(
        cls, recording: SampleSource, array: KnownNoiseArray, known: Known | Prior, has_scalar: bool | None = None
    ) -> "Problem":
        """Return that of a recording, its readings taken about the biases of the start.

        Of a part of a recording ``has_scalar`` says whether the whole has a scalar.
        """
        has_scalar = recording.scalar_count is not None if has_scalar is None else has_scalar
        known = known if isinstance(known, Known) else Known(known)
        begun = known.start or (None if known.prior is None else known.prior.calibration)
        if begun is None:
            start, unit_T = first_guess(recording, array), normalize(recording).radius_T
        else:
            start, unit_T = begun.errors, begun.intensity_T
        data = Normalized(recording, start.bias_T, unit_T, has_scalar)
        likelihood = likelihood_of(recording, array, data)
        attitude = _attitude_of(data, array, known.uses_heading)
        return cls(
            known,
            start,
            unit_T,
            likelihood,
            has_scalar,
            attitude,
            array.mounting_error if known.knows_frame else None,
            None if known.gyroscope is None else _gyroscope_of(data, array, known.gyroscope),
        )

    @cached_property
    def start(self) -> "Place":
        """Where the iteration begins."""
        errors = self.start_errors
        view = None
        if self.attitude is not None:
            view = self.attitude.view(errors.matrix, np.zeros_like(errors.bias_T))
        state = None
        if self.gyroscope is not None and (use := self.known.gyroscope):
            state = use.start.of_modes(self.gyroscope.path.modes)
        return Place(errors, self.unit_T, view, state)

    def most_probable(self) -> tuple[Place, tuple[FloatArray, FloatArray]]:
        """Return the most probable place, and what ``settled`` returns beside it."""
        if isinstance(self.known.start, Place):
            with suppress(Refused):
                return self.settled(self.start, is_corrected=True)
        end, kept = self.settled(self.start, is_corrected=False)
        # Noise that is stated larger than it is, in a turn that tells little more than the prior, has no such place.
        for length in (1.0, _SHORTER):
            with suppress(Refused):
                return self.settled(end, is_corrected=True, length=length)
        return end, kept

    def settled(
        self, start: Place, is_corrected: bool, length: float = 1.0
    ) -> tuple[Place, tuple[FloatArray, FloatArray]]:
        """Return where Gauss-Newton steps settle, and the information and the free directions a last step before.

        Parameters
        ----------
        start : Place
            Where to begin.
        is_corrected : bool
            Whether the mean that noise makes of the gradient is taken off it.
        length : float
            Of each step, over that of Gauss-Newton.

        Raises
        ------
        Refused
            When the iteration does not settle, or leads to sensors that cannot be.
        """

        def normal_at(place: Place) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
            information, gradient = self.data_at(place, is_corrected)
            self.add_known(place, information, gradient)
            basis = self.basis_at(place)
            return basis.T @ information @ basis, basis.T @ gradient, (information, basis)

        return descend(normal_at, lambda place, step: self.moved(place, length * self.basis_at(place) @ step), start)

    def data_at(self, place: Place, is_corrected: bool = True) -> tuple[FloatArray, FloatArray]:
        """Return the information of the data over the unknowns at a place, and their downhill gradient."""
        matrix, bias = self.rows_at(place)
        here = self.likelihood.linearize(matrix, bias).weighed(self.known.variance_factors)
        rows = rows_by_unknowns(place.errors, self.unit_T, None if self.has_scalar else place.intensity_T)
        downhill = here.gradient if is_corrected else here.gradient + here.correction
        information, gradient = rows.T @ here.information @ rows, rows.T @ downhill
        if self.gyroscope is not None:
            return self._with(self.gyroscope_at(place), information, gradient)
        if self.attitude is None or place.view is None:
            return information, gradient
        return self._with(self.attitude_at(place), information, gradient)

    @staticmethod
    def _with(
        more: AttitudeEquations | GyroscopeEquations, information: FloatArray, gradient: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return normal equations of the first unknowns with those of all, whose arrays are used up."""
        count = len(gradient)
        more.information[:count, :count] += information
        more.gradient[:count] += gradient
        return more.information, more.gradient

    def gyroscope_at(self, place: Place, samples: slice = slice(None)) -> GyroscopeEquations:
        """Return the normal equations of the angular velocity at a place, over the unknowns."""
        assert self.gyroscope is not None and place.gyroscope is not None
        found = self.gyroscope.part(samples).linearize(*self.rows_at(place), place.gyroscope)
        information, gradient = self._by_unknowns(place, found)
        return found._replace(information=information, gradient=gradient)

    def gyroscope_information(self, place: Place) -> tuple[FloatArray, FloatArray]:
        """Return information and gradient of the errors by the angular velocity, its own unknowns eliminated."""
        assert place.gyroscope is not None and self.known.gyroscope is not None
        found = self.gyroscope_at(place)
        count, own = 12 * place.errors.sensor_count, slice(-place.gyroscope.size, None)
        precisions, downhill = self._known_of_gyroscope(place.gyroscope)
        free = self.known.gyroscope.is_free(place.gyroscope)
        inner = (found.information[own, own] + np.diag(precisions))[np.ix_(free, free)]
        across = found.information[:count, own][:, free]
        gain = across @ inverted(inner, np.eye(len(inner)))
        gradient = found.gradient[:count] - gain @ (found.gradient[own] + downhill)[free]
        return found.information[:count, :count] - gain @ across.T, gradient

    def _by_unknowns(
        self, place: Place, found: AttitudeEquations | GyroscopeEquations
    ) -> tuple[FloatArray, FloatArray]:
        """Return information and gradient over the unknowns, of those over the rows and the unknowns that follow."""
        rows = rows_by_unknowns(place.errors, self.unit_T, None if self.has_scalar else place.intensity_T)
        more = len(found.gradient) - len(rows)
        extended = np.zeros((len(found.gradient), rows.shape[1] + more))
        extended[: len(rows), : rows.shape[1]] = rows
        extended[len(rows) :, rows.shape[1] :] = np.eye(more)
        return extended.T @ found.information @ extended, extended.T @ found.gradient

    def attitude_at(
        self, place: Place, samples: slice = slice(None), headings: FloatArray | None = None
    ) -> AttitudeEquations:
        """Return the normal equations of attitude at a place, over the unknowns and ``headings`` of ``linearize``."""
        assert self.attitude is not None and place.view is not None
        found = self.attitude.part(samples).linearize(*self.rows_at(place), place.view, headings)
        information, gradient = self._by_unknowns(place, found)
        return found._replace(information=information, gradient=gradient)

    def information_beside(self, curvature: FloatArray, place: Place) -> FloatArray:
        """Return the information at a place of what is known, and of data whose score varies by curvature besides."""
        information, gradient = self.data_at(place)
        # Of an attitude's mounting and the world's direction, which come last, lengths tell nothing.
        curvature = np.pad(curvature, (0, len(information) - len(curvature)))
        white = information @ whitening(information + curvature, _SEEN)
        information = white @ white.T
        self.add_known(place, information, gradient)
        return information

    def add_known(self, place: Place, information: FloatArray, gradient: FloatArray) -> None:
        """Add to normal equations what is known before."""
        size = 12 * place.errors.sensor_count
        if self.known.prior is not None:
            terms = self.known.prior.terms(place.errors)
            information[:size, :size] += terms.information
            gradient[:size] += terms.gradient
        for intensity in () if self.has_scalar else self.known.intensities:
            precision = (self.unit_T / intensity.standard_error_T) ** 2
            information[size, size] += precision
            gradient[size] += precision * (intensity.value_T - place.intensity_T) / self.unit_T
        if place.view is not None:
            self._add_known_view(place.view, information[-5:, -5:], gradient[-5:])
        if place.gyroscope is not None:
            precisions, downhill = self._known_of_gyroscope(place.gyroscope)
            own = slice(-place.gyroscope.size, None)
            information[own, own] += np.diag(precisions)
            gradient[own] += downhill

    def _known_of_gyroscope(self, state: GyroscopeState) -> tuple[FloatArray, FloatArray]:
        """Return the precisions of the gyroscope's unknowns before the recording, and the downhill gradient."""
        from scipy.spatial.transform import Rotation

        assert self.known.gyroscope is not None
        precisions, downhill = self.known.gyroscope.prior(state)
        if self.mounting_error is not None:
            precisions[-9:-6] += (own := 1 / max(self.mounting_error, _LEAST_ANGLE) ** 2)
            downhill[-9:-6] -= own * Rotation.from_matrix(state.mount).as_rotvec()
        return precisions, downhill

    def _add_known_view(self, view: WorldView, information: FloatArray, gradient: FloatArray) -> None:
        from scipy.spatial.transform import Rotation

        information += np.eye(5) / _ANY_TURN**2
        if self.mounting_error is not None:
            precision = 1 / max(self.mounting_error, _LEAST_ANGLE) ** 2
            information[:3, :3] += precision * np.eye(3)
            gradient[:3] -= precision * Rotation.from_matrix(view.mount).as_rotvec()
        if self.known.main_field_T is not None:
            length = float(norm(self.known.main_field_T))
            precision = (length / LOCAL_STANDARD_ERROR_T) ** 2
            information[3:, 3:] += precision * np.eye(2)
            gradient[3:] += precision * view.across.T @ self.known.main_field_T / length

    def basis_at(self, place: Place) -> FloatArray:
        """Return the directions of the unknowns that are free, as columns."""
        size = 12 * place.errors.sensor_count + (not self.has_scalar) + (0 if place.view is None else 5)
        free = np.ones(size, dtype=bool)
        free[9:12] = self.known.knows_frame
        if place.gyroscope is not None and (use := self.known.gyroscope):
            free = np.append(free, use.is_free(place.gyroscope))
            size = len(free)
        if self.has_scalar or self.known.knows_scale:
            return np.eye(size)[:, free]
        gradient = np.zeros(size)
        gradient[: 12 * place.errors.sensor_count] = free_scale_gradient(place.errors)
        return keeping(gradient, free)

    def moved(self, place: Place, step: FloatArray) -> Place:
        """Return the place after a step of the unknowns; one that leads to sensors that cannot be is refused."""
        errors, count = place.errors, place.errors.sensor_count
        vector = errors.to_vector() + step[: 12 * count].reshape(count, 12)
        intensity_T = place.intensity_T + (0.0 if self.has_scalar else self.unit_T * float(step[12 * count]))
        if not can_be(vector) or intensity_T <= 0:
            prior = self.known.prior
            mend = (
                "take its last calibration for a prior"
                if prior is None or prior.rates is None
                else "leave out spoilt samples"
            )
            raise Refused(
                "the readings, with what else is known, determine no calibration: the fit leads to sensors that "
                f"cannot be; turn the array further, or {mend}"
            )
        errors = SensorErrors.from_vector(vector, errors.orientation)
        view = None if place.view is None else place.view.moved(step[-5:])
        state = None if place.gyroscope is None else place.gyroscope.moved(step[-place.gyroscope.size :])
        if not self.has_scalar and not self.known.knows_scale:
            scale = float(free_scale(errors.matrix))
            errors, intensity_T = replace(errors, scale_factor=scale * errors.scale_factor), intensity_T / scale
        return Place(errors, intensity_T, view, state)

    def rows_at(self, place: Place) -> tuple[FloatArray, FloatArray]:
        """Return the matrices times the intensity over its unit, and the biases about those of the start."""
        factor = place.intensity_T / self.unit_T
        return factor * place.errors.matrix, (place.errors.bias_T - self.start_errors.bias_T) / self.unit_T


_LEAST_ANGLE = 1e-8
"""Of a mounting that is stated to be exact, radians."""


def _gyroscope_of(data: Normalized, array: KnownNoiseArray, use: GyroscopeUse) -> GyroscopeLikelihood | None:
    """Return the samples as data of the turn between them; None where they have no angular velocity."""
    recording = data.source.whole()
    if recording.angular_velocity_rad_s is None:
        return None
    path = GyroscopePath(
        recording.time_s,
        recording.angular_velocity_rad_s,
        use.interval_s,
        recording.time_span_s,
        use.start.delay_s,
        use.stride,
    )
    if not len(path.links):
        return None
    rows = data.points.reshape(recording.sample_count, -1).T
    return GyroscopeLikelihood.of(rows, path, array.vector_noise_T / data.radius_T, use.density, use.lasting)


def _attitude_of(data: Normalized, array: KnownNoiseArray, uses_heading: bool) -> AttitudeLikelihood | None:
    """Return the samples with attitude, where the array states how good that is."""
    if array.attitude_noise is None:
        return None
    recording = data.source.whole()
    if recording.attitude is None:
        return None
    from scipy.spatial.transform import Rotation

    known = np.flatnonzero(np.isfinite(recording.attitude).all(axis=1))
    rows = data.points[known].reshape(len(known), -1).T
    to_world = Rotation.from_quat(recording.attitude[known]).as_matrix()
    return AttitudeLikelihood(rows, to_world, array.vector_noise_T / data.radius_T, array.attitude_noise, uses_heading)
