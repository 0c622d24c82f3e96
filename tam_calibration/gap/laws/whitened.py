"""The whitened residual of a recording, and what a disturbance of its rows does to it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.least_squares import whitening
from tam_calibration.effects.covariates import to_world
from tam_calibration.gap.floor import white_variance
from tam_calibration.gap.laws.evidence import Products
from tam_calibration.gap.model import Model
from tam_calibration.gap.regressors import turns
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.units import FloatArray, IntArray

_LAST_SEEN: "WeakKeyDictionary[Response, dict[tuple[int, ...], Any]]" = WeakKeyDictionary()
_LAST_SCORES: "WeakKeyDictionary[Residual, dict[tuple[int, ...], Any]]" = WeakKeyDictionary()
"""By rows, what is seen of them and their products with the residual: of the last one alone, as these are large."""


@dataclass(frozen=True, eq=False)
class Response:
    """What N samples in C channels see of the R rows, and of the p nominal parameters.

    A nominal parameter shifts a row, or a component of the field in the world, by one or by a component of the field.
    Its change of the channels is a product of both, and is not stored.

    Parameters
    ----------
    shifts : (N, C, R + w) array
        Change of the residual by a shift of each row, in units of the row's own noise, and of components of the field.
    factors : (N, 4) array
        One, and the field in the array's frame.
    parameters : (p,) array
        The nominal parameters among the products of shifts and factors, in the order of shifts.
    turn : (p, q) array
        To those q combinations of the parameters whose changes are orthonormal in the samples that count.
    """

    shifts: FloatArray
    factors: FloatArray
    parameters: NDArray[np.intp]
    turn: FloatArray

    @classmethod
    def of(cls, shifts: FloatArray, factors: FloatArray, parameters: NDArray[np.intp]) -> "Response":
        """Return the response in which every sample that sees a shift counts."""
        # The information of a sample on products is that on its shifts times the products of its factors.
        count, width, each = len(shifts), shifts.shape[2], factors.shape[1]
        of_shifts = (np.swapaxes(shifts, 1, 2) @ shifts).reshape(count, -1)
        of_factors = (factors[:, :, None] * factors[:, None]).reshape(count, -1)
        products = (of_shifts.T @ of_factors).reshape(width, width, each, each).transpose(0, 2, 1, 3)
        information = products.reshape(width * each, -1)[np.ix_(parameters, parameters)]
        return cls(shifts, factors, parameters, whitening(information, 1e-9))

    def cross(self, turned: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the products (N, r, m) of responses (N, r, C) with changes by nominal parameters, and their turn."""
        each = self.factors.shape[1]
        used = np.unique(self.parameters // each)
        seen, basis = np.take(turned @ self.shifts, used, axis=2), np.eye(self.shifts.shape[2])[:, used]
        if seen.shape[1] <= 3:  # a sensor sees few combinations of all shifts
            flat = seen.reshape(-1, len(used))
            size, directions = np.linalg.eigh(flat.T @ flat)
            directions = directions[:, size > 1e-13 * size[-1]]
            seen, basis = seen @ directions, basis @ directions
        products = np.einsum("nrm,nf->nrmf", seen, self.factors).reshape(*seen.shape[:2], -1)
        of_products = np.kron(basis.T, np.eye(each))[:, self.parameters] @ self.turn
        return products, np.linalg.qr(of_products.T)[1].T

    def explained(self, signal: FloatArray, where: "Response") -> FloatArray:
        """Return what nominal parameters that are fitted to a signal (N, C) change in the samples of another one."""
        score = (signal[:, None] @ self.shifts)[:, 0].T @ self.factors
        of_products = np.zeros(score.size)
        of_products[self.parameters] = self.turn @ (self.turn.T @ score.ravel()[self.parameters])
        of_shifts = self.factors @ of_products.reshape(score.shape).T
        return np.asarray((where.shifts @ of_shifts[:, :, None])[:, :, 0])


@dataclass(frozen=True, eq=False)
class Residual:
    """The residual of N samples in C whitened channels, and their motion; R = 3K + 1 rows, the last is the scalar.

    Parameters
    ----------
    model : Model
        That leaves it.
    time_s : (N,) array
        Time stamps, seconds.
    z : (N, C) array
        Whitened residual, without the part that the nominal parameters explain.
    seen : Response
        What the channels see of the rows and of the nominal parameters.
    field, rate : (N, 3) array
        Direction of the field in the array's frame, and its rate of change in units of its own size.
    matrix : (3K, 3) array
        From the field to what each axis senses.
    rotation : (N, 3, 3) array, optional
        From the array's frame to the world.
    turning : (N, 3) array
        Rate of turning in the array's frame, in units of its root mean square; without attitude that of the field.
    channels : dict
        Recorded channels by name, standardised.
    unit_T : float
        Unit of a row's shift, tesla.
    field_T : float
        Mean length of the field, tesla.
    own : (N, 3K) array
        Readings without bias, in units of the field.
    live : (N,) array of bool
        Which samples count.
    index : (N,) array
        Which samples of the recording these are.
    noise : float
        Variance of the recording's noise in units of the one that is reckoned with.
    """

    model: Model
    time_s: FloatArray
    z: FloatArray
    seen: Response
    field: FloatArray
    rate: FloatArray
    matrix: FloatArray
    rotation: FloatArray | None
    turning: FloatArray
    channels: dict[str, FloatArray]
    unit_T: float
    field_T: float
    own: FloatArray
    live: NDArray[np.bool_]
    index: NDArray[np.intp]
    noise: float = 1.0

    @property
    def response(self) -> FloatArray:
        """(N, C, R) change of the residual by a shift of each row."""
        return self.seen.shifts[:, :, : len(self.matrix) + 1]

    @property
    def count(self) -> int:
        """Number of samples N."""
        return int(self.z.shape[0])

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""
        return len(self.matrix) // 3

    @property
    def sensed(self) -> FloatArray:
        """(N, 3K) what each axis senses of a field of length one."""
        return self.field @ self.matrix.T

    @property
    def sensed_rate(self) -> FloatArray:
        """(N, 3K) its rate of change."""
        return self.rate @ self.matrix.T

    @property
    def up(self) -> FloatArray | None:
        """(N, 3) direction upwards in the array's frame, where the attitude is known."""
        return None if self.rotation is None else self.rotation[:, 2]

    @property
    def pose(self) -> FloatArray:
        """Axes of the array in the world (N, 9), or without attitude the direction of the field in the array (N, 3)."""
        return self.field if self.rotation is None else self.rotation.reshape(self.count, 9)

    def of_field(self) -> Products:
        """Return the same as ``of_rows`` for shifts (3,) of the field at all sensors."""
        return self._seen((), lambda: self.response[:, :, :-1] @ self.matrix)

    def of_rows(self, rows: NDArray[np.intp]) -> Products:
        """Return the products of the responses to some rows, the nominal parameters being the nuisance.

        Parameters
        ----------
        rows : (r,) array
        """
        if len(rows) == 1 and rows[0] < 3 * self.sensor_count:
            sensor, axis = divmod(int(rows[0]), 3)
            return self.of_rows(3 * sensor + np.arange(3)).part(slice(axis, axis + 1))
        return self._seen(tuple(rows.tolist()), lambda: self.response[:, :, rows])

    def _seen(self, key: tuple[int, ...], response: Callable[[], FloatArray]) -> Products:
        """Return what is seen by a response (N, C, r); as it is large, only that of the last residual is kept."""
        seen, scores = _of_last(_LAST_SEEN, self.seen), _of_last(_LAST_SCORES, self)
        if key not in seen:
            turned: FloatArray = np.ascontiguousarray(np.swapaxes(response(), 1, 2))
            seen[key] = turned, turned @ np.swapaxes(turned, 1, 2), *self.seen.cross(turned)
        turned, information, cross, turn = seen[key]
        if key not in scores:
            scores[key] = turned @ self.z[:, :, None]
        return Products(information, scores[key], cross, turn)

    @property
    def excess(self) -> float:
        """Energy beyond that of noise."""
        return float((self.z**2).sum() - self.noise * (self.size - self.seen.turn.shape[1]))

    @property
    def size(self) -> int:
        """Number of values of the channels that count."""
        return int(self.live.sum() * self.z.shape[1])

    @property
    def white(self) -> float:
        """Variance of the white noise along the noisiest row that is certain, at least one."""
        response = self.response[self.live]
        size = np.sqrt((response**2).sum(axis=1))
        score = np.einsum("ncr,nc->nr", response, self.z[self.live])
        known = size.mean(axis=0) > 0
        along = score[:, known] / np.maximum(size[:, known], 1e-12 * size.max())
        found = [white_variance(one[:, None]) for one in along.T]
        return max(1.0, *(variance - 2 * error for variance, error in found))

    def without(self, signal: FloatArray) -> "Residual":
        """Return the residual without a signal (N, C), and without what the nominal parameters explain of the rest."""
        return replace(self, z=self.clear(self.z - signal))

    def clear(self, signal: FloatArray) -> FloatArray:
        """Return a signal (N, C) in the samples that count, without what the nominal parameters explain of it."""
        return signal * self.live[:, None] - self.seen.explained(signal, self.seen)

    def taking(self, chosen: NDArray[np.bool_]) -> "Residual":
        """Return the residual with the samples that are not chosen (N,) of bool left out of every sum."""
        live = self.live & chosen
        if live.sum() == self.live.sum():
            return self
        seen = Response.of(self.seen.shifts * live[:, None, None], self.seen.factors, self.seen.parameters)
        part = replace(self, seen=seen, live=live)
        return replace(part, z=part.clear(self.z))

    def scaled(self, factor: float) -> "Residual":
        """Return the residual in units of a noise that is larger by a factor."""
        seen = replace(self.seen, shifts=self.seen.shifts / factor, turn=self.seen.turn * factor)
        return replace(self, z=self.z / factor, seen=seen, noise=self.noise / factor**2)


def _of_last(kept: "WeakKeyDictionary[Any, dict[tuple[int, ...], Any]]", key: Any) -> dict[tuple[int, ...], Any]:
    """Return what is kept of a residual or its response, and forget what is kept of another."""
    if key not in kept:
        kept.clear()
        kept[key] = {}
    return kept[key]


def residual_of(model: Model) -> Residual:
    """Return the residual of a model at the samples that count, every so many of a long recording."""
    channels = model.base().channels
    covariates = channels.covariates
    index = np.flatnonzero(channels.is_counted)
    index = index[:: -(-len(index) // 6500)]  # in fewer, fast motion is not resolved
    z, response = _channels(channels, index)
    size = np.sqrt(np.mean(np.sum(response[:, :, :-1] ** 2, axis=1)))
    row_T = 1 / float(size)
    response = response * row_T
    unit_T = float(np.mean(covariates.intensity_T))
    field_T = covariates.field_T[index]
    # The length of the field holds errors of the scalar, the direction does not.
    unit = field_T / np.linalg.norm(field_T, axis=1, keepdims=True)
    rate = covariates.rate_T_per_s[index] / unit_T
    rate = _of_unit_size(rate - unit * (unit * rate).sum(axis=1, keepdims=True))
    matrix = covariates.errors.matrix.reshape(-1, 3)
    factors = np.column_stack([np.ones(len(index)), field_T / unit_T])
    parameters = np.arange(len(matrix) * factors.shape[1])
    rotation = None if covariates.attitude is None else to_world(covariates)
    if covariates.follows_attitude and covariates.attitude is not None:
        world = turns(covariates.attitude)[index]
        in_rows: FloatArray = matrix @ world
        parameters = np.append(parameters, (response.shape[2] + np.arange(3)) * factors.shape[1])
        response = np.concatenate([response, response[:, :, :-1] @ in_rows], axis=2)
    further = {"temperature": covariates.temperature_C, "current": covariates.current_A, **covariates.further}
    named = {name: values[index] for name, values in further.items() if values is not None}
    standard = {name: (one - one.mean()) / one.std() for name, one in named.items() if one.std() > 0}
    own = (model.recording.readings_T[index] - covariates.errors.bias_T).reshape(len(index), -1) / unit_T
    residual = Residual(
        model,
        covariates.time_s[index],
        z,
        Response.of(response, factors, parameters),
        unit,
        rate,
        matrix,
        None if rotation is None else rotation[index],
        rate if rotation is None else _turning(rotation, covariates.time_s)[index],
        standard,
        row_T,
        unit_T,
        own,
        np.ones(len(index), dtype=bool),
        index,
    )
    return replace(residual, z=residual.clear(z))


def _channels(channels: WhitenedChannels, index: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the channels (N, C) at some samples in units of their noise, and their response (N, C, R) to the rows."""
    residuals = channels.residuals
    differential = np.vstack([channels.directions, 0 * channels.directions[:1]]).T
    of_sample = np.broadcast_to(differential, (len(index), *differential.shape))
    response = np.concatenate([of_sample, residuals.row_slope[index, None]], axis=1)
    z = np.column_stack([residuals.differential, np.nan_to_num(residuals.common_mode)])[index]
    known = np.abs(response).max(axis=(0, 2)) > 0
    response, z = response[:, known], z[:, known]
    level = _levels(z, len(channels.directions.T))
    return z / level, response / level[:, None]


def _of_unit_size(vectors: FloatArray) -> FloatArray:
    """Return vectors (N, 3) in units of their root mean square."""
    return np.asarray(vectors / max(float(np.sqrt(np.mean(np.sum(vectors**2, axis=1)))), 1e-12))


def _levels(z: FloatArray, differential: int) -> FloatArray:
    """Return the white noise of each channel from differences, within what data sheets are off, of unit expectation."""
    level = np.ones(z.shape[1])
    for part in (slice(differential), slice(differential, None)):
        variance, _ = white_variance(z[:, part])
        if variance > 0:
            level[part] = np.clip(np.sqrt(variance), 0.85, 1.15)  # data sheets are off by so much
    return level


def _turning(rotation: FloatArray, time_s: FloatArray) -> FloatArray:
    """Return the rate of turning (N, 3) in the array's frame, in units of its root mean square."""
    change = np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]
    turn = (change - np.swapaxes(change, 1, 2))[:, [2, 0, 1], [1, 2, 0]] / 2
    rate = turn / np.diff(time_s)[:, None]
    return _of_unit_size(np.vstack([rate[:1], (rate[1:] + rate[:-1]) / 2, rate[-1:]]))
