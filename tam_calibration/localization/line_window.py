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
from tam_calibration.sources.dipole import dipole_field, field_by_moment

OF_SOURCE = 6

_REGIONAL_STEP_M, _GRADIENT_STEP_M, _TURN_STEP_S = 25.0, 50.0, 1.5
"""Distances between knots of the regional field, of its gradient, and of the turns about it."""

_BEND_T, _CHANGE_T_PER_M = 20e-9, 2e-9
"""Standard deviations of the second difference of the regional field's knots, and of the change of its gradient."""

_DIRECTION, _GRADIENT_T_PER_M = 3e-3, 1e-6
"""Standard deviations of the regional field, as a part of the median of the readings, and of its gradient, T/m."""


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
        place = self.place_m + np.column_stack(
            [rows @ each for rows, each in zip(self._path_error, moved, strict=True)]
        )
        along = data.direction
        theta = data.attitude_error * turn[:3] + (of_turns @ turn[3:])[:, None] * along
        turned = Rotation.from_rotvec(theta)
        tensor = np.tensordot(of_gradient @ gradient.reshape(5, -1).T, UNIT_TENSORS, 1)
        aside = self._aside_m + place - self.place_m
        uniform = turned.inv().apply(of_regional @ regional.reshape(3, -1).T)
        uniform = uniform + np.einsum("nij,nj->ni", tensor, aside)
        every = np.concatenate([sources, self.fixed])
        at_center = uniform + dipole_field(place[:, None] - every[:, :3], every[:, 3:])[0].sum(axis=1)
        mean = data.fields_T.mean(axis=1)
        align = _shortest(turned.apply(at_center), mean)
        total = align * turned
        arms = _applied(total.inv(), data.arms_m)
        points = place[:, None] + arms
        made, grad, by_moment = dipole_field(points[:, :, None] - every[:, :3], every[:, 3:])
        field = uniform[:, None] + np.einsum("nij,nkj->nki", tensor, arms) + made.sum(axis=2)
        added = (data.errors_T @ calibration).reshape(field.shape)
        residual = (_applied(total.inv(), data.fields_T) - added - field)[..., None]
        if not with_slopes:
            return self._whitened(residual, field)[..., 0], np.zeros((0, 0, 0))
        slope = tensor[:, None] + grad.sum(axis=2)
        by_turn = _by_turn(field - uniform[:, None], slope, arms)
        own = np.concatenate([-grad[:, :, : len(sources)], by_moment[:, :, : len(sources)]], axis=4)
        columns = np.moveaxis(own, 2, 3).reshape(*field.shape, split)
        spread = np.broadcast_to(np.eye(3), (*field.shape, 3))
        by_tensor = np.einsum("qij,nkj->nkiq", UNIT_TENSORS, arms + aside[:, None])
        by_errors = data.errors_T.reshape(*field.shape, -1)
        local = np.concatenate([columns, slope, by_turn, by_errors, spread, by_tensor], axis=3)
        rows = self._whitened(np.concatenate([residual, local], axis=3), field)
        return rows[..., 0], self._expanded(rows[..., 1:], split)

    def _whitened(self, stacked: FloatArray, field: FloatArray) -> FloatArray:
        """Return rows (M, 3 K - 2, C) of unit noise: the mean along the field, then the differences."""
        data, count = self.data, len(self.data.time_s)
        unit = stacked / data.noise_T[..., None, None]
        mixed = np.einsum("lk,nkic->nlic", self._contrasts, unit)
        mean = field.mean(axis=1)
        axis = mean / norm(mean, axis=1, keepdims=True)
        first = np.einsum("ni,nic->nc", axis, mixed[:, 0])[:, None]
        others = mixed[:, 1:].reshape(count, -1, stacked.shape[3])
        crossed = np.cross(axis[:, None], field - mean[:, None]) / data.noise_T[..., None]
        turned = np.einsum("lk,nki->nli", self._contrasts[1:], crossed).reshape(count, -1)
        turned = turned * data.white_attitude[:, None]
        square = np.sum(turned**2, axis=1)
        shrink = (1 - 1 / np.sqrt(1 + square)) / np.maximum(square, 1e-30)
        along = np.einsum("nr,nrc->nc", turned, others) * shrink[:, None]
        others = others - turned[..., None] * along[:, None]
        return np.concatenate([first, others], axis=1)

    def _expanded(self, local: FloatArray, split: int) -> FloatArray:
        """Return derivatives (M, 3 K - 2, P) by all unknowns from those by what they make at each moment."""
        of_regional, of_gradient, of_turns = self.bases
        by_path, by_turn = local[..., split : split + 3], local[..., split + 3 : split + 6]
        errors = self.data.errors_T.shape[2]
        by_errors, rest = local[..., split + 6 : split + 6 + errors], local[..., split + 6 + errors :]
        about = np.einsum("nrj,nj->nr", by_turn, self.data.direction)
        return np.concatenate(
            [
                local[..., :split],
                *[by_path[..., axis, None] * self._path_error[axis][:, None] for axis in range(3)],
                self.data.attitude_error * by_turn,
                about[..., None] * of_turns[:, None],
                by_errors,
                *[rest[..., axis, None] * of_regional[:, None] for axis in range(3)],
                *[rest[..., 3 + number, None] * of_gradient[:, None] for number in range(5)],
            ],
            axis=2,
        )


def _applied(rotation: Rotation, vectors: FloatArray) -> FloatArray:
    """Return vectors (M, K, 3) turned by the rotations (M,) of their moments."""
    return np.asarray(np.einsum("nij,nkj->nki", rotation.as_matrix(), vectors))


def _shortest(start: FloatArray, end: FloatArray) -> Rotation:
    """Return the shortest rotations (M,) from vectors (M, 3) to the directions of others."""
    cross = np.cross(start, end)
    sine, cosine = norm(cross, axis=1), np.sum(start * end, axis=1)
    angle = np.arctan2(sine, cosine)
    return Rotation.from_rotvec(cross * (angle / np.maximum(sine, 1e-300))[:, None])


def _by_turn(field: FloatArray, slope: FloatArray, arms: FloatArray) -> FloatArray:
    """Return derivatives (M, K, 3, 3) of fields beside the regional one by a rotation of the readings."""
    unit = np.eye(3)
    turned = np.stack([np.cross(unit[axis], field) for axis in range(3)], axis=3)
    levers = np.stack([np.cross(unit[axis], arms) for axis in range(3)], axis=3)
    return np.asarray(turned - slope @ levers)
