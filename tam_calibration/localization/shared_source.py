"""The source that all samples of a run share, each from a place that nothing is known of.

Of the eight outputs of a sample the place takes three numbers of a dipole and two of a line. A dipole's moment, a
line's direction and strength, and the regional field u are the same in all samples. With the places b of the samples
eliminated a step δs of what they share is that of

    Σ Aᵀ (1 - J (JᵀJ)⁻¹ Jᵀ) (A δs - r) = 0,

A and J the derivatives of the whitened outputs by s and by b, r their residuals at the best b for s (variable
projection, Kaufman 1975). What is left are five numbers of each sample for a dipole and six for a line, less those that
are shared: they see a second source, or a gradient of the regional field, far better than each sample by itself.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Predict, Solution, root_of, solve_damped
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.solutions import EulerSolutions
from tam_calibration.localization.source_fit import (
    SMALLEST_STEP,
    Dipoles,
    Lines,
    elements_of,
    hardly_moves,
    whitening_of,
)
from tam_calibration.localization.turned_samples import Beside, Regional, Samples
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import dipole_field


@dataclass(frozen=True, eq=False)
class SharedSource:
    """What N samples say together.

    Parameters
    ----------
    solution : Solution
        Of what is shared: moment, or tilts and strengths of the line, and the regional field's error.
    position_m : (N, 3) array
        Of the source from the array's centre, or of the nearest point of the line, along the world's axes, metres.
    across : (3, D) array
        Directions of the world in which places are determined: all three of a dipole, two across a line.
    regional : Regional
        The field beside the source, with its covariance.
    residuals : (N, 8) array
        Whitened.
    slopes : (N, 8, P) array
        Derivatives of the whitened outputs by what is shared, less their part along those by the places.
    freedom : int
        Numbers of each sample that its place does not take.
    """

    solution: Solution
    position_m: FloatArray
    across: FloatArray
    regional: Regional
    residuals: FloatArray
    slopes: FloatArray
    freedom: int


def fit_shared(samples: Samples, own: EulerSolutions, near: Regional, prior: Regional) -> SharedSource:
    """Fit what N samples share.

    Parameters
    ----------
    samples : Samples
        With an attitude.
    own : EulerSolutions
        Of each sample by itself, all located, along the axes of the world.
    near : Regional
        The regional field with which they were located.
    prior : Regional
        What is known of it beforehand.
    """
    run = _run_of(samples, own, near, prior, is_one=True)
    solution = run.solve()
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        predicted, slopes = run.predict(solution.unknowns, np.arange(1))
        places = run.places(solution.unknowns[0])
    count = run.data.size
    position_m = run.position_m(places, solution.unknowns[0], samples.rotation)
    residuals = (run.target - predicted)[0, :count].reshape(run.data.shape)
    slopes = slopes[0, :count].reshape(*run.data.shape, -1)
    regional = run.regional(solution, near, prior)
    return SharedSource(solution, position_m, run.across, regional, residuals, slopes, 8 - places.shape[1])


def fit_regional(samples: Samples, own: EulerSolutions, near: Regional, prior: Regional) -> Regional:
    """Fit the regional field that N samples share; each sample has a line of its own.

    This works from a worse start than the fit with one line for all samples.

    Parameters
    ----------
    samples, own, near, prior
        As of ``fit_shared``, of a line.
    """
    run = _run_of(samples, own, near, prior, is_one=False)
    return run.regional(run.solve(), near, prior)


@dataclass(frozen=True, eq=False)
class _Run:
    """A run of N samples as a problem in what they share.

    ``by_field`` (N, 8, 3) are the derivatives of the whitened outputs ``data`` by the regional field's error in units
    of its standard errors, which is expected to be ``expected`` (3,); ``root`` (3, 3) makes tesla of it. Of the
    unknowns of ``own`` the first are places ``near`` (N, L) and the others ``by_shared`` (N, S, C) times what is
    shared, ``shared`` (C,) to begin with. ``across`` are the directions in the world in which a place counts.
    """

    data: FloatArray
    by_field: FloatArray
    root: FloatArray
    expected: FloatArray
    own: Predict
    near: FloatArray
    by_shared: FloatArray
    shared: FloatArray
    across: FloatArray

    @property
    def target(self) -> FloatArray:
        """(1, 8 N + 3) whitened outputs, and what is expected of the regional field."""
        return np.concatenate([self.data.ravel(), self.expected])[None]

    def is_small(self, unknowns: FloatArray, step: FloatArray) -> np.ndarray:
        """Return whether a step (1, P) hardly changes source and field, as far as places that hardly move can tell."""
        least, count = np.sqrt(SMALLEST_STEP), len(self.shared)
        is_same_source = norm(step[0, :count]) <= least * norm(unknowns[0, :count])
        return np.array([is_same_source and norm(step[0, count:]) <= least])

    def solve(self) -> Solution:
        """Return what is shared, and the regional field's error."""
        start = np.concatenate([self.shared, np.zeros(3)])[None]
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # where a step leads far away
            return solve_damped(self.predict, self.target, start, self.is_small)

    def regional(self, solution: Solution, near: Regional, prior: Regional) -> Regional:
        """Return the regional field that a solution has, instead of the one that was near or known beforehand."""
        count = len(self.shared)
        field_T = near.field_T + self.root @ solution.unknowns[0, count:]
        covariance_T2 = self.root @ solution.covariance[0, count:, count:] @ self.root.T
        return replace(prior, field_T=field_T, covariance_T2=covariance_T2)

    def places(self, unknowns: FloatArray) -> FloatArray:
        """Return the places (N, L) that explain most beside what is shared (P,)."""
        shared, field = np.split(unknowns, [len(self.shared)])
        rest = self.by_shared @ shared

        def predict(places: FloatArray, at: np.ndarray) -> tuple[FloatArray, FloatArray]:
            predicted, slopes = self.own(np.concatenate([places, rest[at]], axis=1), at)
            return predicted, slopes[..., : places.shape[1]]

        data = self.data - self.by_field @ field
        return solve_damped(predict, data, self.near, hardly_moves).unknowns

    def predict(self, unknowns: FloatArray, _: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Return the data (1, 8 N + 3) of what is shared (1, P), and the derivatives without those by the places."""
        places = self.places(unknowns[0])
        shared, field = np.split(unknowns[0], [len(self.shared)])
        full = np.concatenate([places, self.by_shared @ shared], axis=1)
        predicted, slopes = self.own(full, np.arange(len(self.data)))
        by_place, by_rest = np.split(slopes, [places.shape[1]], axis=2)
        slopes = np.concatenate([by_rest @ self.by_shared, self.by_field], axis=2)
        basis = np.linalg.qr(by_place)[0]
        slopes -= basis @ (np.swapaxes(basis, 1, 2) @ slopes)
        known = np.eye(len(field), len(unknowns[0]), len(shared))
        data = np.concatenate([(predicted + self.by_field @ field).ravel(), field])
        return data[None], np.concatenate([slopes.reshape(-1, slopes.shape[2]), known])[None]

    def position_m(self, places: FloatArray, unknowns: FloatArray, matrix: FloatArray) -> FloatArray:
        """Return places (N, L) along the axes of the world (N, 3), of lines those of their nearest points."""
        if places.shape[1] == 3:
            return np.asarray((matrix @ places[..., None])[..., 0])
        axes = np.column_stack([self.across, np.cross(*self.across.T)])
        along = axes @ np.append(unknowns[:2], 1.0)
        world = places @ self.across.T
        return np.asarray(world - np.outer(world @ along, along) / (along @ along))


def _run_of(samples: Samples, own: EulerSolutions, near: Regional, prior: Regional, is_one: bool) -> _Run:
    """Return the run that begins with the sources of each sample; they share theirs, or each line is its own."""
    root = root_of(prior.covariance_T2)
    expected = np.linalg.pinv(root) @ (prior.field_T - near.field_T)
    back, outputs, array = np.swapaxes(samples.rotation, 1, 2), samples.outputs, samples.array
    beside = Beside.of(samples, replace(near, covariance_T2=np.zeros((3, 3))))
    turned_T = beside.field_T
    if near.attitude_noise:
        own_T = dipole_field(-own.position_m, own.moment_Am2)[0]
        turned_T = outputs[:, :3] - (back @ own_T[..., None])[..., 0]
    seen, noise = beside.less(turned_T)
    # Without errors of the attitude all samples have one noise.
    whitening = np.broadcast_to(whitening_of(noise if near.attitude_noise else noise[:1]), noise.shape)
    points, by_points = elements_of(array, array.operator[:8])
    data, weights = (whitening @ seen[..., None])[..., 0], whitening @ by_points
    by_field = whitening[..., :3] @ back @ root
    places = (back @ own.position_m[..., None])[..., 0]
    if samples.index == DIPOLE_INDEX:
        weight = np.linalg.inv(own.moment_covariance_A2m4)
        mean = np.linalg.solve(weight.sum(axis=0), np.einsum("nij,nj->i", weight, own.moment_Am2))
        return _Run(data, by_field, root, expected, Dipoles(points, weights).predict, places, back, mean, np.eye(3))
    _, axes = np.linalg.eigh(own.along.T @ own.along)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    turned = back @ axes
    lines = Lines.seen_along(turned, points, weights, samples.index)
    shapes = lines.shapes(places)
    unknowns = lines.with_strengths(data, shapes, np.arange(len(data)))[0]
    split = 2 if is_one else unknowns.shape[1]
    shared = np.median(unknowns[:, split:], axis=0)
    by_shared = np.broadcast_to(np.eye(len(shared)), (len(data), len(shared), len(shared)))
    return _Run(data, by_field, root, expected, lines.predict, unknowns[:, :split], by_shared, shared, axes[:, :2])
