"""A part of a survey line as one problem of least squares, in which all but the dipoles is marginalised.

In the world the field at sensor k is f_k = u + G a_k + Σ b(p + a_k - p_s, m_s) with arms a_k, a regional field u and a
gradient G, both smooth along the line. The path p errs by a spline of known covariance. The attitude errs by a tilt, by
turns about the regional field of known size, and by whatever turns the mean of the readings: that part is taken off
each sample by the shortest rotation from the expected to the measured mean. Data are the intensity of the mean and the
differences between sensors.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.linalg import norm
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from tam_calibration.localization.line_data import LineData
from tam_calibration.localization.line_path import Basis, Path
from tam_calibration.model.array import UNIT_TENSORS
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import dipole_field, field_alone, field_by_moment

OF_SOURCE = 6

_REGIONAL_STEP_M, _GRADIENT_STEP_M, _TURN_STEP_S = 25.0, 50.0, 1.5
"""Distances between knots of the regional field, of its gradient, and of the turns about it."""

_BEND_T, _CHANGE_T_PER_M = 20e-9, 2e-9
"""Standard deviations of the second difference of the regional field's knots, and of the change of its gradient."""

_DIRECTION, _GRADIENT_T_PER_M = 3e-3, 1e-6
"""Standard deviations of the regional field, as a part of the median of the readings, and of its gradient, T/m."""

_CROSSING = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2).reshape(3, 9)
"""Matrices of the cross product with unit vectors from the left, row by row."""


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
    """

    data: LineData
    path: Path
    fixed: FloatArray
    roughness: float = 1.0

    @cached_property
    def _path_error(self) -> list[FloatArray]:
        """The three (M, n) effects of errors of size one on each coordinate of the path, metres."""
        own, roots = self.path.error(float(self.data.time_s[0]), float(self.data.time_s[-1]))
        rows = self.path.basis.matrix(self.data.time_s)[:, own]
        return [rows @ root for root in roots]

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
    def bases(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(M, n) bases of the regional field, of its gradient, and of the turns."""
        way, times = self.data.along_m, self.data.time_s
        ends = float(way.min()), float(way.max())
        regional = Basis.over(*ends, _REGIONAL_STEP_M).matrix(way)
        gradient = Basis.over(*ends, _GRADIENT_STEP_M).matrix(way)
        turns = Basis.over(float(times[0]), float(times[-1]), _TURN_STEP_S).matrix(times)
        return regional, gradient, self.data.attitude_error * turns

    @cached_property
    def prior(self) -> FloatArray:
        """Root (R, n) of the precision of all unknowns but the dipoles."""
        regional, gradient, turns = (each.shape[1] for each in self.bases)
        size = float(np.median(norm(self.data.fields_T.mean(axis=1), axis=1)))
        level_T = size * np.hypot(self.data.attitude_error, _DIRECTION)
        bend_T, change_T_per_m = self.roughness * _BEND_T, self.roughness * _CHANGE_T_PER_M
        bend = np.vstack([np.diff(np.eye(regional), 2, axis=0) / bend_T, np.eye(regional)[[0, -1]] / level_T])
        change = np.vstack(
            [np.diff(np.eye(gradient), axis=0) / change_T_per_m, np.eye(gradient)[:1] / _GRADIENT_T_PER_M]
        )
        unit = sum(each.shape[1] for each in self._path_error) + turns + 3 + self.data.errors_T.shape[2]
        return np.asarray(block_diag(np.eye(unit), *[bend] * 3, *[change] * 5))

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

    @property
    def nuisance_count(self) -> int:
        """Number of unknowns beside the dipoles."""
        return int(self.prior.shape[1])

    @cached_property
    def _contrasts(self) -> FloatArray:
        """(K, K) rotation of the sensors' whitened readings, whose first row is their mean."""
        inverse = 1 / self.data.noise_T[0]
        matrix = np.column_stack([inverse, np.eye(len(inverse))[:, 1:]])
        rotation = np.linalg.qr(matrix)[0].T
        return np.asarray(rotation * np.sign(rotation[0, 0]))

    def start(self) -> FloatArray:
        """Return the (n,) unknowns of no dipole: the median field and no error."""
        unknowns = np.zeros(self.nuisance_count)
        mean, size = self.data.fields_T.mean(axis=1), self.bases[0].shape[1]
        uniform = np.median(mean / norm(mean, axis=1, keepdims=True), axis=0) * np.median(norm(mean, axis=1))
        unknowns[self.parts[3]] = np.repeat(uniform, size)
        return unknowns

    @cached_property
    def parts(self) -> tuple[slice, ...]:
        """Where the unknowns beside the dipoles are: path, tilt and turns, calibration, regional, gradient."""
        regional, gradient, turns = (each.shape[1] for each in self.bases)
        sizes = [sum(each.shape[1] for each in self._path_error), 3 + turns, self.data.errors_T.shape[2]]
        edges = np.cumsum([0, *sizes, 3 * regional, 5 * gradient])
        return tuple(slice(int(low), int(high)) for low, high in pairwise(edges))

    def linearized(self, unknowns: FloatArray, with_slopes: bool = True) -> tuple[FloatArray, FloatArray]:
        """Return the residuals (M, 3 K - 2), data less model in units of their noise, and the model's derivatives."""
        data = self.data
        split = len(unknowns) - self.nuisance_count
        sources, rest = unknowns[:split].reshape(-1, OF_SOURCE), unknowns[split:]
        path, turn, calibration, regional, gradient = (rest[part] for part in self.parts)
        of_regional, of_gradient, of_turns = self.bases
        moved = np.split(path, np.cumsum([each.shape[1] for each in self._path_error])[:-1])
        shift = np.column_stack([rows @ each for rows, each in zip(self._path_error, moved, strict=True)])
        place, aside = self.place_m + shift, self._aside_m + shift
        theta = data.attitude_error * turn[:3] + (of_turns @ turn[3:])[:, None] * data.direction
        turned = Rotation.from_rotvec(theta)
        tensor = np.tensordot(of_gradient @ gradient.reshape(5, -1).T, UNIT_TENSORS, 1)
        uniform = turned.inv().apply(of_regional @ regional.reshape(3, -1).T)
        every = np.concatenate([sources, self.fixed])
        added = (data.errors_T @ calibration).reshape(data.fields_T.shape)

        def field_at(arms: FloatArray) -> FloatArray:
            points = place[:, None] + arms
            dipoles = field_alone(points[:, :, None] - every[:, :3], every[:, 3:]).sum(axis=2)
            return np.asarray(uniform[:, None] + (aside[:, None] + arms) @ tensor + dipoles + added)

        expected, measured = self._mean(field_at(data.arms_m)), self._mean(data.fields_T)
        total = (_shortest(turned.apply(expected), measured) * turned).inv()
        arms, readings = _applied(total, data.arms_m), _applied(total, data.fields_T)
        residual = (readings - field_at(arms))[..., None]
        if not with_slopes:
            return self._whitened(residual, readings)[..., 0], np.zeros((0, 0, 0))
        made, grad, by_moment = dipole_field((place[:, None] + arms)[:, :, None] - every[:, :3], every[:, 3:])
        slope = tensor[:, None] + grad.sum(axis=2)
        own = np.concatenate([-grad[:, :, : len(sources)], by_moment[:, :, : len(sources)]], axis=4)
        columns = np.moveaxis(own, 2, 3).reshape(*made.shape[:2], 3, split)
        by_turn = np.broadcast_to(_crossing(uniform)[:, None], slope.shape)
        by_regional = np.broadcast_to(turned.inv().as_matrix()[:, None], slope.shape)
        by_tensor = np.einsum("qij,nkj->nkiq", UNIT_TENSORS, arms + aside[:, None])
        by_errors = data.errors_T.reshape(*made.shape[:2], 3, -1)
        local = np.concatenate([columns, slope, by_turn, by_errors, by_regional, by_tensor], axis=3)
        # A change of the expected mean turns the readings and the arms after it.
        turning = _crossing(readings) - slope @ _crossing(arms)
        along = expected / norm(expected, axis=1, keepdims=True)
        meant = turned.inv().apply(measured / norm(measured, axis=1, keepdims=True))
        twist = np.cross(meant, along) / (1 + np.sum(meant * along, axis=1, keepdims=True))
        by_mean = (_crossing(along) - along[:, :, None] * twist[:, None]) / norm(expected, axis=1)[:, None, None]
        turns = by_mean @ self._mean(local)
        by_theta = slice(split + 3, split + 6)
        turns[..., by_theta] -= along[:, :, None] * (along + np.cross(along, twist))[:, None]
        local += turning @ turns[:, None]
        local[..., by_theta] = local[..., by_theta] @ (np.eye(3) - _crossing(theta) / 2)[:, None]
        rows = self._whitened(np.concatenate([residual, local], axis=3), readings)
        return rows[..., 0], self._expanded(rows[..., 1:], split)

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

    def _expanded(self, local: FloatArray, split: int) -> FloatArray:
        """Return derivatives (M, 3 K - 2, P) by all unknowns from those by what they make at each moment."""
        of_regional, of_gradient, of_turns = self.bases
        by_path, by_turn, by_errors, by_regional, by_tensor = np.split(
            local[..., split:], np.cumsum([3, 3, self.data.errors_T.shape[2], 3]), axis=2
        )
        about = np.einsum("nrj,nj->nr", by_turn, self.data.direction)
        expanded = np.empty((*local.shape[:2], split + self.nuisance_count))
        expanded[..., :split] = local[..., :split]
        path, turn, errors, regional, gradient = (
            expanded[..., split + part.start : split + part.stop] for part in self.parts
        )
        of_path = np.split(path, np.cumsum([each.shape[1] for each in self._path_error])[:-1], axis=2)
        for axis in range(3):
            np.multiply(by_path[..., axis, None], self._path_error[axis][:, None], out=of_path[axis])
        np.multiply(self.data.attitude_error, by_turn, out=turn[..., :3])
        np.multiply(about[..., None], of_turns[:, None], out=turn[..., 3:])
        errors[...] = by_errors
        for whole, by, basis in ((regional, by_regional, of_regional), (gradient, by_tensor, of_gradient)):
            for part, own in zip(np.split(whole, by.shape[2], axis=2), np.moveaxis(by, 2, 0), strict=True):
                np.multiply(own[..., None], basis[:, None], out=part)
        return expanded


def _applied(rotation: Rotation, vectors: FloatArray) -> FloatArray:
    """Return vectors (M, K, 3) turned by the rotations (M,) of their moments."""
    return np.asarray(np.einsum("nij,nkj->nki", rotation.as_matrix(), vectors))


def _shortest(start: FloatArray, end: FloatArray) -> Rotation:
    """Return the shortest rotations (M,) from vectors (M, 3) to the directions of others."""
    cross = np.cross(start, end)
    sine, cosine = norm(cross, axis=1), np.sum(start * end, axis=1)
    angle = np.arctan2(sine, cosine)
    return Rotation.from_rotvec(cross * (angle / np.maximum(sine, 1e-300))[:, None])


def _crossing(vectors: FloatArray) -> FloatArray:
    """Return the matrices (…, 3, 3) of the cross product with vectors (…, 3) from the left."""
    return np.asarray((vectors @ _CROSSING).reshape(*vectors.shape, 3))
