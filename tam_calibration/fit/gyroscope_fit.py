"""A fit with angular velocity as data: its noise by the residuals, and what these show of the gyroscope."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.fit.agreement import FAR, SEEN, MotionFit
from tam_calibration.fit.contradiction import SIGNIFICANT, probability_of
from tam_calibration.fit.gyroscope_likelihood import GyroscopeLikelihood
from tam_calibration.fit.gyroscope_path import GyroscopeState, GyroscopeUse
from tam_calibration.fit.information import inverted
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori
from tam_calibration.fit.problem import Known, Place, Problem
from tam_calibration.fit.slow_residuals import variance_factors
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import from_degrees, to_degrees, to_nanotesla

_STRIDE, _FEWEST_STRIDES = 8, 50
"""Intervals over which noise is measured, and how many of these there are at least."""

_MOST_ROUNDS, _SETTLED = 6, 0.05
"""To find the noise, and the part by which it may change in the last of them."""

_MOST_FITTED = 200_000
"""Turns of a fit to all samples: of more those over several samples."""

_TYPICAL_SCALE = 1e-3
"""Scale error of a gyroscope that was calibrated, whose effect is reported."""

_LATE, _ASKEW = 0.5, from_degrees(2.0)
"""Delay in intervals of samples, and turn in radians, from which they are worth a note."""


@dataclass(frozen=True, eq=False)
class GyroscopeFit(MotionFit):
    """A fit with angular velocity as data."""

    @classmethod
    def settled(cls, recording: Recording, array: Array, known: Known, use: GyroscopeUse) -> "GyroscopeFit":
        """Return the fit with the noise that its residuals show, or the first one where that is more.

        The readings are weighed by what they leave.
        """
        first = maximum_a_posteriori(recording, array, replace(known, gyroscope=use))
        factors = known.variance_factors.at_least(variance_factors(first, recording))
        start = Place(first.errors, first.intensity_T)
        used = replace(known, gyroscope=use, variance_factors=factors, start=start)
        problem = Problem.of(recording, first.array, used)
        fit = cls(problem, problem.most_probable()[0])
        for _ in range(_MOST_ROUNDS):
            density = max(fit.measured(), use.density)
            if abs(density - fit.use.density) <= _SETTLED * fit.use.density:
                break
            fit = fit.with_density(density)
        return fit

    @property
    def likelihood(self) -> GyroscopeLikelihood:
        """The angular velocity as data."""
        assert isinstance(self.problem.motion, GyroscopeLikelihood)
        return self.problem.motion

    @property
    def use(self) -> GyroscopeUse:
        """How the angular velocity counts."""
        return self.likelihood.use

    @property
    def state(self) -> GyroscopeState:
        """Of the gyroscope."""
        assert isinstance(self.place.motion, GyroscopeState)
        return self.place.motion

    @property
    def begun(self) -> GyroscopeUse:
        """How the angular velocity counts, its fit begun where this one ends."""
        return replace(self.use, start=self.state, stride=-(-self.likelihood.sample_count // _MOST_FITTED))

    def _settled_with(self, use: GyroscopeUse) -> "GyroscopeFit":
        problem = replace(self.problem, motion=replace(self.likelihood, use=use))
        return GyroscopeFit(problem, problem.settled(self.place, is_corrected=True)[0])

    def with_density(self, density: float) -> "GyroscopeFit":
        """Return the fit with another noise of the gyroscope."""
        if density == self.use.density:
            return self
        return self._settled_with(replace(self.use, density=density))

    def measured(self, sigmas: float = 0.0) -> float:
        """Return the density of the noise that the residuals show over several samples."""
        path = self.likelihood.path
        slow = self.likelihood.coarser(max(1, min(-(-_STRIDE // path.stride), len(path.links) // _FEWEST_STRIDES)))
        return slow.scatter(*self.problem.rows_at(self.place), self.state, self.taken, sigmas)

    def weighed(self) -> "GyroscopeFit":
        """Return the fit with the weight that slow errors of the angular velocity leave it."""
        factor = self.lasting()
        return self if factor == 1 else self._settled_with(replace(self.use, lasting=factor))

    @property
    def is_bent(self) -> bool:
        """Whether the residuals show axes that are not true: the score of their scales and angles."""
        information, gradient = self.everything.information, self.everything.score
        shape = np.arange(len(gradient) - 6, len(gradient))
        across = self.white.T @ information[:, shape]
        left = information[np.ix_(shape, shape)] - across.T @ across
        values, vectors = np.linalg.eigh(left)
        seen = values > SEEN * values[-1]
        score = (vectors.T @ gradient[shape])[seen]
        chi_square = float(np.sum(score**2 / values[seen]))
        return probability_of(chi_square, int(seen.sum())) < SIGNIFICANT

    @property
    def bent(self) -> str:
        """How far the axes are from true, in a sentence."""
        size = 100 * float(np.abs(self.state.shape - np.eye(3)).max())
        differ = f"scale and angles of the gyroscope's axes differ by up to {size:.2g} % from those of the array"
        return f"{differ}, which is estimated"

    def contradiction(self) -> str:
        """Return how angular velocity contradicts all else, or nothing."""
        sizes = self.difference(self.own)
        words = "look at its stamps and axes, and at whether the field is uniform"
        return f"the angular velocity contradicts the readings, {sizes}: {words}" if sizes else ""

    def remarks(self) -> tuple[str, ...]:
        """Return how the gyroscope is late and turned, and what its scale may do, in a sentence each."""
        from scipy.spatial.transform import Rotation

        information = self.everything.information
        covariance = inverted(information, self.basis)
        errors = np.sqrt(np.diag(covariance))[-self.state.size :]
        count, notes = self.state.bias.size, []
        if abs(self.state.delay_s) > max(FAR * errors[count], _LATE * self.use.interval_s):
            late = "late" if self.state.delay_s > 0 else "early"
            notes.append(f"the angular velocity is {abs(self.state.delay_s):.3g} s {late}, which is taken off")
        turn = float(norm(Rotation.from_matrix(self.state.mount).as_rotvec()))
        if turn > max(FAR * float(norm(errors[count + 1 : count + 4])), _ASKEW):
            notes.append(f"the gyroscope is turned by {to_degrees(turn):.2g}° against sensor 1, which is estimated")
        # A scale error of all axes moves the errors of the sensors by so much.
        shift = -covariance @ information[:, -6:-3].sum(axis=1)
        biases = np.arange(12 * self.place.errors.sensor_count).reshape(-1, 12)[:, 6:9].ravel()
        moved_nT = _TYPICAL_SCALE * to_nanotesla(float(norm(shift[biases])))
        if not self.use.shape_error and moved_nT > to_nanotesla(
            float(np.sqrt(np.trace(covariance[biases][:, biases])))
        ):
            notes.append(
                f"the gyroscope's scale is taken for true: {100 * _TYPICAL_SCALE:g} % of it would move the biases by "
                f"{moved_nT:.2g} nT; state scale_error_percent"
            )
        return tuple(notes)
