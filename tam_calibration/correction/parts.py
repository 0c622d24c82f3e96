"""Parts of a calibration besides the errors of the sensors, and what it makes of a recording."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from tam_calibration.model.units import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class AmbientGradientEstimate:
    """The gradient that a fit found in the field of its recording, in the world of the attitude.

    Parameters
    ----------
    tensor_T_per_m : (3, 3) array
        Symmetric and trace-free, T/m.
    standard_errors_T_per_m : (3, 3) array
        Of each component, T/m.
    """

    tensor_T_per_m: FloatArray
    standard_errors_T_per_m: FloatArray


@dataclass(frozen=True, eq=False)
class EffectSize:
    """Contribution of an effect to the outputs of an array if it is not removed: T and T/m.

    Parameters
    ----------
    rms : (9,) array
        Root mean square over the recording of the calibration.
    standard_errors : (9,) array
        The same for the uncertainty of the effect.
    """

    rms: FloatArray
    standard_errors: FloatArray


@dataclass(frozen=True, eq=False)
class KnownSource:
    """What a source of known place and strength showed of the array. Array and errors of the calibration include it.

    Parameters
    ----------
    baseline_scale, baseline_scale_standard_error : float
        True distances of the sensors from the centre over the stated ones.
    rotation, rotation_standard_errors : (3,) array
        Rotation vector from the array frame to the frame of the uniform field's calibration, radians.
    axis_offsets_standard_errors_m : (K, 3, 3) array
        Of ``array.axis_offsets_m``, metres.
    reduced_chi_square : float
        Squared residuals over the noise of the amplitudes, per degree of freedom.
    """

    baseline_scale: float
    baseline_scale_standard_error: float
    rotation: FloatArray
    rotation_standard_errors: FloatArray
    axis_offsets_standard_errors_m: FloatArray
    reduced_chi_square: float


@dataclass(frozen=True)
class Provenance:
    """The recording that a calibration came from: file name, size and SHA-256 of its bytes."""

    name: str
    size_bytes: int
    sha256: str


@dataclass(frozen=True, eq=False)
class Corrected:
    """Centre vector and magnetic gradient tensor in the array frame.

    Parameters
    ----------
    time_s : (N,) array
        Time stamps of the recording, seconds.
    outputs : (N, 9) array
        Columns ``array.OUTPUT_NAMES``: bx by bz in tesla, gxx gxy gxz gyy gyz gzz in T/m; the gradient is
        NaN where the array's geometry has none.
    standard_errors : (9,) array
        Standard error of each column: sensor noise and the calibration's own uncertainty.
    missing : (N,) array of int, optional
        Missing sensors of each sample, bit k for sensor k + 1; None if all are complete. Outputs that the others do
        not determine are NaN.
    covariances : dict of int to (9, 9) array
        Covariances of samples with missing sensors, by the value of ``missing``.
    scalar_T : (N,) array, optional
        Scalar readings minus the effects in them, tesla; None without a scalar.
    remarks : tuple of str
        Missing readings, a clause for each sensor and reason.

    Examples
    --------
    >>> from tam_calibration import calibrate, correct, read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> corrected = correct(made.recording, calibrate(made.recording, made.scenario.array))
    >>> field_T, gradient_T_per_m = corrected.outputs[:, :3], corrected.outputs[:, 3:]
    >>> field_T.shape, gradient_T_per_m.shape
    ((360, 3), (360, 6))
    """

    time_s: FloatArray
    outputs: FloatArray
    standard_errors: FloatArray
    missing: IntArray | None = None
    covariances: Mapping[int, FloatArray] = field(default_factory=dict)
    scalar_T: FloatArray | None = None
    remarks: tuple[str, ...] = ()
