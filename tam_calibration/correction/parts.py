"""Parts of a calibration besides the errors of the sensors: its grade, its update, and what it makes of a recording.

The grade says whether it can be used, what speaks against it, and what to do next. The update says what it took from
the calibration before it: the shares of data and prior, and what has moved in between.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from tam_calibration.model.data_sheet import ChangeRates
from tam_calibration.model.sensor_errors import Residuals
from tam_calibration.model.units import FloatArray, IntArray, to_nanotesla


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


Grade = Literal["good", "doubtful", "bad"]


@dataclass(frozen=True)
class Quality:
    """A grade with its reasons.

    Parameters
    ----------
    grade : str
        "good": use it. "doubtful": its errors may be larger than its standard errors say. "bad": do not use it.
    reasons : tuple of str
        What speaks against the calibration, the gravest first; empty where it is good.
    next : tuple of str
        What to do about each reason: an action or a command.
    headline : str
        The residual and its noise floor; empty without a calibration.
    """

    grade: Grade
    reasons: tuple[str, ...] = ()
    next: tuple[str, ...] = ()
    headline: str = ""

    def __str__(self) -> str:
        """Return the grade, the residual and its floor, and the gravest reason with what to do, on one line."""
        return f"{self.grade.capitalize()}: {'; '.join(filter(None, (self.headline, *self.reasons[:1])))}"


def quality_for(grade: Grade, reasons: Sequence[str], headline: str = "") -> Quality:
    """Return the quality for reasons that say what is wrong and, behind the last colon, what to do."""
    actions = dict.fromkeys(reason.rpartition(": ")[2] for reason in reasons if ": " in reason)
    return Quality(grade, tuple(reason.rstrip(".") for reason in reasons), tuple(actions), headline)


def residual_in_words(residual: Residuals, floor: Residuals, seen: str) -> str:
    """Return a residual and its noise floor: of the tensor, or of |B| if the array measures no gradient.

    Parameters
    ----------
    residual, floor : Residuals
        Of corrected readings, and what sensor noise alone makes.
    seen : str
        Which samples they are of.
    """
    name, unit, sizes = "tensor", "nT/m", (residual.tensor_rmse_T_per_m, floor.tensor_rmse_T_per_m)
    if np.isnan(sizes[0]):
        name, unit, sizes = "|B|", "nT", (residual.sensors_rms_T, floor.sensors_rms_T)
    left, least = (f"{to_nanotesla(size):.4g} {unit}" for size in sizes)
    return f"{name} residual {left} on {seen}, noise floor {least}"


KINDS = ("scale factor", "non-orthogonality", "bias", "misalignment")
"""Of the errors of a sensor: three of the twelve each, in their order."""

SEVERAL, ALL_BIASES, COMMON_SCALE = "several errors", "biases", "scalar reading, or the scale factors"
"""What changes together: all errors of a sensor, the biases of all, and what is common to the scale of all."""


def in_words(kind: str, sensor: int) -> str:
    """Return what a change is of, for a sentence; sensor 0 is all of them."""
    return f"{kind} of {f'sensor {sensor}' if sensor else 'all sensors'}"


@dataclass(frozen=True, eq=False)
class Moved:
    """A change that a prior and its rates do not explain.

    Parameters
    ----------
    kind : str
        One of ``KINDS``.
    sensor : int
        From 1.
    change, standard_errors : (3,) array
        What the errors of the kind are now less what they were, SI.
    probability : float
        Of this change among those of one kind of one sensor, each as likely before.
    rivals : tuple of (str, int)
        Kind and sensor of others that are not improbable; a kind may be one of what changes together, sensor 0 is all.
    since_s : float, optional
        When, on the clock of the recording, where it shows that; None where it was so from its start.
    together : (str, int), optional
        Kind and sensor of what changed together, where this is a part of it.
    """

    kind: str
    sensor: int
    change: FloatArray
    standard_errors: FloatArray
    probability: float
    rivals: tuple[tuple[str, int], ...] = ()
    since_s: float | None = None
    together: tuple[str, int] | None = None


@dataclass(frozen=True, eq=False)
class Update:
    """How a calibration came from an older one and a recording.

    Parameters
    ----------
    prior : str
        Which calibration was the prior: its recording or its method.
    rates : ChangeRates, optional
        By which it was widened; None for tolerances of new sensors, which no time widens.
    elapsed_s, warming_K : float, optional
        Time and temperature since; None where unknown.
    prior_standard_errors : (K, 12) array
        Before the recording, SI.
    data_share : (K, 12) array
        Part of the information on each parameter that the recording gave: one less the ratio of the variances after and
        before; NaN for what is fixed.
    chi_square : float
        Of the difference between prior and data.
    freedom : int
        Number of independent directions that it counts.
    probability : float
        Of one as large where nothing moved beyond the rates.
    moved : tuple of Moved
        What the data contradict the prior in, the most certain first; the prior counts little there.
    """

    prior: str
    rates: ChangeRates | None
    elapsed_s: float | None
    warming_K: float | None
    prior_standard_errors: FloatArray
    data_share: FloatArray
    chi_square: float
    freedom: int
    probability: float
    moved: tuple[Moved, ...] = ()

    @property
    def prior_in_words(self) -> str:
        """What the prior was, for a sentence."""
        return "the tolerances of the array file" if self.rates is None else "the prior"
