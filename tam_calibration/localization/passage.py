"""The readings of an array that passes sources, as a problem of least squares with an error of the attitude each time.

In the world the field is that of S sources at rest and a regional field u + G x, G symmetric without trace. At time t
the array's centre is at p = path + t δv, δv the error of the velocity by which the path was reckoned, and its axes are
those of the reported attitude R turned by a small ω:

    f_k = Qᵀ (Σ b(p + Q r_k - p_s, m_s) + u + G (p + Q r_k)),    Q = R exp([ω]×),
    ∂f_k/∂ω = [f_k]× - Qᵀ (Σ ∇b + G) Q [r_k]×.

Readings that a calibration has corrected also hold its errors, the same z in all samples: f_k + E_k z, where z are
independent unknowns of standard deviation one (``calibration_errors``).

The ω of a sample is a nuisance of three numbers of known size. It is found anew for every value of the other unknowns,
and these' derivatives are taken at right angles to its own (variable projection after Kaufman 1975), so that nothing
is left out of second order in ω: 0.1° to the second order are 0.15 nT in 50 µT.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Solution, solve_damped
from tam_calibration.localization.source_problem import Kernel
from tam_calibration.model.array import UNIT_TENSORS, Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.poses import Poses

OF_SOURCE = 6
"""Unknowns of a source: its place and its moment."""

UNIFORM, GRADIENT, VELOCITY, ERRORS = slice(0, 3), slice(3, 8), slice(8, 11), slice(11, None)
"""What the further unknowns are: u [T], G's components xx, xy, xz, yy and yz [T/m], δv [m/s], and z."""

_TURNS, _TURNED = 3, 1e-3
"""Steps to the error of an attitude, and the size of the last one, in units of the error's size: each step leaves about
the square of what the last one left, of radians."""

_FARTHEST_TURN = 10.0
"""In units of its size: an error of the attitude that is larger belongs to unknowns that are far off."""

SETTLED = 1e-9
"""Part of a place, and of a moment, below which a step is the last."""

_MOST_STALLED = 10
"""Steps in a row that hardly lower χ² and still do not end a fit: damping rises tenfold with each that does not."""


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of the further unknowns before the readings are looked at.

    Parameters
    ----------
    expected : (11 + Q,) array
        u [T], the components xx, xy, xz, yy and yz of G [T/m], δv [m/s], and z.
    standard_error : (11 + Q,) array
        Infinite where nothing is known, zero where the value is exact.
    """

    expected: FloatArray
    standard_error: FloatArray

    @property
    def is_free(self) -> np.ndarray:
        """(11 + Q,) which of them are unknown."""
        return self.standard_error > 0

    @property
    def is_uncertain(self) -> np.ndarray:
        """(11 + Q,) of which of them something is known, but not all."""
        return self.is_free & np.isfinite(self.standard_error)

    def with_errors(self, count: int) -> "Known":
        """Return the same with so many errors z of a calibration, of mean zero and standard deviation one."""
        return Known(np.append(self.expected, np.zeros(count)), np.append(self.standard_error, np.ones(count)))


@dataclass(frozen=True, eq=False)
class Passage:
    """The readings of N samples, and what is known beside them.

    Parameters
    ----------
    kernel : Kernel
        The field of a source.
    readings_T : (N, K, 3) array
        Calibrated, array frame, tesla.
    array : Array
        Places of the sensors.
    noise_T : (K,) array
        Standard deviation of the noise of each sensor's axes, tesla.
    matrix : (N, 3, 3) array
        Reported rotations from the array frame to the world.
    path_m : (N, 3) array
        Reckoned places of the array's centre in the world, metres.
    time_s : (N,) array
        Since the path began, seconds.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    known : Known
        What is known of the further unknowns.
    errors_T : (N, 3 K, Q) array, optional
        What each error z of the calibration adds to the readings, tesla.
    """

    kernel: Kernel
    readings_T: FloatArray
    array: Array
    noise_T: FloatArray
    matrix: FloatArray
    path_m: FloatArray
    time_s: FloatArray
    attitude_noise: float
    known: Known
    errors_T: FloatArray | None = None

    @property
    def data(self) -> FloatArray:
        """(D,) whitened readings, for each sample an attitude's error of zero, and what is known beforehand."""
        own = (self.readings_T / self.noise_T[:, None]).reshape(len(self.readings_T), -1)
        turns = np.zeros((len(own), 3 if self.attitude_noise else 0))
        at = self.known.is_uncertain
        expected = self.known.expected[at] / self.known.standard_error[at]
        return np.concatenate([np.hstack([own, turns]).ravel(), expected])

    @property
    def degrees_of_freedom(self) -> int:
        """Number of readings and of what is known beforehand, less that of the further unknowns."""
        return self.readings_T.size + int(self.known.is_uncertain.sum() - self.known.is_free.sum())

    def coarse(self, factor: float, most_samples: int) -> "Passage":
        """Return the passage with a noise that is larger by a factor, and no more samples than so many.

        Parameters
        ----------
        factor : float
            By which the noise is larger.
        most_samples : int
            Of more, evenly spaced ones are taken.
        """
        count = len(self.matrix)
        at = np.linspace(0, count - 1, min(count, most_samples)).round().astype(int)
        return replace(
            self,
            noise_T=factor * self.noise_T,
            readings_T=self.readings_T[at],
            matrix=self.matrix[at],
            path_m=self.path_m[at],
            time_s=self.time_s[at],
            errors_T=None if self.errors_T is None else self.errors_T[at],
        )

    def further(self, unknowns: FloatArray) -> FloatArray:
        """Return u, G, δv and z (11 + Q,) of unknowns (P,): those of all sources, and what is free of these."""
        full: FloatArray = self.known.expected.copy()
        free = self.known.is_free
        full[free] = unknowns[len(unknowns) - int(free.sum()) :]
        return full

    def sources(self, unknowns: FloatArray) -> FloatArray:
        """Return the places and moments (S, 6) of unknowns (P,)."""
        return unknowns[: len(unknowns) - int(self.known.is_free.sum())].reshape(-1, OF_SOURCE)

    def center_m(self, unknowns: FloatArray) -> FloatArray:
        """Return the places (N, 3) of the array's centre in the world, metres."""
        return self.path_m + np.outer(self.time_s, self.further(unknowns)[VELOCITY])

    def left_T(self, unknowns: FloatArray) -> FloatArray:
        """Return the readings (N, K, 3) less what unknowns make at the reported attitudes, array frame, tesla."""
        field, _, _ = self._fields(unknowns, np.zeros((len(self.matrix), 3)))
        return self.readings_T - field.reshape(self.readings_T.shape) * self.noise_T[:, None]

    def turns(self, unknowns: FloatArray, near: FloatArray | None = None) -> FloatArray:
        """Return the errors (N, 3) of the attitudes that explain most beside some unknowns, in units of their size.

        They are sought from those near by, which speeds it up, or from zero.
        """
        is_near = near is not None and np.abs(near).max() < _FARTHEST_TURN
        turn = near if near is not None and is_near else np.zeros((len(self.matrix), 3))
        for _ in range(_TURNS if self.attitude_noise else 0):
            step = self._step(turn, *self._fields(unknowns, turn)[:2])
            turn = turn + step
            if np.abs(step).max() < _TURNED:
                break
        return turn

    def whitened(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residuals (N, 3 K) and the derivatives (N, 3 K, P) without those by the attitudes' errors.

        Of each sample the readings' noise and the attitude's error are one covariance 1 + C Cᵀ, by whose symmetric
        root both are divided: white residuals that are continuous in time, each sensor's three along the world's axes.
        """
        turn = self.turns(unknowns)
        field, by_turn, slopes = self._fields(unknowns, turn, with_slopes=True)
        residual = (self.readings_T / self.noise_T[:, None]).reshape(field.shape) - field
        parts = np.concatenate([residual[..., None], slopes], axis=2)
        if self.attitude_noise:
            parts[..., 0] += (by_turn @ turn[..., None])[..., 0]
        world = self._whitening(by_turn) @ parts
        return world[..., 0], world[..., 1:]

    def unturned(self, unknowns: FloatArray) -> FloatArray:
        """Return the part of the residuals (N, 3 K), over the noise, that no error of an attitude can make.

        Of each sample 3 K numbers less those that the attitude's error takes are free.
        """
        turn = self.turns(unknowns)
        field, by_turn, _ = self._fields(unknowns, turn)
        residual = (self.readings_T / self.noise_T[:, None]).reshape(field.shape) - field
        basis = np.linalg.qr(by_turn)[0]
        return np.asarray(residual - (basis @ (np.swapaxes(basis, 1, 2) @ residual[..., None]))[..., 0])

    def seen(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where the sensors are (N, K, 3) in the world, and what makes whitened data of the fields there.

        Parameters
        ----------
        unknowns : (P,) array
            Places and moments of the sources, and what is free of u, G, δv and z.

        Returns
        -------
        points : (N, K, 3) array
            Metres.
        weights : (N, 3 K, 3 K) array
            From stacked fields in the world, tesla, to the data that ``whitened`` has.
        """
        turn = self.turns(unknowns)
        _, by_turn, _ = self._fields(unknowns, turn)
        rotation = self._rotation(turn)
        by_sensor = self._whitening(by_turn).reshape(len(turn), -1, len(self.noise_T), 3)
        weights = np.einsum("nakj,nij->naki", by_sensor, rotation) / self.noise_T[:, None]
        return self._points(unknowns, rotation), weights.reshape(len(turn), by_sensor.shape[1], -1)

    def predict(self, unknowns: FloatArray, turn: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the data (D,) and their derivatives (D, P), from which those along errors of the attitude are taken.

        Parameters
        ----------
        unknowns : (P,) array
            Places and moments of the sources, and what is free of u, G, δv and z.
        turn : (N, 3) array, optional
            What ``turns`` returns for them.
        """
        turn = self.turns(unknowns) if turn is None else turn
        field, by_turn, slopes = self._fields(unknowns, turn, with_slopes=True)
        if self.attitude_noise:
            field, slopes = np.hstack([field, turn]), self._across(by_turn, slopes)
        known, free = self.known, self.known.is_free
        rows = (np.eye(len(free)) / np.where(known.is_uncertain, known.standard_error, 1.0)[:, None])[
            known.is_uncertain
        ]
        of_known = np.hstack([np.zeros((len(rows), slopes.shape[2] - int(free.sum()))), rows[:, free]])
        data = np.concatenate([field.ravel(), rows @ self.further(unknowns)])
        return data, np.concatenate([slopes.reshape(-1, slopes.shape[2]), of_known])

    def _whitening(self, by_turn: FloatArray) -> FloatArray:
        """Return what makes white data (N, 3 K, 3 K) along the world's axes of the whitened readings."""
        root = np.broadcast_to(np.eye(3 * len(self.noise_T)), (len(self.matrix), *[3 * len(self.noise_T)] * 2))
        if self.attitude_noise:
            values, vectors = np.linalg.eigh(root + by_turn @ np.swapaxes(by_turn, 1, 2))
            root = (vectors / np.sqrt(values)[:, None]) @ np.swapaxes(vectors, 1, 2)
        sensors = root.reshape(len(root), -1, 3, root.shape[2])
        return (self.matrix[:, None] @ sensors).reshape(root.shape)

    def _rotation(self, turn: FloatArray) -> FloatArray:
        """Return the rotations Q (N, 3, 3) from the array frame to the world for errors (N, 3) of the attitudes."""
        from scipy.spatial.transform import Rotation

        return np.asarray(self.matrix @ Rotation.from_rotvec(self.attitude_noise * turn).as_matrix())

    def _points(self, unknowns: FloatArray, rotation: FloatArray) -> FloatArray:
        """Return the places (N, K, 3) of the sensors in the world, metres."""
        return self.center_m(unknowns)[:, None] + self.array.positions_m @ np.swapaxes(rotation, 1, 2)

    def _step(self, turn: FloatArray, field: FloatArray, by_turn: FloatArray) -> FloatArray:
        """Return the step (N, 3) of the attitudes' errors, in units of their size, towards the readings (N, 3 K)."""
        readings = (self.readings_T / self.noise_T[:, None]).reshape(len(turn), -1)
        turned = np.swapaxes(by_turn, 1, 2)
        slope = (turned @ (readings - field)[..., None])[..., 0] - turn
        return np.linalg.solve(turned @ by_turn + np.eye(3), slope[..., None])[..., 0]

    @staticmethod
    def _across(by_turn: FloatArray, slopes: FloatArray) -> FloatArray:
        """Return derivatives (N, 3 K + 3, P) less their part along those (N, 3 K, 3) by the attitudes' errors."""
        turned = np.swapaxes(by_turn, 1, 2)
        # No eigenvalue of these matrices is below one, so that inverting them loses nothing.
        along = np.linalg.inv(turned @ by_turn + np.eye(3)) @ (turned @ slopes)
        return np.concatenate([slopes - by_turn @ along, -along], axis=1)

    def _fields(
        self, unknowns: FloatArray, turn: FloatArray, with_slopes: bool = False
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the whitened fields (N, 3 K), and their derivatives by errors of the attitude and by the unknowns.

        The errors ``turn`` (N, 3) are in units of their size.
        """
        further, sources = self.further(unknowns), self.sources(unknowns)
        sources = sources if with_slopes else sources[sources[:, 3:].any(axis=1)]
        rotation = self._rotation(turn)
        points = self._points(unknowns, rotation)
        made = [self.kernel(points - source[:3], source[3:]) for source in sources]
        tensor = np.tensordot(further[GRADIENT], UNIT_TENSORS, 1)
        # Contiguous, else each of their products costs several times as much.
        weights = np.ascontiguousarray(np.swapaxes(rotation, 1, 2)[:, None] / self.noise_T[:, None, None])

        def seen(vectors: FloatArray) -> FloatArray:
            """Whiten vectors (N, K, 3, Q) of the world as the sensors see them."""
            return (weights @ vectors).reshape(len(turn), -1, vectors.shape[-1])

        world: FloatArray = sum((each for each, _, _ in made), further[UNIFORM] + points @ tensor)
        gradient: FloatArray = sum((slope for _, slope, _ in made), np.broadcast_to(tensor, (*points.shape, 3)))
        errors = self._errors()
        field = seen(world[..., None])[..., 0]
        by_turn = np.zeros((*field.shape, 0))
        if self.attitude_noise:
            moved = weights @ gradient @ (rotation[:, None] @ _crossing(self.array.positions_m))
            slopes = _crossing(field.reshape(points.shape)) - moved
            added = self.attitude_noise * _added(self.attitude_noise * turn)
            by_turn = slopes.reshape(len(turn), -1, 3) @ added
        field += errors @ further[ERRORS]
        if not with_slopes:
            return field, by_turn, np.zeros((0, 0, 0))
        by_source = [part for _, slope, by_moment in made for part in (-slope, by_moment)]
        everywhere = np.broadcast_to(np.eye(3), (*points.shape, 3))
        by_tensor = np.einsum("qij,nkj->nkiq", UNIT_TENSORS, points)
        by_velocity = self.time_s[:, None, None, None] * gradient
        by_further = np.concatenate([everywhere, by_tensor, by_velocity], axis=-1)
        by_further = by_further[..., self.known.is_free[: VELOCITY.stop]]
        by_unknowns = seen(np.concatenate([*by_source, by_further], axis=-1))
        return field, by_turn, np.concatenate([by_unknowns, errors], axis=-1)

    def _errors(self) -> FloatArray:
        """Return what errors of the calibration add to the whitened readings (N, 3 K, Q)."""
        if self.errors_T is None:
            return np.zeros((len(self.matrix), 3 * len(self.noise_T), 0))
        return self.errors_T / np.repeat(self.noise_T, 3)[:, None]


def passage_of(
    kernel: Kernel,
    fields_T: FloatArray,
    array: Array,
    poses: Poses,
    known: Known,
    time_s: FloatArray | None = None,
    errors_T: FloatArray | None = None,
) -> Passage:
    """Return the readings as a problem of least squares.

    Parameters
    ----------
    kernel : Kernel
        The field of a source.
    fields_T : (N, K, 3) array
        Calibrated readings of each pose, array frame, tesla.
    array : Array
        Positions and noise of the sensors; a noise that is not stated is taken as one tesla.
    poses : Poses
        Of the array.
    known : Known
        What is known of the field beside the sources', and of the velocity.
    time_s : (N,) array, optional
        Since the poses were reckoned by a velocity, seconds.
    errors_T : (N, 3 K, Q) array, optional
        What errors of the calibration add to the readings, tesla: see ``calibration_errors.errors_of``.

    Raises
    ------
    InputError
        When a shape is wrong, values are not finite, or the axes of the array are known to sit in different places.
    Refused
        When there are fewer values than unknowns of one source, or the array has no gradient to start from.
    """
    readings, stated = _check(fields_T, array, poses), array.vector_noise_T
    noise = np.ones(array.sensor_count) if stated is None else stated
    times = np.zeros(len(readings)) if time_s is None else time_s
    if errors_T is not None:
        known = known.with_errors(errors_T.shape[2])
    passage = Passage(
        kernel, readings, array, noise, poses.matrix, poses.position_m, times, poses.attitude_noise, known, errors_T
    )
    lacking = OF_SOURCE - passage.degrees_of_freedom
    if lacking > 0:
        values = readings.size
        raise Refused(f"{values} values do not determine {values + lacking} unknowns: use more sensors or poses")
    if not array.has_gradient:
        raise Refused("the array's geometry determines no gradient, so that the fit has nowhere to start")
    return passage


def _check(fields_T: FloatArray, array: Array, poses: Poses) -> FloatArray:
    if array.axis_offsets_m is not None:
        raise InputError("the axes of a sensor must be in one place to fit a track: locate from field and gradient")
    fields = np.asarray(fields_T, dtype=float)
    shape = (len(poses.attitude), array.sensor_count, 3)
    if fields.shape != shape:
        raise InputError(f"the fields must have the shape {shape} of poses and sensors, not {fields.shape}")
    if not np.isfinite(fields).all():
        raise InputError("a field is not finite: leave out that sample")
    return fields


def _crossing(vectors: FloatArray) -> FloatArray:
    """Return the matrices [v]× (…, 3, 3) of vectors (…, 3): [v]× w = v × w."""
    matrices = np.zeros((*vectors.shape, 3))
    for first, second, third in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrices[..., second, third] = -vectors[..., first]
        matrices[..., third, second] = vectors[..., first]
    return matrices


def _added(turns: FloatArray) -> FloatArray:
    """Return the derivatives (N, 3, 3) of what follows rotation vectors (N, 3) by what is added to them: 1 at zero."""
    angle = norm(turns, axis=1)[:, None, None]
    cross = _crossing(turns)
    cubic = (1 - np.sinc(angle / np.pi)) / np.where(angle > 0, angle, 1.0) ** 2
    return np.asarray(np.eye(3) - np.sinc(angle / (2 * np.pi)) ** 2 / 2 * cross + cubic * cross @ cross)


def solve(passage: Passage, start: FloatArray, smallest_step: float = SETTLED, least_fall: float = 0.0) -> Solution:
    """Return the solution of a passage: one problem.

    Parameters
    ----------
    passage : Passage
        What was read.
    start : (P,) array
        Places and moments of the sources, and what is free of u, G, δv and z.
    smallest_step : float
        Part of a place, and of a moment, below which a step is the last.
    least_fall : float
        Part of χ² by which ten steps must lower it, or they are the last.
    """
    turn: FloatArray = np.zeros((len(passage.matrix), 3))
    own, lowest, stalled = passage.data, np.inf, 0

    def predict(unknowns: FloatArray, at: np.ndarray) -> tuple[FloatArray, FloatArray]:
        nonlocal turn, lowest, stalled
        turn = passage.turns(unknowns[0], turn)
        data, slopes = passage.predict(unknowns[0], turn)
        chi_square = float(np.sum((own - data) ** 2))
        is_falling = chi_square <= (1 - least_fall) * lowest
        lowest, stalled = (chi_square, 0) if is_falling else (lowest, stalled + 1)
        return data[None], slopes[None]

    def is_small(unknowns: FloatArray, step: FloatArray) -> np.ndarray:
        if least_fall and stalled >= _MOST_STALLED:
            return np.array([True])
        if not passage.sources(unknowns[0]).size:
            return np.array([norm(step) <= smallest_step * norm(unknowns)])
        size, change = (norm(passage.sources(each[0]).reshape(-1, 2, 3), axis=2) for each in (unknowns, step))
        return np.array([(change <= smallest_step * size).all()])

    with np.errstate(over="ignore", invalid="ignore"):  # what a step leads far away makes no field there
        return solve_damped(predict, own[None], start[None], is_small)
