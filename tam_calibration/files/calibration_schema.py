"""What a calibration file holds, and the calibration that it gives."""

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from tam_calibration.correction.acceptance import beyond_limits
from tam_calibration.correction.calibration import (
    AmbientGradientEstimate,
    Calibration,
    EffectSize,
    KnownSource,
    Provenance,
)
from tam_calibration.effects.library import check_numbers
from tam_calibration.files.array_yaml import ArrayFile
from tam_calibration.files.effects_schema import EffectFile
from tam_calibration.files.quantities import (
    NOT_TURNED,
    Celsius,
    Finite,
    Nanotesla,
    NanoteslaSize,
    NanoteslaTensor,
    NanoteslaVector,
    Orientation,
    ScaleFactor,
    ScaleFactors,
    Seconds,
    Shears,
    Tensor,
    Turns,
    Vector,
)
from tam_calibration.files.schema import Bounds, check
from tam_calibration.files.update_schema import UpdateFile
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.residuals import Residuals
from tam_calibration.model.sensor_errors import SensorErrors, orientation_from_axes
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla

SCHEMA = "tam_calibration/calibration/1"

_StandardError = Annotated[float, Bounds(least=0, most=1e12, may_be_nan=True)]
_StandardErrors = tuple[_StandardError, _StandardError, _StandardError]
_Covariance = Annotated[float, Bounds(least=-1e12, most=1e12)]
"""SI: a parameter that is known to a million of its units is not known."""


@dataclass(frozen=True, kw_only=True)
class _CalibratedSensor:
    sensor: int
    scale_factor: ScaleFactors
    scale_factor_standard_error: _StandardErrors
    non_orthogonality_deg: Shears
    non_orthogonality_standard_error_deg: _StandardErrors
    bias_nT: NanoteslaVector
    bias_standard_error_nT: _StandardErrors
    misalignment_deg: Turns
    misalignment_standard_error_deg: _StandardErrors
    orientation: Orientation = NOT_TURNED
    matrix: Tensor


@dataclass(frozen=True, kw_only=True)
class _Array(ArrayFile):
    noise_is_estimated: bool


@dataclass(frozen=True, kw_only=True)
class _Field:
    intensity_nT: Nanotesla
    has_scalar_reference: bool
    coverage_of_sphere: Annotated[float, Bounds(least=0, most=1)]
    gradient_nT_per_m: NanoteslaTensor | None = None
    gradient_standard_error_nT_per_m: NanoteslaTensor | None = None

    def to_gradient(self) -> AmbientGradientEstimate | None:
        """Return the gradient of the field in SI, where one was fitted."""
        tensor, errors = self.gradient_nT_per_m, self.gradient_standard_error_nT_per_m
        if tensor is None or errors is None:
            return None
        return AmbientGradientEstimate(from_nanotesla(np.array(tensor)), from_nanotesla(np.array(errors)))


@dataclass(frozen=True, kw_only=True)
class _Residuals:
    sensor_intensity_nT: list[NanoteslaSize]
    center_intensity_nT: NanoteslaSize
    tensor_nT_per_m: tuple[NanoteslaSize, NanoteslaSize, NanoteslaSize, NanoteslaSize, NanoteslaSize]
    tensor_rmse_nT_per_m: NanoteslaSize

    def to_residuals(self) -> Residuals:
        """Return the residuals in SI."""
        return Residuals(
            from_nanotesla(np.array(self.sensor_intensity_nT)),
            from_nanotesla(self.center_intensity_nT),
            from_nanotesla(np.array(self.tensor_nT_per_m)),
        )


@dataclass(frozen=True, kw_only=True)
class _AllResiduals:
    before: _Residuals
    in_sample: _Residuals
    held_out: _Residuals | None
    noise_floor: _Residuals


@dataclass(frozen=True, kw_only=True)
class _Recording:
    samples: int
    time_span_s: tuple[Seconds, Seconds]
    name: str | None
    size_bytes: int | None
    sha256: str | None
    mean_temperature_C: Celsius | None = None

    def to_provenance(self) -> Provenance | None:
        """Return where the recording came from, if that is known."""
        if self.name is None or self.size_bytes is None or self.sha256 is None:
            return None
        return Provenance(self.name, self.size_bytes, self.sha256)


@dataclass(frozen=True, kw_only=True)
class _OfOutputs:
    field_nT: tuple[NanoteslaSize, NanoteslaSize, NanoteslaSize]
    gradient_nT_per_m: tuple[NanoteslaSize, NanoteslaSize, NanoteslaSize, NanoteslaSize, NanoteslaSize, NanoteslaSize]

    def to_tesla(self) -> FloatArray:
        """Return the (9,) numbers in SI."""
        return from_nanotesla(np.array([*self.field_nT, *self.gradient_nT_per_m]))


@dataclass(frozen=True, kw_only=True)
class _Effect(EffectFile):
    size: _OfOutputs
    size_standard_error: _OfOutputs

    def to_size(self) -> EffectSize:
        """Return what the effect does to the outputs, SI."""
        return EffectSize(self.size.to_tesla(), self.size_standard_error.to_tesla())


@dataclass(frozen=True, kw_only=True)
class _KnownSource:
    baseline_scale: ScaleFactor
    baseline_scale_standard_error: Finite
    rotation_deg: Turns
    rotation_standard_error_deg: Vector
    axis_offsets_standard_error_m: list[Tensor]
    reduced_chi_square: Finite

    def to_known_source(self) -> KnownSource:
        """Return what the source showed in SI."""
        return KnownSource(
            self.baseline_scale,
            self.baseline_scale_standard_error,
            from_degrees(np.array(self.rotation_deg)),
            from_degrees(np.array(self.rotation_standard_error_deg)),
            np.array(self.axis_offsets_standard_error_m),
            self.reduced_chi_square,
        )


@dataclass(frozen=True, kw_only=True)
class _Calibration:
    schema: Literal["tam_calibration/calibration/1"]
    software: str
    method: str
    formula: str
    frame: str
    statements: list[str]
    warnings: list[str]
    accepted: list[str] = dataclasses.field(default_factory=list)
    sensors: list[_CalibratedSensor]
    array: _Array
    field: _Field
    residuals: _AllResiduals
    reduced_chi_square: dict[str, float]
    effects: list[_Effect] = dataclasses.field(default_factory=list)
    known_source: _KnownSource | None = None
    update: UpdateFile | None = None
    recording: _Recording
    covariance_order: str
    covariance_SI: list[list[_Covariance]] | None


def calibration_of(content: dict[str, Any]) -> Calibration:
    """Return the calibration of the keys and values of a calibration file.

    Raises
    ------
    InputError
        When they are of another version, incomplete, contradict each other, or are beyond a limit that is not accepted.
    """
    schema = content.get("schema")
    if schema != SCHEMA:
        stated = "has no schema" if schema is None else f"has the schema {quoted(schema)}"
        raise InputError(f"this is no calibration that this version reads: it {stated}, not {SCHEMA!r}")
    stored = check(content, _Calibration)
    errors = _errors(stored)
    array = stored.array.to_array()
    if array.sensor_count != errors.sensor_count or array.vector_noise_T is None:
        raise InputError(f"the file is damaged: positions and noise must be those of its {errors.sensor_count} sensors")
    effects = tuple(effect.to_fitted() for effect in stored.effects)
    for fitted in effects:
        check_numbers(fitted, errors, array)
    residuals = stored.residuals
    for each in (residuals.before, residuals.in_sample, residuals.held_out, residuals.noise_floor):
        if each is not None and len(each.sensor_intensity_nT) != errors.sensor_count:
            raise InputError(f"the file is damaged: residuals must be those of its {errors.sensor_count} sensors")
    calibration = Calibration(
        method=stored.method,
        array=array.with_stated_noise(),
        noise_is_estimated=stored.array.noise_is_estimated,
        errors=errors,
        covariance=_covariance(stored),
        has_scalar_reference=stored.field.has_scalar_reference,
        intensity_T=from_nanotesla(stored.field.intensity_nT),
        before=residuals.before.to_residuals(),
        in_sample=residuals.in_sample.to_residuals(),
        floor=residuals.noise_floor.to_residuals(),
        samples=stored.recording.samples,
        time_span_s=stored.recording.time_span_s,
        coverage=stored.field.coverage_of_sphere,
        reduced_chi_square=stored.reduced_chi_square,
        held_out=None if residuals.held_out is None else residuals.held_out.to_residuals(),
        source=stored.recording.to_provenance(),
        warnings=tuple(stored.warnings),
        ambient_gradient=stored.field.to_gradient(),
        frame=stored.frame,
        effects=effects,
        effect_sizes=tuple(effect.to_size() for effect in stored.effects),
        known_source=None if stored.known_source is None else stored.known_source.to_known_source(),
        accepted=tuple(stored.accepted),
        temperature_C=stored.recording.mean_temperature_C,
        update=None if stored.update is None else stored.update.to_update(errors.sensor_count),
    )
    for name, sentence in beyond_limits(calibration).items():
        if name not in stored.accepted:
            raise InputError(f"{sentence}; where that is so, calibrate again and accept {name}")
    return calibration


def _errors(stored: _Calibration) -> SensorErrors:
    sensors = stored.sensors
    if [block.sensor for block in sensors] != list(range(1, len(sensors) + 1)) or not sensors:
        raise InputError("the file is damaged: its sensors are not numbered 1, 2, …")
    errors = SensorErrors(
        np.array([block.scale_factor for block in sensors]),
        from_degrees(np.array([block.non_orthogonality_deg for block in sensors])),
        from_nanotesla(np.array([block.bias_nT for block in sensors])),
        from_degrees(np.array([block.misalignment_deg for block in sensors])),
        np.array([orientation_from_axes(block.orientation) for block in sensors]),
    )
    wrong = ~np.isclose(errors.matrix, [block.matrix for block in sensors], rtol=0, atol=1e-9).all(axis=(1, 2))
    if wrong.any():
        raise InputError(
            f"the file is damaged: matrix and parameters of sensor {wrong.argmax() + 1} contradict each other"
        )
    return errors


def _covariance(stored: _Calibration) -> FloatArray | None:
    if stored.covariance_SI is None:
        return None
    size = 12 * len(stored.sensors)
    if [len(row) for row in stored.covariance_SI] != [size] * size:
        raise InputError(f"the file is damaged: covariance_SI must have {size} rows of {size} numbers")
    covariance = np.array(stored.covariance_SI)
    deviation = np.sqrt(np.abs(np.diag(covariance)))
    asymmetry = np.abs(covariance - covariance.T) > 1e-6 * np.outer(deviation, deviation)
    if asymmetry.any() or (np.diag(covariance) < 0).any():
        raise InputError("the file is damaged: covariance_SI must be symmetric with a diagonal that is not negative")
    return covariance
