"""What a calibration file contains, and the calibration that it gives."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np

from tam_calibration.correction.acceptance import beyond_limits
from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import (
    EffectSize,
    Grade,
    KnownSource,
    Provenance,
)
from tam_calibration.files import schema
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.limits import is_covariance
from tam_calibration.model.sensor_errors import Residuals, SensorErrors, orientation_from_axes
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla
from tam_calibration.recordings.array_yaml import ArrayFile
from tam_calibration.results.effects_schema import EffectFile

SCHEMA = "tam_calibration/calibration/1"

_Size = schema.NanoteslaSize
_StandardError = Annotated[float, schema.Bounds(least=0, most=1e12, may_be_nan=True)]
_StandardErrors = tuple[_StandardError, _StandardError, _StandardError]
_Covariance = Annotated[float, schema.Bounds(least=-1e12, most=1e12)]
"""SI: a parameter that is known to a million of its units is not known."""


class SensorFile(schema.Document):
    """The errors of one sensor."""

    sensor: int
    scale_factor: schema.ScaleFactors
    non_orthogonality_deg: schema.Shears
    bias_nT: schema.NanoteslaVector
    misalignment_deg: schema.Turns
    orientation: schema.Orientation = schema.NOT_TURNED


def errors_of(sensors: Sequence[SensorFile]) -> SensorErrors:
    """Return the errors of all sensors in SI.

    Raises
    ------
    InputError
        When the sensors are not numbered in order.
    """
    if [block.sensor for block in sensors] != list(range(1, len(sensors) + 1)) or not sensors:
        raise InputError("sensors must be numbered 1, 2, … in this order")
    return SensorErrors(
        np.array([block.scale_factor for block in sensors]),
        from_degrees(np.array([block.non_orthogonality_deg for block in sensors])),
        from_nanotesla(np.array([block.bias_nT for block in sensors])),
        from_degrees(np.array([block.misalignment_deg for block in sensors])),
        np.array([orientation_from_axes(block.orientation) for block in sensors]),
    )


class _CalibratedSensor(SensorFile):
    scale_factor_standard_error: _StandardErrors
    non_orthogonality_standard_error_deg: _StandardErrors
    bias_standard_error_nT: _StandardErrors
    misalignment_standard_error_deg: _StandardErrors
    matrix: schema.Tensor


class _Array(ArrayFile):
    noise_is_estimated: bool


class _Field(schema.Document):
    intensity_nT: schema.Nanotesla
    has_scalar_reference: bool
    coverage_of_sphere: Annotated[float, schema.Bounds(least=0, most=1)]
    reference: str = ""
    # In files from before the gradient of the site was an effect; nothing uses them.
    gradient_nT_per_m: Any = None
    gradient_standard_error_nT_per_m: Any = None


class ResidualsFile(schema.Document):
    """RMS residuals at one stage of a calibration."""

    sensor_intensity_nT: list[_Size]
    center_intensity_nT: _Size
    tensor_nT_per_m: tuple[_Size, _Size, _Size, _Size, _Size]
    tensor_rmse_nT_per_m: _Size


class _AllResiduals(schema.Document):
    before: ResidualsFile
    in_sample: ResidualsFile
    held_out: ResidualsFile | None
    noise_floor: ResidualsFile


class _Recording(schema.Document):
    samples: int
    time_span_s: tuple[schema.Seconds, schema.Seconds]
    name: str | None
    size_bytes: int | None
    sha256: str | None
    mean_temperature_C: schema.Celsius | None = None

    def to_provenance(self) -> Provenance | None:
        """Return where the recording came from, if that is known."""
        if self.name is None or self.size_bytes is None or self.sha256 is None:
            return None
        return Provenance(self.name, self.size_bytes, self.sha256)


class _OfOutputs(schema.Document):
    field_nT: tuple[_Size, _Size, _Size]
    gradient_nT_per_m: tuple[_Size, _Size, _Size, _Size, _Size, _Size]

    def to_tesla(self) -> FloatArray:
        """Return the (9,) numbers in SI."""
        return from_nanotesla(np.array([*self.field_nT, *self.gradient_nT_per_m]))


class _Effect(EffectFile):
    size: _OfOutputs
    size_standard_error: _OfOutputs

    def to_size(self) -> EffectSize:
        """Return what the effect does to the outputs, SI."""
        return EffectSize(self.size.to_tesla(), self.size_standard_error.to_tesla())


class KnownSourceFile(schema.Document):
    """What a known source of field determined."""

    baseline_scale: schema.ScaleFactor
    baseline_scale_standard_error: _StandardError
    rotation_deg: schema.Turns
    rotation_standard_error_deg: _StandardErrors
    axis_offsets_standard_error_m: list[tuple[_StandardErrors, _StandardErrors, _StandardErrors]]
    reduced_chi_square: Annotated[float, schema.Bounds(least=0)]


class _Quality(schema.Document):
    grade: Grade
    reasons: list[str]
    next: list[str]


class _Calibration(schema.Document):
    schema: Literal["tam_calibration/calibration/1"]
    software: str
    method: str
    quality: _Quality | None = None
    formula: str
    frame: str
    statements: list[str]
    warnings: list[str]
    notes: list[str] = dataclasses.field(default_factory=list)
    accepted: list[str] = dataclasses.field(default_factory=list)
    sensors: list[_CalibratedSensor]
    array: _Array
    field: _Field
    residuals: _AllResiduals
    reduced_chi_square: dict[str, Annotated[float, schema.Bounds(least=0, may_be_nan=True)]]
    effects: list[_Effect] = dataclasses.field(default_factory=list)
    known_source: KnownSourceFile | None = None
    update: dict[str, Any] | None = None
    recording: _Recording
    covariance_order: str
    covariance_SI: list[list[_Covariance]]


def calibration_of(content: dict[str, Any]) -> Calibration:
    """Return the calibration of the keys and values of a calibration file.

    Raises
    ------
    InputError
        When they are of another version, incomplete, contradict each other, or are beyond a limit that is not accepted.
    """
    stored = schema.check_file(content, "calibration", SCHEMA, _Calibration)
    errors = _errors(stored)
    stated = stored.array
    if not stored.field.has_scalar_reference:  # older versions wrote 0 where there is no scalar magnetometer
        stated = dataclasses.replace(stated, scalar_noise_nT=stated.scalar_noise_nT or None)
    array = stated.to_array()
    if array.sensor_count != errors.sensor_count or array.vector_noise_T is None:
        raise InputError(f"the file is damaged: positions and noise must be those of its {errors.sensor_count} sensors")
    effects = tuple(effect.to_fitted(errors, array) for effect in stored.effects)
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
        has_scalar_reference=stored.field.has_scalar_reference or stored.field.reference != "",
        reference=stored.field.reference,
        intensity_T=from_nanotesla(stored.field.intensity_nT),
        before=_residuals(residuals.before),
        in_sample=_residuals(residuals.in_sample),
        floor=_residuals(residuals.noise_floor),
        samples=stored.recording.samples,
        time_span_s=stored.recording.time_span_s,
        coverage=stored.field.coverage_of_sphere,
        reduced_chi_square=stored.reduced_chi_square,
        held_out=None if residuals.held_out is None else _residuals(residuals.held_out),
        source=stored.recording.to_provenance(),
        warnings=tuple(stored.warnings),
        notes=tuple(stored.notes),
        frame=stored.frame,
        effects=effects,
        effect_sizes=tuple(effect.to_size() for effect in stored.effects),
        known_source=None if stored.known_source is None else KnownSource(*schema.in_si(stored.known_source)),
        accepted=tuple(stored.accepted),
        temperature_C=stored.recording.mean_temperature_C,
    )
    for name, sentence in beyond_limits(calibration).items():
        if name not in stored.accepted:
            raise InputError(f"{sentence}; where that is so, calibrate again and accept {name}")
    return calibration


def _residuals(stored: ResidualsFile) -> Residuals:
    return Residuals(*schema.in_si(stored)[:3])


def _errors(stored: _Calibration) -> SensorErrors:
    errors = errors_of(stored.sensors)
    wrong = ~np.isclose(errors.matrix, [block.matrix for block in stored.sensors], rtol=0, atol=1e-9).all(axis=(1, 2))
    if wrong.any():
        raise InputError(
            f"the file is damaged: matrix and parameters of sensor {wrong.argmax() + 1} contradict each other"
        )
    return errors


def _covariance(stored: _Calibration) -> FloatArray:
    size = 12 * len(stored.sensors)
    if [len(row) for row in stored.covariance_SI] != [size] * size:
        raise InputError(f"the file is damaged: covariance_SI must have {size} rows of {size} numbers")
    covariance = np.array(stored.covariance_SI)
    if not is_covariance(covariance):
        raise InputError("the file is damaged: covariance_SI must be symmetric and positive definite")
    return covariance
