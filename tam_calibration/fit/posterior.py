"""The errors of the sensors that are most probable by a prior and a recording together.

Gauss-Newton over the errors θ themselves, in which the prior is a parabola: the information of the data, that of the
rows [D Λ | o], is carried to them by the derivative of the rows, and that of the prior is added. What neither tells is
held as plain fits hold it: the frame of sensor 1, and the mean determinant where no reference tells the scale.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tam_calibration.fit.gauss_newton import descend
from tam_calibration.fit.information import inverted, keeping, rows_by_unknowns
from tam_calibration.fit.likelihood import Likelihood, UniformLikelihood
from tam_calibration.fit.maximum_likelihood import likelihood_of
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.scale import Normalized, free_scale, free_scale_gradient
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Posterior:
    """What prior and data tell together.

    Parameters
    ----------
    errors : SensorErrors
        The most probable ones.
    covariance : (12 K, 12 K) array
        Of the flattened errors, SI; zero for what is held.
    intensity_T : float
        Of the field: fitted where no scalar reference tells it; else that of the prior, tesla.
    """

    errors: SensorErrors
    covariance: FloatArray
    intensity_T: float


def posterior_of(recording: SampleSource, array: KnownNoiseArray, prior: Prior) -> Posterior:
    """Return what a prior and a recording in a uniform field tell together of the errors of an array's sensors.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors; without any scalar reading the intensity is an unknown constant.
    array : KnownNoiseArray
        With every noise.
    prior : Prior
        Of the same sensors.

    Raises
    ------
    Refused
        When the iteration does not settle.
    """
    problem = Problem.of(recording, array, prior)

    def normal_at(place: Place) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
        information, gradient = problem.data_at(place)
        terms, size = prior.terms(place.errors), 12 * array.sensor_count
        information[:size, :size] += terms.information
        gradient[:size] += terms.gradient
        basis = problem.basis_at(place)
        return basis.T @ information @ basis, basis.T @ gradient, (information, basis)

    start = Place(prior.errors, prior.calibration.intensity_T)
    end, kept = descend(normal_at, lambda place, step: problem.moved(place, problem.basis_at(place) @ step), start)
    size = 12 * array.sensor_count
    return Posterior(end.errors, inverted(*kept)[:size, :size], end.intensity_T)


class Place(NamedTuple):
    """Errors, and the intensity of a field whose intensity no scalar reads, tesla."""

    errors: SensorErrors
    intensity_T: float


@dataclass(frozen=True, eq=False)
class Problem:
    """The likelihood of a recording over the errors θ and, where no scalar tells it, the intensity over its unit."""

    likelihood: Likelihood | UniformLikelihood
    prior: Prior
    has_scalar: bool

    @classmethod
    def of(cls, recording: SampleSource, array: KnownNoiseArray, prior: Prior) -> "Problem":
        """Return that of a recording, its readings taken about the biases of the prior."""
        data = Normalized(recording, prior.errors.bias_T, prior.calibration.intensity_T)
        return cls(likelihood_of(recording, array, data), prior, recording.scalar_count is not None)

    @cached_property
    def unit_T(self) -> float:
        """Unit of field of the likelihood."""
        return self.prior.calibration.intensity_T

    def data_at(self, place: Place) -> tuple[FloatArray, FloatArray]:
        """Return the information of the data over the unknowns at a place, and their downhill gradient."""
        errors, factor = place.errors, place.intensity_T / self.unit_T
        bias = (errors.bias_T - self.prior.errors.bias_T) / self.unit_T
        here = self.likelihood.linearize(factor * errors.matrix, bias)
        rows = rows_by_unknowns(errors, self.unit_T, None if self.has_scalar else place.intensity_T)
        return rows.T @ here.information @ rows, rows.T @ here.gradient

    def basis_at(self, place: Place) -> FloatArray:
        """Return the directions of the unknowns that are free, as columns."""
        size = 12 * place.errors.sensor_count + (not self.has_scalar)
        free = np.ones(size, dtype=bool)
        free[9:12] = self.prior.knows_frame
        if self.has_scalar or self.prior.knows_scale:
            columns: FloatArray = np.eye(size)[:, free]
            return columns
        return keeping(np.append(free_scale_gradient(place.errors), 0.0), free)

    def moved(self, place: Place, step: FloatArray) -> Place:
        """Return the place after a step of the unknowns."""
        errors, count = place.errors, place.errors.sensor_count
        vector = errors.to_vector() + step[: 12 * count].reshape(count, 12)
        errors = SensorErrors.from_vector(vector, errors.orientation)
        if self.has_scalar:
            return Place(errors, place.intensity_T)
        intensity_T = place.intensity_T + self.unit_T * float(step[-1])
        if not self.prior.knows_scale:
            scale = float(free_scale(errors.matrix))
            errors, intensity_T = replace(errors, scale_factor=scale * errors.scale_factor), intensity_T / scale
        return Place(errors, intensity_T)
