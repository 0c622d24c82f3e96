"""What a calibration holds beside the errors: its recording, and what was found with or after them."""

from dataclasses import dataclass

from tam_calibration.units import FloatArray


@dataclass(frozen=True, eq=False)
class AmbientGradient:
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
    """What an effect does to the outputs of an array that takes it for field: T and T/m.

    Parameters
    ----------
    rms : (9,) array
        Root mean square over the recording of the calibration.
    standard_errors : (9,) array
        The same of what is not known of it.
    """

    rms: FloatArray
    standard_errors: FloatArray


@dataclass(frozen=True, eq=False)
class KnownSource:
    """What a source of known place and strength showed of the array; array and errors of the calibration hold it.

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
