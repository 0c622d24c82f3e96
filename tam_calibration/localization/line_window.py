"""A part of a survey line as one problem of least squares, in which all but the dipoles is marginalised.

In the world the field at sensor k is f_k = u + G a_k + Σ b(p + a_k - p_s, m_s) with arms a_k, a regional field u and a
gradient G, both smooth along the line. The path p errs by a spline of known covariance. The attitude errs by a tilt, by
turns about the regional field of known size, and by whatever turns the mean of the readings: that part is taken off
each sample by the shortest rotation from the expected to the measured mean. Data are the intensity of the mean and the
differences between sensors.
"""

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.linalg import norm
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from tam_calibration.core.field_alignment import turns_between
from tam_calibration.localization.line_data import SMOOTH_M, LineData
from tam_calibration.localization.line_path import Basis, Path
from tam_calibration.model.array import UNIT_TENSORS
from tam_calibration.model.sensor_errors import crossing
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.sources.dipole import dipole_field, field_alone, field_by_moment

_REGIONAL_STEP_M, _TURN_STEP_S = 25.0, 1.5
"""Distances between knots of the regional field, and of the turns about it."""

_BEND_T, _CHANGE_T_PER_M = 20e-9, 2e-9
"""Standard deviations of the second difference of the regional field's knots, and of the change of its gradient."""

_DIRECTION, _GRADIENT_T_PER_M = 3e-3, 1e-6
"""Standard deviations of the regional field, as a part of the median of the readings, and of its gradient, T/m."""

_KNOWN_M, _KNOWN = 2.0, 0.5
"""Standard deviations between two windows of a neighbour's place, metres, and of its moment, as a part of that: a drift
of the path is less. A window sees its neighbours from the side alone, where they would move to anywhere."""

_REGIONAL, _GRADIENT = 7, 10
"""Which basis of a window is the first of the regional field, and the first of its gradient."""


@dataclass(frozen=True, eq=False)
class Window:
    """A part of a line, and the fields of dipoles that lie outside it.

    Parameters
    ----------
    data : LineData
        Its moments.
    path : Path
        Of the array's centre.
    fixed : (F, 6) array
        Places and moments of dipoles that are not fitted here.
    roughness : float
        How far the regional field and its gradient may change, as a part of the most.
    known : (N, 6) array, optional
        Places and moments of neighbours, found in other windows: the first dipoles that are fitted, near these.
    """

    data: LineData
    path: Path
    fixed: FloatArray
    roughness: float = 1.0
    known: FloatArray = field(default_factory=lambda: np.zeros((0, 6)))

    @cached_property
    def place_m(self) -> FloatArray:
        """(M, 3) path of the array's centre, metres."""
        return self.path.at(self.data.time_s)

    @cached_property
    def _aside_m(self) -> FloatArray:
        """(M, 3) distances of the path from the straight line nearest to it, metres."""
        rows = np.column_stack([np.ones(len(self.place_m)), self.data.along_m - self.data.along_m.mean()])
        return np.asarray(self.place_m - rows @ np.linalg.lstsq(rows, self.place_m, rcond=None)[0])

    @cached_property
    def bases(self) -> list[FloatArray]:
        """(M, n) bases of what errors and the regional field add at a moment, each with unknowns of its own.

        Of the path's three coordinates, three tilts, the turn about the regional field, the three components of this
        field and the five of its gradient.
        """
        way, times, error = self.data.along_m, self.data.time_s, self.data.attitude_error
        own, roots = self.path.error(float(times[0]), float(times[-1]))
        rows = self.path.basis.matrix(times)[:, own]
        turns = Basis.over(float(times[0]), float(times[-1]), _TURN_STEP_S).matrix(times)
        regional, gradient = (
            Basis.over(float(way.min()), float(way.max()), step).matrix(way) for step in (_REGIONAL_STEP_M, SMOOTH_M)
        )
        tilt = np.full((len(times), 1), error)
        return [*(rows @ root for root in roots), *[tilt] * 3, error * turns, *[regional] * 3, *[gradient] * 5]

    @cached_property
    def edges(self) -> IntArray:
        """(16,) where the unknowns of each basis begin, behind the errors of the calibration, and the last end."""
        return np.cumsum([self.data.errors_T.shape[2], *(each.shape[1] for each in self.bases)])

    @property
    def unit_count(self) -> int:
        """Number of errors, which are first and of which one is expected: calibration, path, tilts and turns."""
        return int(self.edges[_REGIONAL])

    @property
    def nuisance_count(self) -> int:
        """Number of unknowns beside the dipoles."""
        return int(self.edges[-1])

    def divided(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the dipoles (S, 6), and the other unknowns."""
        sources, others = np.split(unknowns, [len(unknowns) - self.nuisance_count])
        return sources.reshape(-1, 6), others

    @cached_property
    def prior(self) -> FloatArray:
        """Root (R, n) of the precision of all unknowns but the dipoles."""
        regional, gradient = (np.eye(self.bases[place].shape[1]) for place in (_REGIONAL, _GRADIENT))
        size = float(np.median(norm(self.data.fields_T.mean(axis=1), axis=1)))
        level_T = size * np.hypot(self.data.attitude_error, _DIRECTION)
        bend_T, change_T_per_m = self.roughness * _BEND_T, self.roughness * _CHANGE_T_PER_M
        bend = np.vstack([np.diff(regional, 2, axis=0) / bend_T, regional[[0, -1]] / level_T])
        change = np.vstack([np.diff(gradient, axis=0) / change_T_per_m, gradient[:1] / _GRADIENT_T_PER_M])
        return np.asarray(block_diag(np.eye(self.unit_count), *[bend] * 3, *[change] * 5))

    @cached_property
    def known_precision(self) -> FloatArray:
        """(6 N,) of the neighbours' places and moments."""
        size = norm(self.known[:, 3:], axis=1, keepdims=True)
        spread = np.hstack([np.full((len(size), 3), _KNOWN_M), np.repeat(_KNOWN * size, 3, axis=1)])
        return np.asarray(spread.ravel() ** -2.0)

    @property
    def precision(self) -> FloatArray:
        """(n, n) of all unknowns but the dipoles, beforehand."""
        return np.asarray(self.prior.T @ self.prior)

    def by_moment(self, places: FloatArray) -> FloatArray:
        """Return the derivatives (M, 3 K - 2, n, 3) of the data by the moments of dipoles at places (n, 3)."""
        points = self.place_m[:, None] + self.data.arms_m
        made = np.moveaxis(field_by_moment(points[:, :, None] - places), 2, 3)
        rows = self._whitened(made.reshape(*points.shape, -1), self.data.fields_T)
        return rows.reshape(*rows.shape[:2], -1, 3)

    @cached_property
    def _contrasts(self) -> FloatArray:
        """(K, K) rotation of the sensors' whitened readings, whose first row is their mean."""
        inverse = 1 / self.data.noise_T[0]
        matrix = np.column_stack([inverse, np.eye(len(inverse))[:, 1:]])
        rotation = np.linalg.qr(matrix)[0].T
        return np.asarray(rotation * np.sign(rotation[0, 0]))

    def start(self) -> FloatArray:
        """Return the (n,) unknowns of no dipole: the median field and no error."""
        unknowns, mean = np.zeros(self.nuisance_count), self.data.fields_T.mean(axis=1)
        uniform = np.median(mean / norm(mean, axis=1, keepdims=True), axis=0) * np.median(norm(mean, axis=1))
        unknowns[self.unit_count : self.edges[_GRADIENT]] = np.repeat(uniform, self.bases[_REGIONAL].shape[1])
        return unknowns

    def linearized(self, unknowns: FloatArray, with_slopes: bool = True) -> tuple[FloatArray, FloatArray]:
        """Return the residuals (M, 3 K - 2), data less model in units of their noise, and the model's derivatives."""
        data = self.data
        sources, others = self.divided(unknowns)
        errors, *parts = np.split(others, self.edges[:-1])
        values = np.column_stack([basis @ part for basis, part in zip(self.bases, parts, strict=True)])
        place, aside = self.place_m + values[:, :3], self._aside_m + values[:, :3]
        theta = values[:, 3:6] + values[:, 6:7] * data.direction
        turned = Rotation.from_rotvec(theta)
        uniform = turned.inv().apply(values[:, _REGIONAL:_GRADIENT])
        tensor = np.tensordot(values[:, _GRADIENT:], UNIT_TENSORS, 1)
        every = np.concatenate([sources, self.fixed])
        added = (data.errors_T @ errors).reshape(data.fields_T.shape)

        def field_at(arms: FloatArray) -> FloatArray:
            points = place[:, None] + arms
            dipoles = field_alone(points[:, :, None] - every[:, :3], every[:, 3:]).sum(axis=2)
            return np.asarray(uniform[:, None] + (aside[:, None] + arms) @ tensor + dipoles + added)

        expected, measured = self._mean(field_at(data.arms_m)), self._mean(data.fields_T)
        total = (Rotation.from_rotvec(turns_between(turned.apply(expected), measured)) * turned).inv()
        arms, readings = _applied(total, data.arms_m), _applied(total, data.fields_T)
        residual = (readings - field_at(arms))[..., None]
        if not with_slopes:
            return self._whitened(residual, readings)[..., 0], np.zeros((0, 0, 0))
        made, grad, by_moment = dipole_field((place[:, None] + arms)[:, :, None] - every[:, :3], every[:, 3:])
        slope = tensor[:, None] + grad.sum(axis=2)
        own = np.concatenate([-grad[:, :, : len(sources)], by_moment[:, :, : len(sources)]], axis=4)
        columns = np.moveaxis(own, 2, 3).reshape(*made.shape[:2], 3, sources.size)
        by_turn = np.broadcast_to(crossing(uniform)[:, None], slope.shape)
        by_regional = np.broadcast_to(turned.inv().as_matrix()[:, None], slope.shape)
        by_tensor = np.einsum("qij,nkj->nkiq", UNIT_TENSORS, arms + aside[:, None])
        by_errors = data.errors_T.reshape(*made.shape[:2], 3, -1)
        local = np.concatenate([columns, by_errors, slope, by_turn, by_regional, by_tensor], axis=3)
        # A change of the expected mean turns the readings and the arms after it.
        turning = crossing(readings) - slope @ crossing(arms)
        along = expected / norm(expected, axis=1, keepdims=True)
        meant = turned.inv().apply(measured / norm(measured, axis=1, keepdims=True))
        twist = np.cross(meant, along) / (1 + np.sum(meant * along, axis=1, keepdims=True))
        by_mean = (crossing(along) - along[:, :, None] * twist[:, None]) / norm(expected, axis=1)[:, None, None]
        turns = by_mean @ self._mean(local)
        first = sources.size + len(errors)
        by_theta = slice(first + 3, first + 6)
        turns[..., by_theta] -= along[:, :, None] * (along + np.cross(along, twist))[:, None]
        local += turning @ turns[:, None]
        local[..., by_theta] = local[..., by_theta] @ (np.eye(3) - crossing(theta) / 2)[:, None]
        rows = self._whitened(np.concatenate([residual, local], axis=3), readings)
        return rows[..., 0], self._expanded(rows[..., 1:], first)

    def _mean(self, values: FloatArray) -> FloatArray:
        """Return the mean (M, 3, …) of values (M, K, 3, …) of the sensors, weighted by their precision."""
        weights = self.data.noise_T[0] ** -2.0
        return np.asarray(np.tensordot(weights / weights.sum(), values, (0, 1)))

    def _whitened(self, stacked: FloatArray, field: FloatArray) -> FloatArray:
        """Return rows (M, 3 K - 2, C) of unit noise: the mean along the field, then the differences."""
        data, count = self.data, len(self.data.time_s)
        unit = stacked / data.noise_T[..., None, None]
        mixed = (self._contrasts @ unit.reshape(*unit.shape[:2], -1)).reshape(unit.shape)
        mean = self._mean(field)
        axis = mean / norm(mean, axis=1, keepdims=True)
        first = axis[:, None] @ mixed[:, 0]
        others = mixed[:, 1:].reshape(count, -1, stacked.shape[3])
        crossed = np.cross(axis[:, None], field - mean[:, None]) / data.noise_T[..., None]
        turned = (self._contrasts[1:] @ crossed).reshape(count, -1) * data.white_attitude[:, None]
        square = np.sum(turned**2, axis=1)
        shrink = (1 - 1 / np.sqrt(1 + square)) / np.maximum(square, 1e-30)
        along = (turned * shrink[:, None])[:, None] @ others
        return np.concatenate([first, others - turned[..., None] * along], axis=1)

    def _expanded(self, local: FloatArray, first: int) -> FloatArray:
        """Return derivatives (M, 3 K - 2, P) by all unknowns from those by what they make at each moment.

        Those by the first unknowns, dipoles and errors of the calibration, are the same.
        """
        same, by_shift, by_turn, others = np.split(local, (first, first + 3, first + 6), axis=2)
        about = by_turn @ self.data.direction[..., None]
        columns = np.moveaxis(np.concatenate([by_shift, by_turn, about, others], axis=2), 2, 0)
        edges = self.edges + first - self.edges[0]
        expanded = np.empty((*local.shape[:2], edges[-1]))
        expanded[..., :first] = same
        for column, basis, (low, high) in zip(columns, self.bases, pairwise(edges.tolist()), strict=True):
            np.multiply(column[..., None], basis[:, None], out=expanded[..., low:high])
        return expanded


def _applied(rotation: Rotation, vectors: FloatArray) -> FloatArray:
    """Return vectors (M, K, 3) turned by the rotations (M,) of their moments."""
    return np.asarray(np.einsum("nij,nkj->nki", rotation.as_matrix(), vectors))
