"""A calibration that goes on with every block of samples, in bounded memory, and forgets as its sensors change.

Since a stretch began the samples are kept as moments, from which prior and samples are solved anew with every block:
without any change of the sensors that is the fit of prior and all samples, to the last. Sensors change as random walks.
When what the walk may have moved is no longer small compared with the uncertainty, a new stretch begins: its prior is
the estimate, less certain by the walk, as in Kalman's filter.

The likelihood follows from sums alone: moments of the readings up to fourth order. The differential channels are
bilinear in readings and parameters, so that the second moments of the readings serve them at every point. Of the common
mode the length of the field is not; but its residual |b| - s is (|b|² - s²) / 2s but for a part e / 2s of itself, and
|b|² is a polynomial of second degree in the field that the sensors agree on. Fourth moments of that field therefore
serve every point too. With C the covariance of b and σ the noise of s, what is taken off |b|² is tr C + 3 σ², after
which the score (b / s) ⊗ [b, 1] (|b|² - s²) / 2s is in the mean, to second order, C S + S C for the b and C t for the
1; S and t are the means of u uᵀ and u / |b|. That is taken off too, as in ``likelihood``.

What was learned, tried on samples after it before it is published: one that predicts worse never is.

A gyroscope adds the turns of two minutes at a time. They are judged as those of a recording (``fit/gyroscope_check``),
with what was known before as prior. Bias, mounting and delay of the gyroscope are unknown each time and eliminated, so
that they may change from one time to the next.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.linalg import inv

from tam_calibration.core.interpolation import AveragedRates
from tam_calibration.core.least_squares import Elimination, Normal, gram
from tam_calibration.core.noise import WHITE, VarianceFactors
from tam_calibration.correction.acceptance import are_possible
from tam_calibration.fit.gyroscope_check import judge_gyroscope
from tam_calibration.fit.information import descend, inverted, rows_by_unknowns
from tam_calibration.fit.likelihood import ChannelMaps, CommonModeSums, Linearization, normal_equations
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.problem import Known, Problem
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class SampleMoments:
    """Sums over samples; those of two sets of samples are the sums of both.

    Parameters
    ----------
    second : (3K + 1, 3K + 1) array
        Outer products of the readings of all sensors, and 1.
    fourth : (17, 17) array
        Weighted outer products of [b, 1] ⊗ [b, 1] and the square of the intensity; b is the field.
    count, scalar_count : int
        Number of samples, and of those with an intensity.
    """

    second: FloatArray
    fourth: FloatArray
    count: int
    scalar_count: int

    @classmethod
    def none(cls, sensor_count: int) -> "SampleMoments":
        """Return the moments of no sample."""
        return cls(np.zeros((3 * sensor_count + 1, 3 * sensor_count + 1)), np.zeros((17, 17)), 0, 0)

    def __add__(self, other: "SampleMoments") -> "SampleMoments":
        """Return the moments of both sets of samples."""
        return SampleMoments(
            self.second + other.second,
            self.fourth + other.fourth,
            self.count + other.count,
            self.scalar_count + other.scalar_count,
        )


@dataclass(frozen=True, eq=False)
class MomentLikelihood:
    """What makes moments of samples, and of moments the normal equations of the errors of the sensors.

    Parameters
    ----------
    origin : SensorErrors
        Near the truth: the field that the sensors agree on, and with it the weights of the intensities, are worked out
        with these errors.
    array : KnownNoiseArray
        With every noise.
    unit_T : float
        About the intensity of the field, tesla.
    factors : VarianceFactors
        By how much what the samples tell varies more than by white noise of that size.
    """

    origin: SensorErrors
    array: KnownNoiseArray
    unit_T: float
    factors: VarianceFactors = WHITE

    def moments(self, readings_T: FloatArray, scalar_T: FloatArray) -> SampleMoments:
        """Return the moments of samples.

        Parameters
        ----------
        readings_T : (N, K, 3) array
            Raw readings, tesla.
        scalar_T : (N,) array
            Reference intensity, tesla; NaN where there is none.
        """
        points = ((readings_T - self.origin.bias_T) / self.unit_T).reshape(len(readings_T), -1).T
        rows = np.concatenate([points, np.ones((1, len(readings_T)))])
        known = np.isfinite(scalar_T)
        field, intensity = self._elimination.unmixing @ points[:, known], scalar_T[known] / self.unit_T
        variance = self._scalar_noise**2 + self._elimination.variance_along(field / intensity)
        beyond = np.trace(self._elimination.covariance) + 3 * self._scalar_noise**2
        extended = np.concatenate([field, np.ones((1, len(intensity)))])
        columns = np.empty((17, len(intensity)))
        np.multiply(extended[:, None], extended[None], out=columns[:-1].reshape(4, 4, -1))
        columns[-1] = intensity**2 + beyond
        columns /= intensity * np.sqrt(variance)
        return SampleMoments(gram(rows), gram(columns), len(readings_T), int(known.sum()))

    def linearize(self, moments: SampleMoments, errors: SensorErrors) -> Linearization:
        """Return the normal equations of the (12 K,) errors, SI, in the order of ``SensorErrors.to_vector``.

        Parameters
        ----------
        moments : SampleMoments
            Of the samples.
        errors : SensorErrors
            Where they are linearised.
        """
        offset = (errors.bias_T - self.origin.bias_T) / self.unit_T
        channels = ChannelMaps.at(errors.matrix, offset, self._vector_noise)
        common = self._common_mode(moments, errors, offset)
        rows = normal_equations(channels, moments.second, common, moments.count)
        return rows.by(rows_by_unknowns(errors, self.unit_T, None)).weighed(self.factors)

    def _common_mode(self, moments: SampleMoments, errors: SensorErrors, offset: FloatArray) -> CommonModeSums:
        """Return the sums of the common mode at given errors."""
        unmixing = self._elimination.unmixing
        # The field at the errors of the origin is affine in that at others, but for noise that these do not see.
        back = inv(unmixing @ errors.matrix.reshape(-1, 3))
        affine = np.eye(4)
        affine[:3, :3], affine[:3, 3] = back, -back @ unmixing @ offset.ravel()
        turn = np.eye(17)
        turn[:16, :16] = np.kron(affine, affine)
        choose = np.zeros((13, 17))
        choose[:12, :12] = np.eye(12)
        # Places of the squares of the field's components among its products with itself and 1.
        choose[12, (0, 5, 10)], choose[12, 16] = 0.5, -0.5
        turned = turn @ moments.fourth @ turn.T
        covariance = back @ self._elimination.covariance @ back.T
        # Places of the field's components by themselves, and of the 1.
        by_direction = turned[3::4, 3::4]
        by_field = covariance @ by_direction[:3, :3]
        score = np.column_stack([by_field + by_field.T, covariance @ by_direction[:3, 3]])
        return CommonModeSums(choose @ turned @ choose.T, score.ravel(), moments.scalar_count)

    @cached_property
    def _elimination(self) -> Elimination:
        return Elimination.of(self.origin.matrix.reshape(-1, 3), 1 / np.repeat(self._vector_noise, 3))

    @cached_property
    def _vector_noise(self) -> FloatArray:
        return self.array.vector_noise_T / self.unit_T

    @cached_property
    def _scalar_noise(self) -> float:
        return self.array.scalar_noise_T / self.unit_T


LARGEST_WALK = 0.1
"""Sum, over all directions, of the walk's variance over that of the estimate at which a stretch ends: within a stretch
the estimate is that of constant errors, and no variance is too small by more than this part."""


@dataclass(frozen=True, eq=False)
class Belief:
    """Normal distribution of the errors of the sensors at a moment.

    Parameters
    ----------
    errors : SensorErrors
        Mean.
    covariance : (12 K, 12 K) array
        Of the flattened errors, SI; zero for what is held.
    time_s : float
        Stamp of the moment, seconds.
    temperature_C : float
        Of the sensors; NaN where it is unknown.
    """

    errors: SensorErrors
    covariance: FloatArray
    time_s: float
    temperature_C: float

    @cached_property
    def free(self) -> FloatArray:
        """(12 K, M) directions of the errors that are not held."""
        return np.eye(len(self.covariance))[:, np.diag(self.covariance) > 0]

    def dated(self, time_s: float, temperature_C: float) -> "Belief":
        """Return the belief with a time and a temperature where it has none."""
        return replace(
            self,
            time_s=self.time_s if np.isfinite(self.time_s) else time_s,
            temperature_C=self.temperature_C if np.isfinite(self.temperature_C) else temperature_C,
        )

    def joined_with(self, further: Normal, errors: SensorErrors) -> "Belief":
        """Return the belief with further information, at given errors."""
        mean = self.errors.to_vector().ravel()
        downhill = further.score + further.information @ (errors.to_vector().ravel() - mean)
        covariance = inverted(self.certainty + further.information, self.free)
        vector = (mean + covariance @ downhill).reshape(-1, 12)
        return replace(self, errors=SensorErrors.from_vector(vector, self.errors.orientation), covariance=covariance)

    def distance(self, other: SensorErrors) -> float:
        """Return how far other errors are, in standard errors: root mean square over all directions."""
        step = (other.to_vector() - self.errors.to_vector()).ravel()
        return float(np.sqrt(step @ self.certainty @ step / self.free.shape[1]))

    def change_to(self, other: "Belief") -> float:
        """Return by what part of these standard errors another belief has other errors, or other standard errors.

        Each is a root mean square over all directions.
        """
        return max(self.distance(other.errors), abs(self.spread_of(other) - 1))

    def spread_of(self, other: "Belief") -> float:
        """Return the standard errors of another belief over these, in root mean square over all directions."""
        return float(np.sqrt(np.sum(self.certainty * other.covariance) / self.free.shape[1]))

    @cached_property
    def certainty(self) -> FloatArray:
        """(12 K, 12 K) inverse of the covariance; zero for what is held."""
        return inverted(self.covariance, self.free)


@dataclass(frozen=True, eq=False)
class Walk:
    """How the errors of the sensors change with time and temperature.

    Parameters
    ----------
    prior : Prior
        With the rates, and the convention that what changes must keep.
    """

    prior: Prior

    def covariance(self, before: Belief, time_s: float, temperature_C: float) -> FloatArray:
        """Return the (12 K, 12 K) covariance of the changes since a belief; where time goes back there are none."""
        warming_K = temperature_C - before.temperature_C
        assert self.prior.rates is not None
        variances = self.prior.rates.variances(
            max(time_s - before.time_s, 0.0), warming_K if np.isfinite(warming_K) else 0.0
        )
        derivative = self._derivative
        return derivative * np.tile(variances, before.errors.sensor_count) @ derivative.T

    def kept(self, changes: FloatArray) -> FloatArray:
        """Return changes (12 K, M) of the errors in the convention of the prior: none of what it holds."""
        return self._derivative @ changes

    @cached_property
    def _derivative(self) -> FloatArray:
        """(12 K, 12 K) changes in the convention by changes of the sensors; zero for what the prior holds."""
        _, derivative = self.prior.in_convention(self.prior.errors)
        derivative[np.diag(self.prior.covariance) <= 0] = 0
        return derivative


@dataclass(frozen=True, eq=False)
class Recursion:
    """Where the recursion is.

    Parameters
    ----------
    begin : Belief
        At the beginning of the stretch.
    moments : SampleMoments
        Of its samples.
    now : Belief
        What both say.
    """

    begin: Belief
    moments: SampleMoments
    now: Belief

    @classmethod
    def at(cls, belief: Belief) -> "Recursion":
        """Return the recursion that begins with a belief."""
        return cls(belief, SampleMoments.none(belief.errors.sensor_count), belief)

    def dated(self, time_s: float, temperature_C: float) -> "Recursion":
        """Return the recursion with a time and a temperature where it has none."""
        return replace(self, begin=self.begin.dated(time_s, temperature_C), now=self.now.dated(time_s, temperature_C))

    def joined_with(self, further: Normal, errors: SensorErrors, likelihood: MomentLikelihood) -> "Recursion":
        """Return the recursion with further information on the errors of its stretch, at given errors.

        Raises
        ------
        Refused
            When the iteration does not settle.
        """
        begin, now = self.begin.joined_with(further, errors), self.now
        found = solve(begin, self.moments, now.time_s, now.temperature_C, likelihood, now.errors)
        return replace(self, begin=begin, now=found)

    def after(
        self, moments: SampleMoments, time_s: float, temperature_C: float, likelihood: MomentLikelihood, walk: Walk
    ) -> "Recursion":
        """Return the recursion after another block of samples.

        Parameters
        ----------
        moments : SampleMoments
            Of the block.
        time_s, temperature_C : float
            At its end; a temperature that is NaN is the last one that was known.
        likelihood : MomentLikelihood
            That the moments are of.
        walk : Walk
            By which the sensors change.

        Raises
        ------
        Refused
            When the iteration does not settle.
        """
        if not np.isfinite(temperature_C):
            temperature_C = self.now.temperature_C
        begin, since = self.begin, self.moments
        change = walk.covariance(begin, time_s, temperature_C)
        if np.sum(self.now.certainty * change) > LARGEST_WALK:
            begin = Belief(self.now.errors, self.now.covariance + change, time_s, temperature_C)
            since = SampleMoments.none(begin.errors.sensor_count)
        since = since + moments
        now = solve(begin, since, time_s, temperature_C, likelihood, self.now.errors)
        return replace(self, begin=begin, moments=since, now=now)


def solve(
    begin: Belief,
    moments: SampleMoments,
    time_s: float,
    temperature_C: float,
    likelihood: MomentLikelihood,
    start: SensorErrors,
) -> Belief:
    """Return what a belief and samples say together: the maximum of their joint probability, and its covariance.

    Parameters
    ----------
    begin : Belief
        Before the samples.
    moments : SampleMoments
        Of the samples.
    time_s, temperature_C : float
        Of the result.
    likelihood : MomentLikelihood
        That the moments are of.
    start : SensorErrors
        Where to begin.

    Raises
    ------
    Refused
        When the iteration does not settle, or leads to sensors that cannot be.
    """
    free, mean = begin.free, begin.errors.to_vector().ravel()
    orientation = begin.errors.orientation

    def normal_at(vector: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        here = likelihood.linearize(moments, SensorErrors.from_vector(vector, orientation)).both
        information, gradient = here.information + begin.certainty, here.score - begin.certainty @ (vector - mean)
        return free.T @ information @ free, free.T @ gradient, information

    def moved(vector: FloatArray, step: FloatArray) -> FloatArray:
        vector = vector + free @ step
        if not are_possible(vector.reshape(-1, 12)):
            raise Refused("the update leads to sensors that cannot be: the readings do not fit the calibration")
        return vector

    vector, information = descend(normal_at, moved, start.to_vector().ravel())
    errors = SensorErrors.from_vector(vector, orientation)
    return Belief(errors, inverted(information, free), time_s, temperature_C)


TRIED, MOST_TRIED = 3, 30
"""Blocks on which what was learned is tried before it is published: six seconds to a minute."""

CLEARLY_BETTER = 100.0
"""Fall of the squared residuals, in units of the noise, from which a calibration predicts better: chance makes half of
it once in ten thousand trials of four sensors."""


@dataclass(frozen=True, eq=False)
class Trial:
    """What is known, tried on the blocks after it.

    Parameters
    ----------
    belief : Belief
        What was known.
    blocks : int
        Number of blocks.
    energy : (2,) array
        Squared residuals of their differential channels and of their common mode by what was published.
    fall : (2,) array
        By how much these are smaller by what was known.
    """

    belief: Belief
    blocks: int = 0
    energy: FloatArray = field(default_factory=lambda: np.zeros(2))
    fall: FloatArray = field(default_factory=lambda: np.zeros(2))

    def after(self, moments: SampleMoments, published: Belief, likelihood: MomentLikelihood) -> "Trial":
        """Return the trial after another block of samples."""
        before, tried = (
            np.array([here.between.energy, here.common.energy])
            for here in (likelihood.linearize(moments, each.errors) for each in (published, self.belief))
        )
        return replace(self, blocks=self.blocks + 1, energy=self.energy + before, fall=self.fall + before - tried)

    @property
    def is_over(self) -> bool:
        """Whether it has seen enough blocks."""
        return self.has_passed or self.blocks >= MOST_TRIED

    @property
    def has_passed(self) -> bool:
        """Whether it predicts better than what was published.

        Sensors that agree better by themselves are needed where there are several: the scalar may be slow, or feel
        metal that turns with it.
        """
        of_sensors, of_all = float(self.fall[0]), float(self.fall.sum())
        # Part of the squared residuals by which they fall as well: biases of all sensors were off by a tenth of
        # the noise. With less, errors that the mission does not turn through may become worse.
        least = max(CLEARLY_BETTER, 0.01 * float(self.energy.sum()))
        fall = min(of_sensors, of_all) if self.energy[0] else of_all
        return self.blocks >= TRIED and fall >= least


class Stretch:
    """Samples with angular velocity, and what was known before them.

    Parameters
    ----------
    prior : Prior
        Of the sensors; its array states the gyroscope.
    """

    def __init__(self, prior: Prior) -> None:
        self._prior = prior
        self.clear()

    def clear(self) -> None:
        """Begin anew: the sensors have changed, or what there was is learned."""
        self._blocks: list[tuple[FloatArray, FloatArray]] = []
        self._before: Belief | None = None
        self._averaged = AveragedRates()

    def add(self, rows: FloatArray, rates: FloatArray, before: Belief) -> None:
        """Take the samples of a block.

        Parameters
        ----------
        rows : (n, 3K + 3) array
            As of ``Live.add``.
        rates : (n, 3) array
            Angular velocities, rad/s; NaN where there is none.
        before : Belief
            What was known before the block.
        """
        if not np.isfinite(rates).any():
            return
        if self._blocks and rows[0, 0] <= self._blocks[-1][0][-1, 0]:  # the clock was set
            self.clear()
        self._before = self._before or before
        stamps_ns = np.round(1e9 * rows[:, 0]).astype(np.int64)
        self._averaged.add(stamps_ns, rates)
        # Samples that are kept of a block of 2 s; angular velocities are averaged between them, so that none is
        # lost.
        kept = np.linspace(0, len(rows), min(20, len(rows)) + 1).astype(int)[1:] - 1
        self._blocks.append((rows[kept], self._averaged.means(stamps_ns[kept], rates[kept])))

    @property
    def is_full(self) -> bool:
        """Whether it is long enough to be learned."""
        # Time after which what the gyroscope tells is learned: longer than swings in waves take, and than a
        # quarter turn.
        return bool(self._blocks) and self._blocks[-1][0][-1, 0] - self._blocks[0][0][0, 0] >= 120.0

    def information(self, factors: VarianceFactors) -> tuple[Normal, SensorErrors] | None:
        """Return the information of its turns on the errors, and at which; None if the gyroscope is not used.

        Parameters
        ----------
        factors : VarianceFactors
            Of the readings.
        """
        assert self._before is not None
        rows, rates = (np.concatenate(each) for each in zip(*self._blocks, strict=True))
        before, scalar_T = self._before, rows[:, -2]
        calibration = replace(self._prior.calibration, errors=before.errors)
        known = Known(
            replace(self._prior, calibration=calibration, covariance=before.covariance), variance_factors=factors
        )
        self.clear()
        recording = Recording(
            rows[:, 0],
            rows[:, 1:-2].reshape(len(rows), -1, 3),
            scalar_T if np.isfinite(scalar_T).any() else None,
            angular_velocity_rad_s=rates,
        )
        recording, judged = judge_gyroscope(recording, calibration.array, known)
        if judged.fit is None:
            return None
        known = replace(known, gyroscope=judged.fit.begun, start=judged.fit.place)
        problem = Problem.of(recording, calibration.array, known)
        return problem.errors_by_motion(problem.start), problem.start.errors
