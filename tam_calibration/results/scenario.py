"""Scenario files, shipped ones by name, and the truth that is written with a simulated recording."""

from collections.abc import Callable
from dataclasses import field, fields, replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from tam_calibration.files import schema
from tam_calibration.files.schema import Bounds, Document, GyroscopeFile, check, in_si, part_of
from tam_calibration.files.text_files import configuration_folder, write_text
from tam_calibration.files.yaml_document import dump_mapping, mapping_in
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import site_field_T
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla, to_nanotesla
from tam_calibration.recordings.array_yaml import ArrayFile
from tam_calibration.recordings.iaga2002 import read_iaga2002
from tam_calibration.results.calibration_schema import SensorFile, errors_of
from tam_calibration.results.calibration_yaml import sensors_to_mapping
from tam_calibration.results.effects_schema import EffectFile, effect_to_mapping
from tam_calibration.simulation import Scenario, Simulation, conditions
from tam_calibration.sources.dipole import Dipole

_Intensity = Annotated[float, Bounds(above=0, least=1e-3, most=1e9, unit="nT")]
"""Of a site: from a shielded room's residual field to one tesla."""
_Spread = Annotated[float, Bounds(least=0, most=1e9)]
"""Of noise or a drift, in the unit of its key: more than any channel can read."""
_Angle = Annotated[float, Bounds(above=0, least=1e-6, most=1e6, unit="deg")]
"""A standard deviation, or degrees per second: of larger ones nothing but noise is left."""


class _StatedSensor(SensorFile):
    scale_factor: schema.ScaleFactors = (1.0, 1.0, 1.0)
    non_orthogonality_deg: schema.Shears = (0.0, 0.0, 0.0)
    bias_nT: schema.NanoteslaVector = (0.0, 0.0, 0.0)
    misalignment_deg: schema.Turns = (0.0, 0.0, 0.0)


class _Site(Document):
    intensity_nT: _Intensity
    inclination_deg: Annotated[float, Bounds(least=-90, most=90)]
    declination_deg: schema.Degrees = 0.0

    def field_T(self) -> FloatArray:
        angles = from_degrees(self.inclination_deg), from_degrees(self.declination_deg)
        return conditions.field_from_elements(from_nanotesla(self.intensity_nT), *angles)


class _Place(Document):
    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0
    date: date

    def field_T(self) -> FloatArray:
        return site_field_T(self.latitude_deg, self.longitude_deg, self.height_m, self.date)


class _Part(Document):
    """A part of a scenario, which makes an object of its values in SI."""

    makes: ClassVar[Callable[..., Any]]

    def build(self, folder: Path) -> Any:
        """Return the object."""
        named = zip(fields(self), in_si(self), strict=True)
        return type(self).makes(*(value for each, value in named if each.name != "kind"))


class _Sinusoid(_Part):
    makes = conditions.SinusoidDrift
    kind: Literal["sinusoid"]
    standard_deviation_nT: _Spread
    period_s: schema.Period


class _Ramp(_Part):
    makes = conditions.RampDrift
    kind: Literal["ramp"]
    standard_deviation_nT: _Spread


class _Observatory(Document):
    kind: Literal["observatory"]
    file: str
    start: datetime | None = None

    def build(self, folder: Path) -> conditions.Drift:
        record = read_iaga2002(folder / self.file)
        start = self.start or record.start
        if start.tzinfo is not None:
            start = start.astimezone(UTC).replace(tzinfo=None)
        return conditions.ObservedDrift(record.time_s - (start - record.start).total_seconds(), record.field_T)


class _Dipole(_Part):
    makes = Dipole
    position_m: schema.Place
    moment_Am2: schema.Moment


class _Motion(Document):
    """A motion without parameters."""

    kind: Literal["random", "three_axis_turns", "turntable"]

    def build(self, folder: Path) -> conditions.Motion:
        """Return the motion."""
        if self.kind == "random":
            return conditions.RandomAttitudes()
        return conditions.Turntable() if self.kind == "turntable" else conditions.ThreeAxisTurns()


class _RandomEulerAngles(_Part):
    makes = conditions.RandomEulerAngles
    kind: Literal["random_euler_angles"]
    standard_deviation_deg: _Angle = 180.0


class _Tumble(_Part):
    makes = conditions.Tumble
    kind: Literal["tumble"]
    turn_rate_deg_per_s: _Angle = 90.0


class _Auv(_Part):
    makes = conditions.Manoeuvre
    kind: Literal["auv"]
    pitch_limit_deg: schema.Degrees
    roll_limit_deg: schema.Degrees
    turn_period_s: schema.Period


class _Scalar(_Part):
    makes = conditions.ScalarReference
    rate_hz: schema.Hertz | None = None
    one_error_per_recording: bool = False


class _Temperature(_Part):
    makes = conditions.Temperature
    start_C: schema.Celsius
    end_C: schema.Celsius
    noise_C: _Spread = 0.0


class _Current(_Part):
    makes = conditions.Current
    low_A: schema.Ampere
    high_A: schema.Ampere
    period_s: schema.Period
    noise_A: _Spread = 0.0


class _Switched(_Part):
    makes = conditions.Current
    low: schema.Ampere
    high: schema.Ampere
    period_s: schema.Period
    noise: _Spread = 0.0


class _Attitude(_Part):
    makes = conditions.AttitudeChannel
    noise_deg: _Spread = 0.0


_Drift = _Sinusoid | _Ramp | _Observatory

_PARTS = ("drift", "dipole", "scalar", "temperature", "current", "attitude")
"""Keys of the parts that may be left out."""


class ScenarioFile(Document):
    """What a scenario file may hold; channels that it does not name are not recorded."""

    array: ArrayFile
    sensors: list[_StatedSensor] | None = None
    site: _Site | None = None
    place: _Place | None = None
    motion: _Motion | _RandomEulerAngles | _Tumble | _Auv
    samples: int
    rate_hz: schema.Hertz
    seed: Annotated[int, Bounds(least=0)] = 0
    drift: _Drift | None = None
    dipole: _Dipole | None = None
    site_gradient_nT_per_m: schema.NanoteslaTensor | None = None
    scalar: _Scalar | None = None
    temperature: _Temperature | None = None
    current: _Current | None = None
    further_channels: dict[str, _Switched] = field(default_factory=dict)
    attitude: _Attitude | None = None
    gyroscope: GyroscopeFile | None = None
    effects: list[EffectFile] = field(default_factory=list)

    def build(self, folder: Path) -> Scenario:
        """Return the scenario, paths in it relative to a folder."""
        array, gradient = self.array.to_array(), self.site_gradient_nT_per_m
        gyroscope = part_of(self.gyroscope) or array.gyroscope
        array = replace(array, gyroscope=gyroscope)
        scenario = Scenario(
            array=array,
            errors=SensorErrors.none(array.sensor_count) if self.sensors is None else errors_of(self.sensors),
            site_field_T=self._site_field_T(),
            motion=self.motion.build(folder),
            sample_count=self.samples,
            rate_hz=self.rate_hz,
            seed=self.seed,
            site_gradient_T_per_m=None if gradient is None else from_nanotesla(np.array(gradient)),
            further={name: channel.build(folder) for name, channel in self.further_channels.items()},
            gyroscope=None if self.gyroscope is None else gyroscope,
            **{name: part.build(folder) for name in _PARTS if (part := getattr(self, name)) is not None},
        )
        effects = tuple(effect.to_fitted(scenario.errors, scenario.array) for effect in self.effects)
        return replace(scenario, effects=effects)

    def _site_field_T(self) -> FloatArray:
        stated = [each for each in (self.site, self.place) if each is not None]
        if len(stated) != 1:
            raise InputError(
                "give either site (intensity_nT, inclination_deg) or place (latitude_deg, longitude_deg, date)"
            )
        return stated[0].field_T()


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


_TRUTH_SCHEMA = "tam_calibration/truth/1"


def shipped_scenarios() -> dict[str, Path]:
    """Return the paths of the scenarios that come with the package, by name."""
    return {path.stem: path for path in sorted((configuration_folder() / "scenarios").glob("*.yaml"))}


def _path_of(name_or_path: str | Path) -> Path:
    shipped = shipped_scenarios()
    path = shipped.get(str(name_or_path), Path(name_or_path))
    if not path.exists():
        raise InputError(
            f"there is no file {path}, and no scenario of that name comes with it: {', '.join(shipped)} do"
        )
    return path


def files_of_scenario(name_or_path: str | Path) -> list[Path]:
    """Return the files that a scenario is read from: its own, and the observatory's that it may name.

    Parameters
    ----------
    name_or_path : str or Path
        As of `read_scenario`.

    Raises
    ------
    InputError
        When there is none, or it is no YAML.
    """
    path = _path_of(name_or_path)
    with mapping_in(path) as content:
        drift = content.get("drift")
    named = drift.get("file") if isinstance(drift, dict) else None
    return [path, path.parent / named] if isinstance(named, str) else [path]


def read_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario file, or a shipped scenario by its name.

    Parameters
    ----------
    name_or_path : str or Path
        auv, tumble_100_hz, warming_up, wu_table_1 or wu_turntable, or a YAML file.

    Returns
    -------
    Scenario
        In SI.

    Raises
    ------
    InputError
        When there is none, a key is not known or missing, or the values make no scenario.

    Examples
    --------
    >>> from tam_calibration import read_scenario
    >>> scenario = read_scenario("wu_table_1")  # Wu 2025, Table 1
    >>> scenario.sample_count, scenario.array.sensor_count, scenario.effects
    (360, 4, ())
    """
    path = _path_of(name_or_path)
    with mapping_in(path) as content:
        return scenario_of(content, path.parent)


def write_truth(path: Path, simulation: Simulation) -> None:
    """Write what was simulated: the sensors' true errors and effects as a calibration file states them, and the field.

    Parameters
    ----------
    path : Path
        The YAML file; one that is there is replaced once the new one is complete.
    simulation : Simulation
        Errors are written in nT and degrees, of the field the mean and standard deviation of its intensity at the
        centre.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    intensity = np.linalg.norm(simulation.center_field_T, axis=1)
    content = {
        "schema": _TRUTH_SCHEMA,
        "sensors": sensors_to_mapping(simulation.errors),
        "field": {
            "intensity_nT": round(float(to_nanotesla(intensity.mean())), 6),
            "intensity_standard_deviation_nT": round(float(to_nanotesla(intensity.std())), 6),
        },
        "seed": simulation.scenario.seed,
    }
    if simulation.scenario.effects:
        content["effects"] = [effect_to_mapping(effect) for effect in simulation.scenario.effects]
    write_text(path, dump_mapping(content))
