"""The parameters of all missions of a platform as they stand in the files, and their drifts."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from tam_calibration.fleet.drift import Drift, fit_drift
from tam_calibration.fleet.result import Result
from tam_calibration.units import FloatArray


@dataclass(frozen=True)
class Group:
    """Three parameters of a sensor: their names, those of their columns, key in the calibration file and unit."""

    title: str
    names: tuple[str, str, str]
    columns: tuple[str, str, str]
    key: str
    unit: str = ""

    @property
    def standard_error_key(self) -> str:
        """Key of their standard errors in the calibration file."""
        stem = self.key.removesuffix(f"_{self.suffix}") if self.suffix else self.key
        return f"{stem}_standard_error_{self.suffix}".rstrip("_")

    @property
    def suffix(self) -> str:
        """The unit as keys and columns have it."""
        return "deg" if self.unit == "°" else self.unit


_AXES = ("x", "y", "z")
GROUPS = (
    Group("scale factor", _AXES, _AXES, "scale_factor"),
    Group("non-orthogonality", ("θ", "φ", "ψ"), ("theta", "phi", "psi"), "non_orthogonality_deg", "°"),
    Group("bias", _AXES, _AXES, "bias_nT", "nT"),
    Group("misalignment", ("α", "β", "γ"), ("alpha", "beta", "gamma"), "misalignment_deg", "°"),
)


@dataclass(frozen=True)
class ParameterDrift:
    """The drift of one parameter of a sensor of a platform."""

    platform: str
    sensor: int
    group: Group
    axis: int
    drift: Drift

    @property
    def name(self) -> str:
        """Name of the parameter, without the sensor."""
        return f"{self.group.title} {self.group.names[self.axis]}"


@dataclass(frozen=True, eq=False)
class Missions:
    """The missions of a platform that were calibrated.

    Parameters
    ----------
    platform : str
        Its name.
    time_s : (M,) array
        The middle of each mission, seconds.
    values, standard_errors : dict
        For each group (M, K, 3), in its unit.
    """

    platform: str
    time_s: FloatArray
    values: dict[Group, FloatArray]
    standard_errors: dict[Group, FloatArray]

    def drifts(self) -> Iterator[ParameterDrift]:
        """Yield the drift of each parameter that some mission tells."""
        for group, values in self.values.items():
            errors = self.standard_errors[group]
            for sensor, axis in np.ndindex(*values.shape[1:]):
                drift = fit_drift(self.time_s, values[:, sensor, axis], errors[:, sensor, axis])
                if drift is not None:
                    yield ParameterDrift(self.platform, sensor + 1, group, axis, drift)


def by_platform(results: Sequence[Result]) -> dict[str, list[Result]]:
    """Return the results of each platform, which stand together already."""
    return {platform: list(some) for platform, some in groupby(results, lambda result: result.platform)}


def missions_of(platform: str, results: Sequence[Result]) -> Missions | None:
    """Return the calibrated missions of a platform; None where there is none."""
    calibrated = [result for result in results if result.sensors and result.time_span_s]
    if not calibrated:
        return None
    time_s = np.array([np.mean(result.time_span_s or ()) for result in calibrated])
    values, errors = (
        {
            group: np.array([[sensor[key] for sensor in each.sensors] for each in calibrated], float)
            for group, key in keys
        }
        for keys in (
            [(group, group.key) for group in GROUPS],
            [(group, group.standard_error_key) for group in GROUPS],
        )
    )
    return Missions(platform, time_s, values, errors)


def all_drifts(results: Sequence[Result]) -> list[ParameterDrift]:
    """Return the drifts of all parameters, platform by platform."""
    missions = (missions_of(platform, some) for platform, some in by_platform(results).items())
    return [drift for each in missions if each is not None for drift in each.drifts()]
