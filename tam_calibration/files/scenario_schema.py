"""What a scenario file holds, and the scenario that it gives."""

from dataclasses import asdict, dataclass, field
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from tam_calibration.files.array_yaml import ArrayFile
from tam_calibration.files.effects_schema import EffectFile
from tam_calibration.files.iaga2002 import read_iaga2002
from tam_calibration.files.quantities import (
    NOT_TURNED,
    Ampere,
    Celsius,
    Degrees,
    Hertz,
    Moment,
    NanoteslaTensor,
    NanoteslaVector,
    Orientation,
    Period,
    Place,
    ScaleFactors,
    Shears,
    Turns,
)
from tam_calibration.files.schema import Bounds, check
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import site_field_T
from tam_calibration.model.sensor_errors import SensorErrors, orientation_from_axes
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla
from tam_calibration.simulation import Scenario, attitude, instruments, sources
from tam_calibration.sources.dipole import Dipole

_Intensity = Annotated[float, Bounds(above=0, least=1e-3, most=1e9, unit="nT")]
"""Of a site: from a shielded room's residual field to one tesla."""
_Spread = Annotated[float, Bounds(least=0, most=1e9)]
"""Of noise or a drift, in the unit of its key: more than any channel can read."""
_Angle = Annotated[float, Bounds(above=0, least=1e-6, most=1e6, unit="deg")]
"""A standard deviation, or degrees per second: of larger ones nothing but noise is left."""


@dataclass(frozen=True, kw_only=True)
class _StatedSensor:
    sensor: int
    scale_factor: ScaleFactors = (1.0, 1.0, 1.0)
    non_orthogonality_deg: Shears = (0.0, 0.0, 0.0)
    bias_nT: NanoteslaVector = (0.0, 0.0, 0.0)
    misalignment_deg: Turns = (0.0, 0.0, 0.0)
    orientation: Orientation = NOT_TURNED


@dataclass(frozen=True, kw_only=True)
class _Site:
    intensity_nT: _Intensity
    inclination_deg: Annotated[float, Bounds(least=-90, most=90)]
    declination_deg: Degrees = 0.0

    def field_T(self) -> FloatArray:
        angles = from_degrees(self.inclination_deg), from_degrees(self.declination_deg)
        return sources.field_from_elements(from_nanotesla(self.intensity_nT), *angles)


@dataclass(frozen=True, kw_only=True)
class _Place:
    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0
    date: date

    def field_T(self) -> FloatArray:
        return site_field_T(self.latitude_deg, self.longitude_deg, self.height_m, self.date)


@dataclass(frozen=True, kw_only=True)
class _Sinusoid:
    kind: Literal["sinusoid"]
    standard_deviation_nT: _Spread
    period_s: Period

    def build(self, folder: Path) -> sources.Drift:
        return sources.SinusoidDrift(from_nanotesla(self.standard_deviation_nT), self.period_s)


@dataclass(frozen=True, kw_only=True)
class _Ramp:
    kind: Literal["ramp"]
    standard_deviation_nT: _Spread

    def build(self, folder: Path) -> sources.Drift:
        return sources.RampDrift(from_nanotesla(self.standard_deviation_nT))


@dataclass(frozen=True, kw_only=True)
class _Observatory:
    kind: Literal["observatory"]
    file: str
    start: datetime | None = None

    def build(self, folder: Path) -> sources.Drift:
        record = read_iaga2002(folder / self.file)
        start = self.start or record.start
        if start.tzinfo is not None:
            start = start.astimezone(UTC).replace(tzinfo=None)
        return sources.ObservedDrift(record.time_s - (start - record.start).total_seconds(), record.field_T)


@dataclass(frozen=True, kw_only=True)
class _Dipole:
    position_m: Place
    moment_Am2: Moment

    def build(self) -> Dipole:
        return Dipole(np.array(self.position_m), np.array(self.moment_Am2))


@dataclass(frozen=True, kw_only=True)
class _Random:
    kind: Literal["random"]

    def build(self) -> attitude.Motion:
        return attitude.RandomAttitudes()


@dataclass(frozen=True, kw_only=True)
class _RandomEulerAngles:
    kind: Literal["random_euler_angles"]
    standard_deviation_deg: _Angle = 180.0

    def build(self) -> attitude.Motion:
        return attitude.RandomEulerAngles(from_degrees(self.standard_deviation_deg))


@dataclass(frozen=True, kw_only=True)
class _ThreeAxisTurns:
    kind: Literal["three_axis_turns"]

    def build(self) -> attitude.Motion:
        return attitude.ThreeAxisTurns()


@dataclass(frozen=True, kw_only=True)
class _Turntable:
    kind: Literal["turntable"]

    def build(self) -> attitude.Motion:
        return attitude.Turntable()


@dataclass(frozen=True, kw_only=True)
class _Tumble:
    kind: Literal["tumble"]
    turn_rate_deg_per_s: _Angle = 90.0

    def build(self) -> attitude.Motion:
        return attitude.Tumble(from_degrees(self.turn_rate_deg_per_s))


@dataclass(frozen=True, kw_only=True)
class _Auv:
    kind: Literal["auv"]
    pitch_limit_deg: Degrees
    roll_limit_deg: Degrees
    turn_period_s: Period

    def build(self) -> attitude.Motion:
        limits = from_degrees(self.pitch_limit_deg), from_degrees(self.roll_limit_deg)
        return attitude.Manoeuvre(*limits, self.turn_period_s)


@dataclass(frozen=True, kw_only=True)
class _Scalar:
    rate_hz: Hertz | None = None
    one_error_per_recording: bool = False


@dataclass(frozen=True, kw_only=True)
class _Temperature:
    start_C: Celsius
    end_C: Celsius
    noise_C: _Spread = 0.0


@dataclass(frozen=True, kw_only=True)
class _Current:
    low_A: Ampere
    high_A: Ampere
    period_s: Period
    noise_A: _Spread = 0.0


@dataclass(frozen=True, kw_only=True)
class _Switched:
    low: Ampere
    high: Ampere
    period_s: Period
    noise: _Spread = 0.0

    def build(self) -> instruments.Current:
        return instruments.Current(self.low, self.high, self.period_s, self.noise)


@dataclass(frozen=True, kw_only=True)
class _Attitude:
    noise_deg: _Spread = 0.0

    def build(self) -> instruments.AttitudeChannel:
        return instruments.AttitudeChannel(from_degrees(self.noise_deg))


_Motion = _Random | _RandomEulerAngles | _ThreeAxisTurns | _Turntable | _Tumble | _Auv
_Drift = _Sinusoid | _Ramp | _Observatory


@dataclass(frozen=True, kw_only=True)
class ScenarioFile:
    """What a scenario file may hold; channels that it does not name are not recorded."""

    array: ArrayFile
    sensors: list[_StatedSensor] | None = None
    site: _Site | None = None
    place: _Place | None = None
    motion: _Motion
    samples: int
    rate_hz: Hertz
    seed: Annotated[int, Bounds(least=0)] = 0
    drift: _Drift | None = None
    dipole: _Dipole | None = None
    site_gradient_nT_per_m: NanoteslaTensor | None = None
    scalar: _Scalar | None = None
    temperature: _Temperature | None = None
    current: _Current | None = None
    further_channels: dict[str, _Switched] = field(default_factory=dict)
    attitude: _Attitude | None = None
    effects: list[EffectFile] = field(default_factory=list)

    def build(self, folder: Path) -> Scenario:
        """Return the scenario, paths in it relative to a folder."""
        array = self.array.to_array()
        return Scenario(
            array=array,
            errors=SensorErrors.none(array.sensor_count) if self.sensors is None else _errors(self.sensors),
            site_field_T=self._site_field_T(),
            motion=self.motion.build(),
            sample_count=self.samples,
            rate_hz=self.rate_hz,
            seed=self.seed,
            drift=None if self.drift is None else self.drift.build(folder),
            dipole=None if self.dipole is None else self.dipole.build(),
            site_gradient_T_per_m=self._site_gradient_T_per_m(),
            scalar=None if self.scalar is None else instruments.ScalarReference(**asdict(self.scalar)),
            temperature=None if self.temperature is None else instruments.Temperature(**asdict(self.temperature)),
            current=None if self.current is None else instruments.Current(**asdict(self.current)),
            attitude=None if self.attitude is None else self.attitude.build(),
            effects=tuple(effect.to_fitted() for effect in self.effects),
            further={name: channel.build() for name, channel in self.further_channels.items()},
        )

    def _site_gradient_T_per_m(self) -> FloatArray | None:
        gradient = self.site_gradient_nT_per_m
        return None if gradient is None else from_nanotesla(np.array(gradient))

    def _site_field_T(self) -> FloatArray:
        if self.site is not None and self.place is None:
            return self.site.field_T()
        if self.place is not None and self.site is None:
            return self.place.field_T()
        raise InputError(
            "give either site (intensity_nT, inclination_deg) or place (latitude_deg, longitude_deg, date)"
        )


def scenario_of(content: dict[str, Any], folder: Path) -> Scenario:
    """Return the scenario of the keys and values of a scenario file.

    Parameters
    ----------
    content : dict
        Keys and values as read from YAML, with units in the keys.
    folder : Path
        To which paths in the scenario are relative: that of its file.

    Raises
    ------
    InputError
        When a key is not known or missing, or the values make no scenario.
    """
    return check(content, ScenarioFile).build(folder)


def _errors(sensors: list[_StatedSensor]) -> SensorErrors:
    if [block.sensor for block in sensors] != list(range(1, len(sensors) + 1)):
        raise InputError("sensors must be numbered 1, 2, … in this order")
    return SensorErrors(
        np.array([block.scale_factor for block in sensors]),
        from_degrees(np.array([block.non_orthogonality_deg for block in sensors])),
        from_nanotesla(np.array([block.bias_nT for block in sensors])),
        from_degrees(np.array([block.misalignment_deg for block in sensors])),
        np.array([orientation_from_axes(block.orientation) for block in sensors]),
    )
