"""The result of a diagnosis: is there a gap, where, which effect causes it, and how far it shrinks."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from tam_calibration.effects.effect import Sized
from tam_calibration.gap.checks import Checks
from tam_calibration.gap.laws.law import Signature
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.units import FloatArray, origin_of

Verdict = Literal["no_gap", "explained", "partly_explained", "unexplained", "not_identifiable"]
Status = Literal["supported", "not_supported", "not_identifiable", "channel_missing"]


@dataclass(frozen=True)
class Size:
    """Size of the gap, out of sample, before and after the causes are added.

    Parameters
    ----------
    before, after : float
        √(χ²/n - 1) of the whitened redundant channels: in noise floors.
    before_T, after_T : float
        The same as a field at one axis of a sensor, tesla.
    before_T_per_m, after_T_per_m : float
        The same in the components of the gradient tensor, root of the summed squares; NaN without a gradient.
    floor_T : float
        White noise of one axis, estimated from the recording, tesla.
    closed : float
        1 - (after / before)², 0 to 1.
    closed_interval : (float, float)
        95 % confidence interval of it.
    """

    before: float
    after: float
    before_T: float
    after_T: float
    before_T_per_m: float
    after_T_per_m: float
    floor_T: float
    closed: float
    closed_interval: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Where:
    """Where the gap lies, found without assuming a cause.

    Parameters
    ----------
    sensors : tuple
        Numbers 1…K, or "scalar"; all of them when the gap is common to them, none when there is no gap.
    axes : tuple of str
        "x", "y", "z".
    time_s : (float, float), optional
        Span that contains it, s, where that is not the whole recording.
    frequency_hz : (float, float), optional
        Band that contains it, Hz, where it is not white.
    evidence : mapping
        Statistics that it rests on, by name.
    """

    sensors: tuple[int | str, ...] = ()
    axes: tuple[str, ...] = ()
    time_s: tuple[float, float] | None = None
    frequency_hz: tuple[float, float] | None = None
    evidence: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Cause:
    """An effect that the data support.

    Parameters
    ----------
    fitted : FittedEffect
        Sensors, axes and parameters with standard errors.
    units : mapping
        SI unit of each coefficient and parameter of the shape, by name.
    sensors, axes : tuple
        As in ``Where``.
    law : Signature
        That it explains.
    probability : float
        That it is a cause, calibrated on simulated recordings.
    share : float
        Its part of the energy that all causes explain (Shapley value).
    delta_bic : float
        BIC of the model without it less that of the model with it: positive speaks for it.
    r2_cv : float
        Part of the gap's energy that it explains out of sample.
    indistinguishable_from : tuple of str
        Effects that explain these data as well.
    is_drift : bool
        Whether its channel rises or falls throughout, so that whatever changes as slowly explains as much.
    sizes : tuple of Sized
        Beside the largest plausible in nature, where such a bound is known.
    """

    fitted: FittedEffect
    units: Mapping[str, str]
    sensors: tuple[int | str, ...]
    axes: tuple[str, ...]
    law: Signature
    probability: float
    share: float
    delta_bic: float
    r2_cv: float
    indistinguishable_from: tuple[str, ...] = ()
    is_drift: bool = False
    sizes: tuple[Sized, ...] = ()


@dataclass(frozen=True)
class Considered:
    """The status of one hypothesis, the reason in one clause, and its evidence where it was tried."""

    effect: str
    status: Status
    why: str
    delta_bic: float | None = None
    r2_cv: float | None = None


@dataclass(frozen=True, eq=False)
class Residue:
    """Residuals of every sample, of the data and of the simulated twin, for plots.

    Parameters
    ----------
    time_s : (N,) array
        Time stamps.
    direction : (N, 3) array
        Of the field in the array frame.
    before, after, twin : (N, 3K + 1) array
        Shift of each row alone that explains a sample best, tesla, before the causes, with them, and of a simulation
        with the same attitudes, fitted parameters and noise; the last row is the scalar, NaN without one. With the
        causes also NaN where a sample is excluded. Each sample is weighted by its information on the shift, so that
        noise alone has the same standard deviation in all.
    floor_T : (3K + 1,) array
        Standard deviation of each row from noise alone.
    temperature_C, current_A : (N,) array, optional
        Channels, where they were recorded.
    """

    time_s: FloatArray
    direction: FloatArray
    before: FloatArray
    after: FloatArray
    twin: FloatArray
    floor_T: FloatArray
    temperature_C: FloatArray | None = None
    current_A: FloatArray | None = None

    @property
    def rate(self) -> FloatArray:
        """(N,) rate at which the field turns in the array frame, rad/s; NaN for the last sample."""
        chord = np.linalg.norm(np.diff(self.direction, axis=0), axis=1)
        angle = 2 * np.arcsin(np.clip(chord / 2, 0, 1))
        return np.append(angle / np.diff(self.time_s), np.nan)


@dataclass(frozen=True, eq=False)
class Gap:
    """The gap between a recording and its simulation.

    Parameters
    ----------
    verdict : str
        One of ``Verdict``.
    size : Size
        How large, and how far it shrinks.
    where : Where
        Where it lies.
    causes : tuple of Cause
        Ranked, the largest share first.
    considered : tuple of Considered
        Every hypothesis.
    probabilities : mapping
        Of "no_gap", each effect and "none_of_these". They add up to one; several causes each have their own.
    next_recording : str
        What to record next.
    statement : str
        The verdict in one sentence.
    residue : Residue
        For plots.
    noise : tuple of AxisNoise
        Of each axis, last that of the scalar where there is one; empty without a verdict.
    set_95 : tuple of str
        The smallest set of answers that contains the true one in 95 of 100 recordings: names of effects, "unknown" and
        "no_gap".
    smallest_gap : float
        Smallest detectable gap, in noise floors; NaN without a verdict.
    remarks : tuple of str
        Remarks to read before the verdict, one sentence each: refusal by the calibration, and the noise.
    channel_count : float
        Number n of whitened channels, of which a gap of g noise floors has the energy g² n; NaN without a verdict.
    checks : Checks, optional
        Whether the residual with the causes looks like the twin's; None without a verdict.
    remainder : str
        Description of the part that no cause explains; empty where there is none.
    signature : tuple of Signature
        Laws of the gap, the strongest first: what it does to a reading, where, and its course, whatever its cause is.
    remaining : tuple of Signature
        Laws of what the causes leave.

    Examples
    --------
    >>> from tam_calibration import diagnose, read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> gap = diagnose(made.recording, made.scenario.array)
    >>> print(gap.headline)
    No gap: what the calibration leaves is noise.
    >>> gap.residue.before.shape  # of each sample: three axes of four sensors, and the scalar
    (360, 13)
    """

    verdict: Verdict
    size: Size
    where: Where
    causes: tuple[Cause, ...]
    considered: tuple[Considered, ...]
    probabilities: Mapping[str, float]
    next_recording: str
    statement: str
    residue: Residue = field(repr=False)
    noise: tuple[AxisNoise, ...] = field(default=(), repr=False)
    set_95: tuple[str, ...] = ()
    smallest_gap: float = float("nan")
    remarks: tuple[str, ...] = ()
    channel_count: float = float("nan")
    checks: Checks | None = field(default=None, repr=False)
    remainder: str = ""
    signature: tuple[Signature, ...] = ()
    remaining: tuple[Signature, ...] = ()

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""
        return len(self.residue.floor_T) // 3

    @property
    def origin_s(self) -> float:
        """Time from which sentences count seconds."""
        return origin_of(float(self.residue.time_s[0]))

    @property
    def named(self) -> tuple[str, ...]:
        """Effects that are its causes, each once."""
        return tuple(dict.fromkeys(cause.fitted.effect for cause in self.causes))

    @property
    def most_unseen_errors(self) -> float:
        """Largest bias of a calibration parameter, in its standard errors, by a gap too small to be detected.

        Least squares shifts a parameter by uᵀe of its standard errors, with e the part of the whitened channels that is
        not noise and u of length one; by Cauchy and Schwarz that is at most |e| = g √n. The bound is reached where the
        gap is proportional to the regressor of that parameter.
        """
        return self.smallest_gap * float(np.sqrt(self.channel_count))

    @property
    def headline(self) -> str:
        """The verdict by name in front of the statement, once."""
        name = self.verdict.replace("_", " ").capitalize()
        return self.statement if self.statement.startswith(name) else f"{name}: {self.statement}"
