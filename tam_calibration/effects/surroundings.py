"""Fields of the surroundings: the gradient of the site's field, and the field of the vehicle itself.

The gradient of the site is uniform in the world and turns in the array frame: at attitude R (array to world) a sensor
at r reads b + Rᵀ G R r, with G symmetric and trace-free in the world. Of the vehicle's field only that part counts that
the errors of the sensors cannot represent.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np

from tam_calibration.core.harmonics import derivatives, fields
from tam_calibration.effects.covariates import LEAST_TURN, jumps, to_world
from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Sized, Term, WhitenedResiduals
from tam_calibration.effects.lags import SLOWER, followed, time_constants_s
from tam_calibration.effects.recursions import mode
from tam_calibration.effects.term import matrix_terms, matrix_units, scalar_term
from tam_calibration.model.array import Array
from tam_calibration.model.fitted_effect import ALL, FittedEffect, Shape
from tam_calibration.model.recording import is_further, unit_of
from tam_calibration.model.units import FloatArray

_LENGTHS = {2: "m", 3: "m²", 4: "m³"}
"""Unit of length by which the derivatives of a potential are per unit of field, by its degree."""


class AmbientGradient(LinearEffect):
    """The field of the site is not uniform; the array turns about its centre, which stays where it is."""

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that all sensors are at the centre or that the array was not turned, where it is so."""
        from scipy.spatial.transform import Rotation

        if not covariates.array.positions_m.any() and not _has_distant_scalar(covariates.array):
            return "all sensors are at the centre of rotation"
        rotation = Rotation.from_quat(covariates.channel("attitude"))
        half = (rotation.mean().inv() * rotation).magnitude() / 2
        turn = 2 * float(np.arcsin(np.sqrt(np.mean(np.sin(half) ** 2))))  # a few attitudes that are wrong count little
        return f"the attitude changes by {turn:.2f} rad only" if turn < LEAST_TURN else None

    def terms(self, covariates: Covariates, shape: Shape) -> Iterator[Term]:
        """Yield the harmonic potentials of degree 2, 3 and 4, by their derivatives in the world at the centre."""
        array = covariates.array
        rotation = np.ascontiguousarray(to_world(covariates).transpose(1, 2, 0))
        places = list(zip(array.positions_m, covariates.errors.matrix[..., None], strict=True))
        if array.scalar_position_m is not None and _has_distant_scalar(array):
            places.append((array.scalar_position_m, covariates.direction.T[None]))
        for degree, length in _LENGTHS.items():
            names = ["".join(np.repeat(list("xyz"), orders)) for orders in derivatives(degree)]
            row_count = sum(len(matrix) for _, matrix in places)
            rows, columns = np.divmod(np.arange(row_count * len(names)), len(names))
            features = np.empty((len(rows), covariates.sample_count))
            stop = 0
            for position, matrix in places:
                start, stop = stop, stop + len(matrix) * len(names)
                features[start:stop] = _signal_at(degree, position, matrix, rotation)
            parts = tuple(Coefficient(f"gradient {name}", f"T/{length}") for name in names)
            yield Term(ALL, None, f"degree {degree}", parts, features.T, rows, columns)
            del features


def _signal_at(degree: int, position_m: FloatArray, matrix: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return the signal of P harmonic potentials of the world in R rows at a position, (R P, N).

    The rows read by a matrix (R, 3, N or 1) in the array frame, which rotations (3, 3, N) turn to the world.
    """
    in_world = fields(degree, np.tensordot(position_m, rotation, axes=(0, 1)))
    reading = np.einsum("rjn,ijn->rin", np.broadcast_to(matrix, (*matrix.shape[:2], rotation.shape[2])), rotation)
    return np.asarray(np.einsum("rin,pin->rpn", reading, in_world).reshape(-1, rotation.shape[2]))


def _has_distant_scalar(array: Array) -> bool:
    return array.scalar_position_m is not None and bool(array.scalar_position_m.any())


_CHANGES = ("gradient", "curvature")
"""Of potentials of the second and third degree: beyond it four sensors tell no law in space."""

_INDUCED = "induced"


class PlatformField(LinearEffect):
    """Eighteen terms at the scalar, the gradient of eddy currents between the sensors, and currents and actuators.

    What a sensor reads of the vehicle's permanent and induced field is a bias and a matrix, which are its own errors
    already; so are those at the scalar, where all sensors have errors: they are calibrated to the field at its place.
    These three and six stand here for simulations and for fits of the scalar alone.
    """

    def needs(self, fitted: FittedEffect) -> tuple[str, ...]:
        """Return the names of the currents and actuators that have a part in a fitted effect."""
        names = (one.term.partition(",")[0] for one in fitted.contributions)
        return tuple(dict.fromkeys(name for name in names if is_further(name) or name == "current_A"))

    def sizes(self, covariates: Covariates, fitted: FittedEffect) -> list[Sized]:
        """Return the sizes of the coefficients, and which part of what conductors do is not that of a gradient."""
        sizes = super().sizes(covariates, fitted)
        law = tuple(one for one in fitted.contributions if one.sensor == ALL)
        if not law:
            return sizes
        part = _part_beyond_gradient(covariates, self.signal(covariates, replace(fitted, contributions=law))[:, :-1])
        beyond = "part beyond the gradient"
        return [*sizes, Sized(beyond, part, self.limits[beyond])]

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that there is no continuous motion, where there is none and no actuator is recorded either."""
        return None if covariates.further else jumps(covariates)

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the time constants of eddy currents; none where the field jumps from pose to pose."""
        if jumps(covariates) is not None:
            return ({},)
        return [{"time_constant_s": constant} for constant in time_constants_s(covariates)[::2]]

    def terms(self, covariates: Covariates, shape: Shape) -> Iterator[Term]:
        """Yield the eighteen terms of the scalar, the gradients of its eddy currents, and what follows each channel.

        The shape has ``time_constant_s`` of the first mode of the eddy currents, seconds; without it there are none.
        """
        permanent = {f"permanent {axis}": "T" for axis in "xyz"}
        yield scalar_term(covariates, "permanent", permanent, covariates.direction)
        yield _induced(covariates, _INDUCED, "")
        if "time_constant_s" in shape:
            late = _followed(covariates, shape["time_constant_s"])
            later = _followed(covariates, SLOWER * shape["time_constant_s"])
            for name, change in (("first mode", covariates.field_T - late), ("slower mode", late - later)):
                along = (covariates.direction[:, :, None] * change[:, None, :]).reshape(len(change), 9)
                yield scalar_term(covariates, name, matrix_units(name), along)
                # Between fewer sensors the field of distant currents differs as that of currents at one of them.
                if covariates.sensor_count >= 4:
                    yield from (_gradient(covariates, name, degree, change) for degree, _ in enumerate(_CHANGES, 2))
        channels = {} if covariates.current_A is None else {"current_A": covariates.current_A}
        for name, values in (channels | dict(covariates.further)).items():
            yield from _of_channel(covariates, name, values[:, None])


def _induced(covariates: Covariates, name: str, prefix: str, part: FloatArray | float = 1.0) -> Term:
    """Return what the field that six elements of a symmetric matrix induce adds to the intensity, or parts of it."""
    pairs = list(combinations_with_replacement(range(3), 2))
    units = {f"{prefix}induced {'xyz'[i]}{'xyz'[j]}": "1" for i, j in pairs}
    direction, field_T = covariates.direction, covariates.field_T
    squares = np.column_stack([direction[:, i] * field_T[:, j] for i, j in pairs])
    return scalar_term(covariates, name, units, squares * part)


def _part_beyond_gradient(covariates: Covariates, rows_T: FloatArray) -> float:
    """Return the part of the energy of the sensors' differences (N, 3K) that no uniform gradient makes."""
    readings = rows_T.reshape(len(rows_T), -1, 3, 1)
    field = np.linalg.solve(covariates.errors.matrix, readings).reshape(rows_T.shape)
    uniform, gradient = (
        fields(degree, covariates.array.positions_m.T).swapaxes(1, 2).reshape(2 * degree + 1, -1) for degree in (1, 2)
    )
    energy, beyond = (
        float(np.sum((field - field @ np.linalg.pinv(basis) @ basis) ** 2))
        for basis in (uniform, np.concatenate([uniform, gradient]))
    )
    return beyond / max(energy, np.finfo(float).tiny)


def _gradient(covariates: Covariates, mode_name: str, degree: int, change_T: FloatArray) -> Term:
    """Return what harmonic potentials of a degree, of the eddy currents of each axis (3), add to the sensors."""
    name, unit = f"{mode_name}, {_CHANGES[degree - 2]}", f"1/{_LENGTHS[degree]}"
    at_sensors = fields(degree, covariates.array.positions_m.T)
    read = np.zeros((len(at_sensors), covariates.scalar_row + 1))
    read[:, :-1] = np.einsum("kij,pjk->pki", covariates.errors.matrix, at_sensors).reshape(len(at_sensors), -1)
    features = np.tile(change_T, len(at_sensors))
    names = ["".join(np.repeat(list("xyz"), orders)) for orders in derivatives(degree)]
    parts = tuple(Coefficient(f"{name} {pair}, {axis} of the field", unit) for pair in names for axis in "xyz")
    return Term(ALL, None, name, parts, features, np.repeat(read, 3, axis=0), np.arange(len(parts)))


def _of_channel(covariates: Covariates, name: str, values: FloatArray) -> Iterator[Term]:
    """Yield the field in proportion to a channel (N, 1), and of an actuator what it makes of the field by its iron."""
    is_current = unit_of(name) == "A"
    units = {f"{name} {axis}": "T/A" if is_current else "T" for axis in "xyz"}
    yield from matrix_terms(covariates, name, units, values)
    yield scalar_term(covariates, name, units, covariates.direction * values)
    if not is_current:
        own = f"{name}, {_INDUCED}"
        yield from matrix_terms(covariates, own, matrix_units(name), covariates.field_T * values)
        yield _induced(covariates, own, f"{name}, ", values)


def _followed(covariates: Covariates, time_constant_s: float) -> FloatArray:
    """Return the field (N, 3) after a first-order lag.

    As samples arrive, its rate of change is the slope of the parabola through a sample and the two before it.
    """
    memory = covariates.memory
    if memory is None:
        return followed(covariates, time_constant_s)
    last_times, last_fields, state = memory.recall((covariates.time_s[:0], covariates.field_T[:0], None))
    time = np.concatenate([last_times, covariates.time_s])
    field = np.concatenate([last_fields, covariates.field_T])
    known = max(len(last_times) - 1, 0)
    rate = _rates_so_far(time, field)
    late = mode(field[known:], rate[known:], time[known:], time_constant_s, state)[len(last_times) - known :]
    memory.keep((time[-3:], field[-3:], late[-1]))
    return late


def _rates_so_far(time_s: FloatArray, field_T: FloatArray) -> FloatArray:
    """Return the derivative (N, 3) by time at each sample, which no later one tells of; 0 at the first."""
    rate = np.zeros_like(field_T)
    step = np.diff(time_s)[:, None]
    slope = np.diff(field_T, axis=0) / step
    rate[1:] = slope
    rate[2:] += np.diff(slope, axis=0) / (step[1:] + step[:-1]) * step[1:]
    return rate
