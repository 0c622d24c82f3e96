"""The field of the vehicle itself, beyond what the errors of its sensors hold."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from tam_calibration.core.harmonics import derivatives, fields
from tam_calibration.effects.covariates import mode
from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Sized, Term, WhitenedResiduals
from tam_calibration.effects.lags import SLOWER, followed, time_constants_s
from tam_calibration.effects.laws import OF_MATRIX, matrix_terms, scalar_term
from tam_calibration.effects.motion import jumps
from tam_calibration.model.fitted_effect import ALL, FittedEffect, Shape
from tam_calibration.model.further_channels import is_further, unit_of
from tam_calibration.model.units import FloatArray

_DEGREES = {2: ("gradient", "1/m"), 3: ("curvature", "1/m²")}
"""Name and unit of what potentials make, by their degree: beyond the third, four sensors tell no law in space."""


_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Axes of the six elements of a symmetric matrix."""

_INDUCED = "induced"


class PlatformField(LinearEffect):
    """Eighteen terms at the scalar, the gradient of eddy currents between the sensors, and currents and actuators.

    What a sensor reads of the vehicle's permanent and induced field is a bias and a matrix, which are its own errors
    already; so are those at the scalar, where all sensors have errors: they are calibrated to the field at its place.
    These three and six stand here for simulations and for fits of the scalar alone.
    """

    name = "platform_field"

    def needs(self, fitted: FittedEffect) -> tuple[str, ...]:
        """Return the names of the currents and actuators that have a part in a fitted effect.

        Parameters
        ----------
        fitted : FittedEffect
            With its numbers.
        """
        names = (one.term.partition(",")[0] for one in fitted.contributions)
        return tuple(dict.fromkeys(name for name in names if is_further(name) or name == "current_A"))

    def sizes(self, covariates: Covariates, fitted: FittedEffect) -> list[Sized]:
        """Return the sizes of the coefficients, and which part of what conductors do is not that of a uniform gradient.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        fitted : FittedEffect
            With its numbers.
        """
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
        """Return the time constants of eddy currents; none where the field jumps from pose to pose.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the constants follow from the motion.
        """
        if jumps(covariates) is not None:
            return ({},)
        return [{"time_constant_s": constant} for constant in time_constants_s(covariates)[::2]]

    def terms(self, covariates: Covariates, shape: Shape) -> Iterator[Term]:
        """Yield the eighteen terms of the scalar, the gradients of its eddy currents, and what follows each channel.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``time_constant_s`` of the first mode of the eddy currents, seconds; without it there are none.
        """
        permanent = {f"permanent {axis}": "T" for axis in "xyz"}
        yield scalar_term(covariates, "permanent", permanent, _direction(covariates))
        yield _induced(covariates, _INDUCED, "")
        if "time_constant_s" in shape:
            late = _followed(covariates, shape["time_constant_s"])
            later = _followed(covariates, SLOWER * shape["time_constant_s"])
            for name, change in (("first mode", covariates.field_T - late), ("slower mode", late - later)):
                yield _at_scalar(covariates, name, change)
                # Between fewer sensors the field of distant currents differs as that of currents at one of them.
                if covariates.sensor_count >= 4:
                    yield from (_gradient(covariates, name, degree, change) for degree in _DEGREES)
        channels = {} if covariates.current_A is None else {"current_A": covariates.current_A}
        for name, values in (channels | dict(covariates.further)).items():
            yield from _of_channel(covariates, name, values)


def _direction(covariates: Covariates) -> FloatArray:
    return covariates.field_T / covariates.intensity_T[:, None]


def _induced(covariates: Covariates, name: str, prefix: str, part: FloatArray | float = 1.0) -> Term:
    """Return what the field that six elements of a symmetric matrix induce adds to the intensity, or parts of it."""
    units = {f"{prefix}induced {'xyz'[i]}{'xyz'[j]}": "1" for i, j in _PAIRS}
    direction = _direction(covariates)
    squares = np.column_stack([direction[:, i] * covariates.field_T[:, j] for i, j in _PAIRS])
    return scalar_term(covariates, name, units, squares * part)


def _at_scalar(covariates: Covariates, name: str, change_T: FloatArray) -> Term:
    """Return what eddy currents that answer to a change of the field (N, 3) add to the intensity, nine elements."""
    along = (_direction(covariates)[:, :, None] * change_T[:, None, :]).reshape(len(change_T), 9)
    return scalar_term(covariates, name, {f"{name}, {of}": "1" for of in OF_MATRIX}, along)


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
    name, unit = f"{mode_name}, {_DEGREES[degree][0]}", _DEGREES[degree][1]
    at_sensors = fields(degree, covariates.array.positions_m.T)
    read = np.zeros((len(at_sensors), covariates.scalar_row + 1))
    read[:, :-1] = np.einsum("kij,pjk->pki", covariates.errors.matrix, at_sensors).reshape(len(at_sensors), -1)
    features = np.tile(change_T, len(at_sensors))
    names = ["".join(np.repeat(list("xyz"), orders)) for orders in derivatives(degree)]
    parts = tuple(Coefficient(f"{name} {pair}, {axis} of the field", unit) for pair in names for axis in "xyz")
    return Term(ALL, None, name, parts, features, np.repeat(read, 3, axis=0), np.arange(len(parts)))


def _of_channel(covariates: Covariates, name: str, values: FloatArray) -> Iterator[Term]:
    """Yield the field in proportion to a channel, and of an actuator what it makes of the field by its iron."""
    unit = "A" if name == "current_A" else unit_of(name)
    per_unit = "T/A" if unit == "A" else "T"
    column, axes = values[:, None], np.arange(3)
    units = {f"{name} {axis}": per_unit for axis in "xyz"}
    parts = tuple(Coefficient(*each) for each in units.items())
    features = np.tile(column, 3)
    for sensor in range(covariates.sensor_count):
        yield Term(sensor, None, name, parts, features, 3 * sensor + axes, axes)
    yield scalar_term(covariates, name, units, _direction(covariates) * column)
    if unit != "A":
        yield from matrix_terms(covariates, f"{name}, {_INDUCED}", name, covariates.field_T * column)
        yield _induced(covariates, f"{name}, {_INDUCED}", f"{name}, ", column)


def _followed(covariates: Covariates, time_constant_s: float) -> FloatArray:
    """Return the field (N, 3) after a first-order lag.

    As samples arrive, its rate of change is the slope of the parabola through a sample and the two before it.
    """
    memory = covariates.memory
    if memory is None:
        return followed(covariates, time_constant_s)
    before = memory.recall()
    if before is None:
        time, field, rate = covariates.time_s, covariates.field_T, _rates_so_far(covariates.time_s, covariates.field_T)
        late = mode(field, rate, time, time_constant_s)
    else:
        last_time, last_field, last_rate, last_state = before
        time = np.concatenate([last_time, covariates.time_s])
        field = np.concatenate([last_field, covariates.field_T])
        rate, last = _rates_so_far(time, field), len(last_time) - 1
        rate[last] = last_rate
        settled = mode(field[last:], rate[last:], time[last:], time_constant_s)
        decay = np.exp(-(time[last:] - time[last]) / time_constant_s)[:, None]
        late = (settled + decay * (last_state - settled[0]))[1:]
    memory.keep((time[-2:], field[-2:], rate[-1], late[-1]))
    return late


def _rates_so_far(time_s: FloatArray, field_T: FloatArray) -> FloatArray:
    """Return the derivative (N, 3) by time at each sample, which no later one tells of; 0 at the first."""
    rate = np.zeros_like(field_T)
    step = np.diff(time_s)[:, None]
    slope = np.diff(field_T, axis=0) / step
    rate[1:] = slope
    rate[2:] += np.diff(slope, axis=0) / (step[1:] + step[:-1]) * step[1:]
    return rate
