"""Wu 2025 Fig. 12: the coil located by constrained Euler localisation before and after calibration, section 4.2.

The array turns about its z axis in twelve headings, 2.64 m from a coil of 0.82 m and 0.96 m diameter. The paper does
not print how the coil was turned; every figure is worked out for many directions of its axis. Alternating fields of
10 Hz are taken as amplitudes: bias and drift do not enter, and noise of 0.015 nT/√Hz moves nothing here.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.fit.lossless import lossless
from tam_calibration.localization.euler import locate
from tam_calibration.localization.source_problem import Kernel
from tam_calibration.model.array import Array
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, to_degrees
from tam_calibration.simulation import Scenario, simulate
from tam_calibration.sources.dipole import area_of, dipole_field, loop_field
from tam_validation.papers.printed import printed_in, reason_of
from tam_validation.papers.row import PaperNumber, Status, compare, together

POSITION_M = np.array([2.40, -1.00, 0.46])
RADIUS_M = (0.82 + 0.96) / 4
AMPERE_TURNS = 708.0
"""From 10 G at the centre with 3.3 A: 2 a B/μ₀, at that current."""
HEADINGS_DEG = 30.0 * np.arange(12)
AXES = ("x", "y", "z", "r")
PRINTED_M = printed_in("wu2025")["coil_m"]
KERNELS: dict[str, Kernel] = {"loop": partial(loop_field, radius_m=RADIUS_M), "dipole": dipole_field}
_ASSUMED_TOLERANCE = 0.2
"""Of figures with errors that are assumed and fitted to them; the four of a stage count together."""
_RECORDED: dict[str, Status] = {"before": "not reproduced", "after": "reproduced"}
_DIRECTIONS, _STARTS = 200, 40


def directions(count: int = _DIRECTIONS) -> FloatArray:
    """Return (count, 3) axes of the coil, even over the half sphere: the other half gives the same positions."""
    steps = np.arange(count) + 0.5
    height, turn = steps / count, np.pi * (1 + np.sqrt(5)) * steps
    level = np.sqrt(1 - height**2)
    return np.stack([level * np.cos(turn), level * np.sin(turn), height], axis=1)


@dataclass(frozen=True, eq=False)
class Fault:
    """What the model of the paper leaves out; by default nothing.

    Parameters
    ----------
    baseline_scale : float
        True distances of the sensors from the centre over the stated ones.
    heading : float
        By which every heading is more than stated, radians.
    """

    baseline_scale: float = 1.0
    heading: float = 0.0


_NO_FAULT = Fault()


@dataclass(frozen=True, eq=False)
class Experiment:
    """The array before the coil.

    Parameters
    ----------
    array : Array
        As stated.
    errors : SensorErrors
        The truth.
    estimates : dict
        What the readings are corrected with, by the names of the stages "before" and "after".
    """

    array: Array
    errors: SensorErrors
    estimates: dict[str, SensorErrors]

    @classmethod
    def of(cls, turntable: Scenario) -> "Experiment":
        """Return the experiment of a scenario, calibrated as published from its run on the turntable."""
        calibration = lossless(simulate(turntable).recording, turntable.array, as_published=True)
        none = SensorErrors.none(turntable.array.sensor_count)
        return cls(turntable.array, turntable.errors, {"before": none, "after": calibration.errors})

    @property
    def ideal(self) -> "Experiment":
        """The same array without errors."""
        none = SensorErrors.none(self.array.sensor_count)
        return replace(self, errors=none, estimates=dict.fromkeys(self.estimates, none))

    def rmse_m(
        self, stage: str, axes: FloatArray, fault: Fault = _NO_FAULT, kernel: Kernel = KERNELS["loop"]
    ) -> FloatArray:
        """Return the root mean square errors of the position over the headings.

        x, y and z are those of the turntable at rest, in which the paper prints the position; r is the distance.

        Parameters
        ----------
        stage : str
            "before" or "after" calibration.
        axes : (O, 3) array
            Unit vectors along the axis of the coil, in the frame of the turntable at rest.
        fault : Fault
            What the model of the paper leaves out; by default nothing.
        kernel : callable
            Field of the coil: one of ``KERNELS``, by default that of a loop.

        Returns
        -------
        (O, 4) array
            Errors of ``AXES`` for each direction of the coil, metres.
        """
        stated, true = (_turns(from_degrees(HEADINGS_DEG) + offset) for offset in (0.0, fault.heading))
        raw = self._raw(axes, true, fault, kernel)
        fields = np.einsum("kij,ohkj->ohki", inv(self.estimates[stage].matrix), raw)
        found = locate(fields.reshape(-1, 3 * self.array.sensor_count) @ self.array.operator.T)
        positions = np.einsum("hij,ohj->ohi", stated, found.position_m.reshape(len(axes), -1, 3))
        distance = norm(positions, axis=2) - norm(POSITION_M)
        error = np.concatenate([positions - POSITION_M, distance[..., None]], axis=2)
        return np.asarray(np.sqrt(np.mean(error**2, axis=1)))

    def _raw(self, axes: FloatArray, turns: FloatArray, fault: Fault, kernel: Kernel) -> FloatArray:
        """Return the (O, 12, K, 3) raw amplitudes."""
        points = np.einsum("hij,kj->hki", turns, fault.baseline_scale * self.array.positions_m)
        moment = AMPERE_TURNS * area_of(RADIUS_M) * axes[:, None]
        world = kernel(points.reshape(-1, 3) - POSITION_M, moment)[0].reshape(len(axes), *points.shape)
        return np.asarray(np.einsum("kai,hji,ohkj->ohka", self.errors.matrix, turns, world, optimize=True))


def _turns(angles: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("z", angles[:, None]).as_matrix())


def printed(stage: str) -> FloatArray:
    """Return the four printed figures of a stage, metres."""
    return np.array([PRINTED_M[stage][axis] for axis in AXES])


def _nearest_axis(experiment: Experiment) -> FloatArray:
    """Return the direction (1, 3) of the coil with which the figures before calibration come nearest to the printed."""
    axes = directions()
    residuals = np.log(experiment.rmse_m("before", axes) / printed("before"))
    return axes[[int(norm(residuals, axis=1).argmin())]]


def _explain(experiment: Experiment) -> tuple[FloatArray, Fault]:
    """Return the direction (1, 3) of the coil, and baselines and headings, that come nearest to all printed figures."""
    from scipy.optimize import least_squares

    def residuals(axes: FloatArray, fault: Fault) -> FloatArray:
        ratios = [experiment.rmse_m(stage, axes, fault) / printed(stage) for stage in PRINTED_M]
        return np.log(np.concatenate(ratios, axis=1))

    axes = directions(_STARTS)
    grid = [(scale, heading) for scale in np.linspace(-0.15, 0.15, 7) for heading in np.linspace(-0.1, 0.1, 5)]
    coarse = np.array([norm(residuals(axes, Fault(1 + scale, heading=heading)), axis=1) for scale, heading in grid])
    fault_at, axis_at = np.unravel_index(coarse.argmin(), coarse.shape)
    start = np.concatenate([axes[axis_at], grid[fault_at]])
    found = least_squares(lambda unknowns: residuals(*_assumed(unknowns))[0], start, x_scale=[1, 1, 1, 0.1, 0.1])
    return _assumed(found.x)


def _assumed(unknowns: FloatArray) -> tuple[FloatArray, Fault]:
    axis = unknowns[None, :3] / norm(unknowns[:3])
    return axis, Fault(1 + float(unknowns[3]), heading=float(unknowns[4]))


def rows(experiment: Experiment) -> list[PaperNumber]:
    """Return the eight figures of Fig. 12 beside ours: loop, ideal dipole, and with what explains them best."""
    axis, (other, fault) = _nearest_axis(experiment), _explain(experiment)
    longer, off = _signed(100 * (fault.baseline_scale - 1)), _signed(to_degrees(fault.heading))
    faulty = reason_of("wu2025", "faulty_coil", longer=longer, off=off, tolerance=100 * _ASSUMED_TOLERANCE)
    table = []
    for stage in PRINTED_M:
        loop, dipole = (experiment.rmse_m(stage, axis, kernel=KERNELS[name])[0] for name in KERNELS)
        table += _compare(stage, "", loop, _reason(experiment, stage))
        table += _compare(stage, ", coil as an ideal dipole", dipole, _reason(experiment, stage))
        found = experiment.rmse_m(stage, other, fault)[0]
        table += _compare(
            stage, ", with other baselines and headings", found, faulty, _ASSUMED_TOLERANCE, _RECORDED[stage]
        )
    return table


def _reason(experiment: Experiment, stage: str) -> str:
    anyhow, ideal = (one.rmse_m(stage, directions())[:, AXES.index("r")] for one in (experiment, experiment.ideal))
    return reason_of("wu2025", "coil", least=anyhow.min(), most=anyhow.max(), low=ideal.min(), high=ideal.max())


def _compare(
    stage: str, what: str, ours: FloatArray, reason: str, relative: float = 0.1, recorded: Status = "not reproduced"
) -> list[PaperNumber]:
    names = [f"Section 4.2, RMSE of the coil's position, {axis}, {stage}{what}" for axis in AXES]
    table = compare(names, list(printed(stage)), ours, "m", relative=relative, recorded=recorded)
    return [replace(row, reason=reason) for row in together(table)]


def _signed(value: float) -> str:
    return f"{value:+.1f}".replace("-", "−")
