"""The errors of the sensors that are most probable by what is known before and a recording together.

Gauss-Newton over the errors θ themselves, in which the prior is a parabola: the information of the data, that of the
rows [D Λ | o], is carried to them by the derivative of the rows, and that of the prior is added. What nothing tells is
held as plain fits hold it: the frame of sensor 1, and the mean determinant where no reference tells the scale.

Some recordings have further unknowns: the constant intensity where no scalar reads it,
and where attitude is data, how it is mounted and where the world's field points.

Attitude and angular velocity are terms of the likelihood with unknowns of their own (``Motion``). A ``Posterior`` has
the most probable errors and their covariance.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Normal, whitening
from tam_calibration.core.noise import WHITE, VarianceFactors
from tam_calibration.correction.acceptance import are_possible
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.ellipsoid import Normalized, free_scale, normalize, principal_form
from tam_calibration.fit.estimate import student_noises
from tam_calibration.fit.gyroscope_likelihood import GyroscopeLikelihood
from tam_calibration.fit.gyroscope_path import GyroscopeState, GyroscopeUse
from tam_calibration.fit.information import descend, free_basis, inverted, rows_by_unknowns
from tam_calibration.fit.likelihood import Likelihood, likelihood_of
from tam_calibration.fit.moments import into_frame_of_first
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.recorded_attitude import AttitudeLikelihood, WorldView
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.geomagnetic_field import LOCAL_STANDARD_ERROR_T
from tam_calibration.model.recording import SKETCH, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

MotionState = WorldView | GyroscopeState
"""The unknowns of the motion at a point."""


class Motion(Protocol):
    """Samples whose motion was recorded; a state is one of its own kind."""

    @property
    def sample_count(self) -> int:
        """Number of samples."""

    def part(self, samples: slice) -> Self:
        """Return some of the samples."""

    def start(self, matrix: FloatArray, bias: FloatArray) -> MotionState:
        """Return the state at which a fit begins with such sensors."""

    def linearize(self, matrix: FloatArray, bias: FloatArray, state: Any) -> Normal:
        """Return the normal equations over the rows [D Λ | o] of the sensors and the unknowns of the state."""

    def scatter(self, matrix: FloatArray, bias: FloatArray, state: Any, taken: float = 0.0) -> float:
        """Return the noise of the motion that the residuals show, so many channels being taken by the fit."""

    def prior(self, state: Any, main_field_T: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Return the precisions of the unknowns before the samples, 0 for what is held, and the downhill gradient."""


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
        ``estimate``.
    curvature : (Q, Q) array, optional
        Covariance of the score of this recording, over the unknowns, by what is no straight line over what stays
        uncertain; it widens the covariance, and does not move the errors.
    start : Calibration or Place, optional
        Where the iteration begins; by default at the prior, and without one at the closed form.
    uses_heading : bool
        Whether of a recorded attitude the heading counts in addition to roll and pitch.
    intensity : Intensity, optional
        Of the field, where no scalar reads it in the samples.
    gyroscope : GyroscopeUse, optional
        How a recorded angular velocity counts; None where it does not. It does not go with attitude as data.
    is_robust : bool
        Whether the noise is taken for Student-t with six degrees of freedom, so that outliers count little.
    """

    prior: Prior | None = None
    main_field_T: FloatArray | None = None
    variance_factors: VarianceFactors = WHITE
    curvature: FloatArray | None = None
    start: "Calibration | Place | None" = None
    uses_heading: bool = True
    intensity: Intensity | None = None
    gyroscope: GyroscopeUse | None = None
    is_robust: bool = False

    @property
    def given(self) -> Prior:
        """The prior, where there must be one."""
        assert self.prior is not None
        return self.prior

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


class Place(NamedTuple):
    """Errors, the intensity where no scalar reads it, tesla, and what is unknown of attitude or gyroscope as data."""

    errors: SensorErrors
    intensity_T: float
    motion: MotionState | None = None


def closed_form(data: Normalized, vector_noise: FloatArray, scalar_noise: float) -> tuple[FloatArray, FloatArray]:
    """Return what ``principal_form`` tells of some samples in the frame of sensor 1: where the iteration starts.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    """
    some = data if data.source.sample_count <= SKETCH else replace(data, source=data.source.thinned(SKETCH))
    matrix, bias = principal_form(some, vector_noise, scalar_noise)
    return into_frame_of_first(matrix[None])[0], bias


@dataclass(frozen=True, eq=False)
class Problem:
    """The likelihood of a recording over the unknowns: errors, intensity over its unit, step of view or gyroscope."""

    known: Known
    start_errors: SensorErrors
    start_intensity_T: float
    likelihood: Likelihood
    has_scalar: bool
    mounting_error: float | None
    motion: Motion | None = None

    @classmethod
    def of(
        cls, recording: SampleSource, array: KnownNoiseArray, known: Known, has_scalar: bool | None = None
    ) -> "Problem":
        """Return that of a recording.

        Of a part of a recording ``has_scalar`` says whether the whole has a scalar.
        """
        has_scalar = recording.scalar_count is not None if has_scalar is None else has_scalar
        begun = known.start or (None if known.prior is None else known.prior.calibration)
        if begun is None:
            data = normalize(recording)
            start, factor = data.errors_at(*closed_form(data, *data.noise_of(array)))
            intensity_T = data.radius_T / factor
        else:
            start, intensity_T = begun.errors, begun.intensity_T
            data = Normalized(recording, start.bias_T, intensity_T, has_scalar)
        motion: Motion | None
        if known.gyroscope is None:
            motion = AttitudeLikelihood.of(data, array, known.uses_heading)
        else:
            motion = GyroscopeLikelihood.of(data, array, known.gyroscope)
        mounting_error = array.mounting_error if known.knows_frame else None
        likelihood = likelihood_of(recording, array, data, may_interpolate=not known.is_robust)
        return cls(known, start, intensity_T, likelihood, has_scalar, mounting_error, motion)

    @cached_property
    def start(self) -> "Place":
        """Where the iteration begins."""
        place = Place(self.start_errors, self.start_intensity_T)
        return place if self.motion is None else place._replace(motion=self.motion.start(*self.rows_at(place)))

    @property
    def unit_T(self) -> float:
        """Field that counts as one, tesla."""
        return self.likelihood.data.radius_T

    def most_probable(self) -> tuple[Place, tuple[FloatArray, FloatArray]]:
        """Return the most probable place, and what else ``settled`` returns."""
        is_near = isinstance(self.known.start, Place) or (self.known.prior is None and self.motion is None)
        if is_near:
            with suppress(Refused):
                return self.settled(self.start, is_corrected=True)
        end, kept = self.settled(self.start, is_corrected=False)
        # Noise that is stated larger than it is, in a turn that tells little more than the prior, has no such place.
        # Length of the steps where whole ones do not settle: what is taken off the gradient has a slope that the
        # information does not hold, which is as large where a narrow turn contains little compared with wide
        # tolerances.
        for length in (1.0, 0.6):
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
            found, basis = self.normal_at(place, is_corrected), self.basis_at(place)
            information = found.information
            return basis.T @ information @ basis, basis.T @ found.score, (information, basis)

        def moved(place: Place, step: FloatArray) -> Place:
            return self.moved(place, length * self.basis_at(place) @ step)

        return descend(normal_at, moved, start, self.known.is_robust)

    def normal_at(self, place: Place, is_corrected: bool = True) -> Normal:
        """Return the normal equations over the unknowns at a place, by the data and by what is known before."""
        return self.data_at(place, is_corrected) + self.known_at(place)

    def data_at(self, place: Place, is_corrected: bool = True) -> Normal:
        """Return the normal equations of the data over the unknowns at a place."""
        rows, weights = self.rows_at(place), None
        if self.known.is_robust:
            weights = np.array([noise.weights / noise.square for noise in student_noises(self.likelihood, *rows)])
        here = self.likelihood.linearize(*rows, weights).weighed(self.known.variance_factors)
        both = here.both if is_corrected else replace(here.both, score=here.both.score + here.correction)
        found = both.by(self._rows_by_unknowns(place))
        if self.motion is None or place.motion is None:
            return found
        return found.padded(self._size(place)) + self.motion_at(place)

    def _size(self, place: Place) -> int:
        """Return the number of unknowns."""
        motion = 0 if place.motion is None else place.motion.size
        return 12 * place.errors.sensor_count + (not self.has_scalar) + motion

    def _rows_by_unknowns(self, place: Place) -> FloatArray:
        return rows_by_unknowns(place.errors, self.unit_T, None if self.has_scalar else place.intensity_T)

    def motion_at(self, place: Place, samples: slice = slice(None)) -> Normal:
        """Return the normal equations of attitude or angular velocity at a place, over the unknowns.

        Errors of the heading that an attitude may have follow them.
        """
        from scipy.linalg import block_diag

        assert self.motion is not None and place.motion is not None
        # A part of all would lose what the motion has calculated of them before.
        motion = self.motion if samples == slice(None) else self.motion.part(samples)
        found = motion.linearize(*self.rows_at(place), place.motion)
        rows = self._rows_by_unknowns(place)
        return found.by(block_diag(rows, np.eye(len(found.score) - len(rows))))

    def errors_by_motion(self, place: Place) -> Normal:
        """Return the normal equations of the errors by attitude or angular velocity, other unknowns eliminated."""
        assert self.motion is not None and place.motion is not None
        found = self.motion_at(place)
        count, own = 12 * place.errors.sensor_count, slice(-place.motion.size, None)
        precisions, downhill = self._known_of_motion(place.motion)
        free = precisions > 0
        inner = (found.information[own, own] + np.diag(precisions))[np.ix_(free, free)]
        across = found.information[:count, own][:, free]
        gain = across @ inverted(inner, np.eye(len(inner)))
        score = found.score[:count] - gain @ (found.score[own] + downhill)[free]
        return replace(found, information=found.information[:count, :count] - gain @ across.T, score=score)

    def robust_information(self, place: Place) -> FloatArray:
        """Return the information of samples with outliers: the inverse of the sandwich of their weighted scores."""
        student = student_noises(self.likelihood, *self.rows_at(place))
        # The residuals are smaller than the noise by what the errors have taken of it.
        channels = sum(float(noise.channels.sum()) for noise in student)
        kept = max(channels - 12 * place.errors.sensor_count, 1.0) / channels
        factors = VarianceFactors(*(noise.variance_factor / kept for noise in student))
        white = replace(self.known, variance_factors=factors, is_robust=False)
        return replace(self, known=white).normal_at(place).information

    def information_with(self, curvature: FloatArray, place: Place) -> FloatArray:
        """Return the information at a place of what is known, and of data whose score varies by curvature too."""
        information = self.data_at(place).information
        # Of an attitude's mounting and the world's direction, which come last, lengths tell nothing.
        curvature = np.pad(curvature, (0, len(information) - len(curvature)))
        # Part of the largest eigenvalue of a scaled information below which a direction is open.
        white = information @ whitening(information + curvature, 1e-13)
        return white @ white.T + self.known_at(place).information

    def known_at(self, place: Place) -> Normal:
        """Return the normal equations of what is known before."""
        total, size = self._size(place), 12 * place.errors.sensor_count
        known = Normal.none(total)
        if self.known.prior is not None:
            known += self.known.prior.terms(place.errors).padded(total)
        for intensity in () if self.has_scalar else self.known.intensities:
            precision = (self.unit_T / intensity.standard_error_T) ** 2
            known.information[size, size] += precision
            known.score[size] += precision * (intensity.value_T - place.intensity_T) / self.unit_T
        if place.motion is not None:
            precisions, downhill = self._known_of_motion(place.motion)
            own = slice(-place.motion.size, None)
            known.information[own, own] += np.diag(precisions)
            known.score[own] += downhill
        return known

    def _known_of_motion(self, state: MotionState) -> tuple[FloatArray, FloatArray]:
        """Return the precisions of the unknowns of attitude or gyroscope before the samples, and their gradient."""
        from scipy.spatial.transform import Rotation

        assert self.motion is not None
        precisions, downhill = self.motion.prior(state, self.known.main_field_T)
        if self.mounting_error is not None:
            # Of a mounting that is stated to be exact, radians.
            precisions[state.turn] += (own := 1 / max(self.mounting_error, 1e-8) ** 2)
            downhill[state.turn] -= own * Rotation.from_matrix(state.mount).as_rotvec()
        return precisions, downhill

    def basis_at(self, place: Place) -> FloatArray:
        """Return the directions of the unknowns that are free, as columns."""
        free = np.ones(12 * place.errors.sensor_count + (not self.has_scalar), dtype=bool)
        free[9:12] = self.known.knows_frame
        if place.motion is not None:
            free = np.append(free, self._known_of_motion(place.motion)[0] > 0)
        return free_basis(place.errors, free, holds_scale=not (self.has_scalar or self.known.knows_scale))

    def moved(self, place: Place, step: FloatArray) -> Place:
        """Return the place after a step of the unknowns; one that leads to sensors that cannot be is refused."""
        errors, count = place.errors, place.errors.sensor_count
        vector = errors.to_vector() + step[: 12 * count].reshape(count, 12)
        intensity_T = place.intensity_T + (0.0 if self.has_scalar else self.unit_T * float(step[12 * count]))
        if not are_possible(vector) or intensity_T <= 0:
            prior = self.known.prior
            is_new = prior is None or prior.rates is None
            remedy = "take its last calibration for a prior" if is_new else "leave out spoilt samples"
            raise Refused(
                "the readings, with what else is known, determine no calibration: the fit leads to sensors that "
                f"cannot be; turn the array further, or {remedy}"
            )
        errors = SensorErrors.from_vector(vector, errors.orientation)
        motion = None if place.motion is None else place.motion.moved(step[-place.motion.size :])
        if not self.has_scalar and not self.known.knows_scale:
            scale = float(free_scale(errors.matrix))
            errors, intensity_T = replace(errors, scale_factor=scale * errors.scale_factor), intensity_T / scale
        return Place(errors, intensity_T, motion)

    def rows_at(self, place: Place) -> tuple[FloatArray, FloatArray]:
        """Return the matrices times the intensity over its unit, and the biases about the origin of the data."""
        factor = place.intensity_T / self.unit_T
        return factor * place.errors.matrix, (place.errors.bias_T - self.likelihood.data.origin_T) / self.unit_T


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
    motion : MotionState, optional
        What else was fitted where attitude or angular velocity is data.
    with_mount : (12 K + 3, 12 K + 3) array, optional
        Covariance of the errors and of the turn of the rotation that ``motion.mounting`` has, radians.
    """

    errors: SensorErrors
    covariance: FloatArray
    intensity_T: float
    motion: MotionState | None = None
    with_mount: FloatArray | None = None


def posterior_of(recording: SampleSource, array: KnownNoiseArray, known: Known) -> Posterior:
    """Return what is known of the errors of an array's sensors after a recording in a uniform field.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors; without any scalar reading the intensity is an unknown constant. Attitude counts
        where the array states its standard deviation.
    array : KnownNoiseArray
        With every noise.
    known : Known
        What is known before.

    Raises
    ------
    InputError
        When nothing is known before, and the readings determine no ellipsoid to start from.
    Refused
        When the iteration does not settle, or leads to sensors that cannot be.
    """
    problem = Problem.of(recording, array, known)
    end, kept = problem.most_probable()
    if known.is_robust:
        kept = problem.robust_information(end), problem.basis_at(end)
    if known.curvature is not None:
        kept = problem.information_with(known.curvature, end), problem.basis_at(end)
    covariance, size = inverted(*kept), 12 * array.sensor_count
    found = Posterior(end.errors, covariance[:size, :size], end.intensity_T, end.motion)
    if end.motion is None:
        return found
    chosen = np.r_[:size, len(covariance) - end.motion.size + np.arange(end.motion.size)[end.motion.turn]]
    signs = np.append(np.ones(size), np.full(3, end.motion.mounting[1]))
    return replace(found, with_mount=covariance[np.ix_(chosen, chosen)] * np.outer(signs, signs))
